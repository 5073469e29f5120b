"""Scene as matplotlib artists: the map of figures and films.

Loaded only for drawing. It uses matplotlib objects on Agg, never pyplot, and leaves no setting changed.
"""

import math
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Circle, Ellipse
from matplotlib.path import Path
from matplotlib.transforms import Affine2D

from bus.messages.ground import GroundMap
from bus.messages.team import Role
from sim.compiling.compile import FloatArray, IntArray
from sim.scene.altitude import ring_radius
from sim.scene.buildings import DrawnBuildings, DrawnShadow, legend_of_buildings
from sim.scene.colors import COVERED, ESTIMATE, INK, LIMIT, MUTED, RULE, UAV, UGV
from sim.scene.hazards import DrawnGround, legend_of_ground
from sim.scene.model import Moment, Point, Ring, Scene
from sim.scene.team_drawing import DrawnCells, RoleTrack, legend_of_roles

COVERAGE = LinearSegmentedColormap.from_list("covered", list(COVERED))
"""Colormap from uncovered to covered ground."""
DASHED = (0, (4, 2.5))
_ROUTE: dict[str, Any] = {
    "linewidth": 1.3,
    "linestyle": (0, (3.5, 2.5)),
    "dash_capstyle": "butt",
    "zorder": 3.4,
}
"""Style of a planned route."""
DPI = 140
_STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "mathtext.fontset": "dejavusans",
    "text.color": INK,
    "axes.edgecolor": "#b9bec6",
    "axes.labelcolor": INK,
    "axes.labelsize": 9.0,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "grid.color": RULE,
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "lines.linewidth": 1.5,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 1.6,
    "agg.path.chunksize": 20000,
}

_PLANE = Moment()
_BODY = ((-0.9, -0.9), (0.5, -0.9), (1.6, 0.0), (0.5, 0.9), (-0.9, 0.9), (-0.9, -0.9))
"""Marker of a UGV that steers: a square with a tip that points east."""
_BODY_SIZE = 8.0 * 1.6 / 0.9
"""Size of this marker, so that its square is as large as the marker of a point [pt]."""
_NO_ROLES: Mapping[str, IntArray] = MappingProxyType({})
Estimate = tuple[Point, tuple[float, float, float]]
"""UAV's estimate of its UGV's position [m], and its covariance xx, xy, yy [m²]."""


@contextmanager
def plot_style() -> Iterator[None]:
    """Apply Outrider's style to new artists within the context, independent of the user's settings.

    The settings are restored on exit.
    """
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)  # type: ignore[arg-type]
        yield


def ground(axes: Axes, width: float, height: float) -> None:
    """Format axes that show the ground [m]."""
    axes.set_aspect("equal")
    axes.set_xlim(0.0, width)
    axes.set_ylim(0.0, height)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(visible=False)
    for side in ("top", "right"):
        axes.spines[side].set_visible(True)


def draw_ring(axes: Axes, ring: Ring, center: Point = (0.0, 0.0)) -> Circle:
    """Draw a circle on the ground."""
    circle = Circle(
        center,
        ring.radius,
        fill=False,
        edgecolor=ring.color,
        linewidth=ring.width,
        linestyle=DASHED if ring.dashed else "-",
        zorder=5,
    )
    axes.add_patch(circle)
    return circle


class Track:
    """Path of one vehicle, with a hollow marker at its start and a filled one at its position.

    Args:
        axes: Axes to draw on.
        color: Color of the vehicle.
        flies: True for a UAV (a disc); False for a UGV (a square with a wider path).
        line: Style of the path.
        label: Label in the legend; empty: none.
    """

    def __init__(
        self, axes: Axes, color: str, *, flies: bool, line: str = "-", label: str = ""
    ) -> None:
        width, mark = (1.6, "o") if flies else (2.2, "s")
        hollow: dict[str, Any] = {"markersize": 6, "color": "white", "markeredgecolor": color}
        full: dict[str, Any] = {"markersize": 8, "color": color, "markeredgecolor": "white"}
        self.artists: tuple[Line2D, ...] = (
            *axes.plot([], [], line, color=color, linewidth=width, label=label, zorder=4),
            *axes.plot([], [], mark, **hollow, markeredgewidth=1.5, zorder=6),
            *axes.plot([], [], mark, **full, markeredgewidth=1.2, zorder=7),
        )

    def move(self, path: FloatArray) -> "Track":
        """Show the path up to its last point [m]. Shape (points, 2)."""
        for artist, part in zip(self.artists, (path, path[:1], path[-1:]), strict=True):
            artist.set_data(part[:, 0], part[:, 1])
        return self

    def turn(self, heading: float) -> None:
        """Show the heading of a UGV that steers [rad]."""
        body = MarkerStyle(Path(_BODY), transform=Affine2D().rotate(heading))
        self.artists[-1].set_marker(body)
        self.artists[-1].set_markersize(_BODY_SIZE)


class Map:
    """Scene on axes: constant parts are drawn once, moving parts by `show`.

    Args:
        axes: Axes to draw on.
        scene: Scene to draw.
        estimates: True to show the UAVs' estimates, with an ellipse of two standard deviations.
        hazards: Ground with its hazards; None: no hazards.
    """

    def __init__(
        self,
        axes: Axes,
        scene: Scene,
        *,
        estimates: bool = False,
        hazards: GroundMap | None = None,
    ) -> None:
        ground(axes, scene.width, scene.height)
        self.image = axes.imshow(
            np.zeros((1, 1)),
            cmap=COVERAGE,
            vmin=0.0,
            vmax=1.0,
            origin="lower",
            extent=(0.0, scene.width, 0.0, scene.height),
            interpolation="bilinear",
        )
        self._scene, buildings = scene, scene.space.buildings
        self._hazards = None if hazards is None else DrawnGround(axes, hazards)
        self._buildings = DrawnBuildings(axes, buildings, hazards) if buildings else None
        above = buildings and scene.space.camera is not None
        self._shadow = DrawnShadow(axes, scene) if above else None
        self._cells: tuple[int, int] | None = None
        self._still: list[Artist] = []
        self._tracks: dict[str, Track] = {}
        self._role_tracks: dict[str, RoleTrack] = {}
        self._borders = DrawnCells(axes, scene) if scene.teams else None
        teamed = {name for team in scene.teams for name in team}
        self._routes: dict[str, Line2D] = {}
        for one in scene.vehicles:
            goals = np.array(one.goals, dtype=np.float64).reshape(-1, 2)
            if len(goals):
                self._still += axes.plot(
                    goals[:, 0], goals[:, 1], "x", ms=6, mew=1.8, color=one.color, zorder=3.5
                )
            if hazards is not None and not one.flies:
                (self._routes[one.name],) = axes.plot([], [], color=one.color, **_ROUTE)
            if one.name in teamed:
                self._role_tracks[one.name] = RoleTrack(axes, one.color)
            else:
                self._tracks[one.name] = Track(axes, one.color, flies=one.flies)
        self._rings = [(ring, draw_ring(axes, ring)) for ring in scene.rings]
        self._sights: dict[tuple[str, str], Line2D] = {}
        if scene.rings:
            for pair in scene.escorts:
                (self._sights[pair],) = axes.plot([], [], color=MUTED, linewidth=0.9, zorder=3.7)
        self._estimates = {uav: _Estimate(axes) for uav, _ in scene.escorts if estimates}

        if hazards is not None:
            self._show_routes(hazards)

    def _show_routes(self, hazards: GroundMap) -> None:
        for name, line in self._routes.items():
            route = np.array(hazards.routes.get(name, ()), dtype=np.float64).reshape(-1, 2)
            line.set_data(route[:, 0], route[:, 1])

    @property
    def artists(self) -> list[Artist]:
        """Return all artists on the axes, from the ground up."""
        found: list[Artist] = [self.image, *self._still, *self._sights.values()]
        found += self._routes.values()
        found += [] if self._hazards is None else self._hazards.artists
        found += [] if self._buildings is None else self._buildings.artists
        found += [] if self._shadow is None else [self._shadow.artist]
        found += [] if self._borders is None else [self._borders.artist]
        found += [artist for track in self._tracks.values() for artist in track.artists]
        found += [artist for track in self._role_tracks.values() for artist in track.artists]
        found += [circle for _, circle in self._rings]
        found += [artist for one in self._estimates.values() for artist in one.artists]
        return sorted(found, key=lambda artist: artist.get_zorder())

    def show(
        self,
        tracks: Mapping[str, FloatArray],
        coverage: npt.NDArray[Any] | None = None,
        estimates: Mapping[str, Estimate] | None = None,
        hazards: GroundMap | None = None,
        moment: Moment = _PLANE,
        roles: Mapping[str, IntArray] = _NO_ROLES,
    ) -> None:
        """Show a moment of the run.

        Args:
            tracks: Path of each vehicle so far [m]. Shape (points, 2).
            coverage: Share of the desired coverage, from 0 to 1, shape (rows, columns); None: unchanged.
            estimates: Estimate of each UAV that has one.
            hazards: Ground with its hazards; None: unchanged.
            moment: State of the vehicles.
            roles: Code of the `Role` at each point of the path of each UAV in a team, 0: unknown. Shape (points,).
        """
        if hazards is not None and self._hazards is not None:
            self._hazards.show(hazards)
            self._show_routes(hazards)
        if hazards is not None and self._buildings is not None:
            self._buildings.show(hazards)
        if coverage is not None:
            self.image.set_data(coverage)
            self._cells = (coverage.shape[0], coverage.shape[1])
        for name, track in self._tracks.items():
            track.move(tracks[name])
            if name in moment.headings:
                track.turn(moment.headings[name])
        for name, path in self._role_tracks.items():
            path.move(tracks[name], roles.get(name))
        positions = {
            name: (float(path[-1, 0]), float(path[-1, 1])) for name, path in tracks.items()
        }
        if self._borders is not None:
            self._borders.show(positions)
        for ring, circle in self._rings:
            circle.center = positions[ring.around]
            circle.set_radius(ring_radius(self._scene, ring, moment.altitudes))
        if self._shadow is not None and self._cells is not None:
            self._shadow.show(positions, moment.altitudes, self._cells)
        for (uav, ugv), line in self._sights.items():
            line.set_data(*zip(tracks[uav][-1], tracks[ugv][-1], strict=True))
            line.set_color(LIMIT if uav in moment.hidden else MUTED)
        for uav, artist in self._estimates.items():
            artist.show((estimates or {}).get(uav))


class _Estimate:
    """Cross at a UAV's estimate of its UGV, with an ellipse of two standard deviations."""

    def __init__(self, axes: Axes) -> None:
        self._ellipse = Ellipse((0, 0), 0, 0, fill=False, ec=ESTIMATE, lw=1.0, zorder=8)
        axes.add_patch(self._ellipse)
        (self._cross,) = axes.plot([], [], "+", color=ESTIMATE, ms=7, mew=1.2, zorder=8)
        self.artists: tuple[Artist, ...] = (self._ellipse, self._cross)

    def show(self, estimate: Estimate | None) -> None:
        for artist in self.artists:
            artist.set_visible(estimate is not None)
        if estimate is None:
            return
        (x, y), (xx, xy, yy) = estimate
        self._cross.set_data([x], [y])
        mean, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
        self._ellipse.set_center((x, y))
        self._ellipse.set_width(4.0 * math.sqrt(max(mean + spread, 0.0)))
        self._ellipse.set_height(4.0 * math.sqrt(max(mean - spread, 0.0)))
        self._ellipse.set_angle(math.degrees(0.5 * math.atan2(2.0 * xy, xx - yy)))


def key(color: str, label: str, **line: Any) -> Line2D:  # noqa: ANN401 - matplotlib's own keywords
    """Return an entry of a legend."""
    return Line2D([], [], color=color, label=label, **line)


def legend_of(
    scene: Scene,
    *,
    estimates: bool = False,
    hazards: GroundMap | None = None,
    roles: Collection[Role] = (),
) -> list[Artist]:
    """Return the entries of a scene's legend, one for each kind of object; `roles`: those that occur in teams."""
    mark = {"markeredgecolor": "white", "markersize": 7}
    uavs = sum(one.flies for one in scene.vehicles)
    ugvs = len(scene.vehicles) - uavs
    keys: list[Artist] = []
    if uavs:
        keys.append(key(UAV[0], "UAV" if uavs == 1 else f"{uavs} UAVs", marker="o", **mark))
    keys += legend_of_roles(scene, roles)
    driving = "UGV" if ugvs == 1 else f"{ugvs} UGVs"
    keys.append(key(UGV[0], driving, marker="s", linewidth=2.2, **mark))
    if any(one.goals for one in scene.vehicles):
        keys.append(key(UGV[0], "goal", marker="x", linestyle="", markeredgewidth=1.8))
    for ring in reversed({ring.symbol: ring for ring in reversed(scene.rings)}.values()):
        line: Any = (0, (3, 1.6)) if ring.dashed else "-"
        at = "(z)" if scene.space.camera is not None and ring.symbol != "r_s" else ""
        label = f"{ring.label} ${ring.symbol}{at}$"
        keys.append(key(ring.color, label, linestyle=line, linewidth=ring.width))
    if estimates:
        keys.append(key(ESTIMATE, "estimate, 2σ", linestyle="", marker="+", markeredgewidth=1.2))
    keys += legend_of_buildings(scene, hazards)
    if hazards is not None:
        keys.append(key(UGV[0], "planned route", **_ROUTE))
        keys += legend_of_ground(hazards)
    return keys
