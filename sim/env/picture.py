"""The environment's picture: what stands still is drawn once, the artists that move stay and are moved.

Only `sim.env.view` loads this, when someone looks.
"""

from collections.abc import Sequence
from itertools import cycle

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from sim.env.rows import Moment
from sim.models.vehicles import stopping_distance
from sim.scenario.types import Ugv
from sim.world import World

# The colours of `outrider.style`, which the simulator may not import; a test holds them equal.
UAV = ("#1f5fbf", "#5aa9e6", "#173b7a", "#7d8fe0")
UGV = ("#e8740c", "#f2a65a", "#a8500a", "#f6c453")
LIMIT, INK, MUTED, RULE = "#cf2a3c", "#22262d", "#727985", "#e6e8ec"
_UNSEEN, _SEEN = (
    "#fafafa",
    "#c4decf",
)  # lighter than in the figures: here everything lies on top of it
_COLORS = LinearSegmentedColormap.from_list("covered", [_UNSEEN, _SEEN])(np.arange(256), bytes=True)
_LONG_SIDE = 8.0  # of the area on the canvas [in]
_LEFT, _RIGHT, _BELOW, _ABOVE = 0.62, 0.34, 0.92, 0.58  # margins [in]
_DPI = 100


def _ring(radius: float, color: str, width: float, *, dashed: bool = False) -> Circle:
    line = (0, (5, 4)) if dashed else "-"
    return Circle((0, 0), radius, fill=False, edgecolor=color, linewidth=width, linestyle=line)


def _mark(color: str, marker: str, label: str) -> Line2D:
    return Line2D([], [], color=color, marker=marker, label=label, linestyle="none", markersize=7)


class _Escort:
    """The artists of one UAV and its UGV."""

    def __init__(self, axes: Axes, world: World, k: int) -> None:
        self._uav, self._ugv = world.escorts[k].tolist()
        v_a, u_a = world.bounds[self._uav].tolist()
        r_v = world.parameters.r_v
        r_s = r_v - stopping_distance(v_a + float(world.bounds[self._ugv, 0]), u_a)
        self._sensor = _ring(world.parameters.reach, UAV[k % len(UAV)], 0.8)
        self._r_s = _ring(max(0.0, r_s), LIMIT, 1.0, dashed=True)
        self._r_s.set_visible(0.0 < r_s < r_v)
        self._r_v = _ring(r_v, LIMIT, 1.6)
        self._sight = Line2D([], [], color=MUTED, linewidth=0.9)
        self.artists: list[Artist] = [self._sensor, self._r_s, self._r_v, self._sight]
        for ring in (self._sensor, self._r_s, self._r_v):
            axes.add_patch(ring)
        axes.add_line(self._sight)

    def move(self, moment: Moment) -> None:
        p_a, p_g = moment.position[self._uav], moment.position[self._ugv]
        self._r_v.center = self._r_s.center = (p_g[0], p_g[1])
        self._sensor.center = (p_a[0], p_a[1])
        self._sight.set_data([p_a[0], p_g[0]], [p_a[1], p_g[1]])


class Picture:
    """Draws a world from above.

    Args:
        world: Whose scenario is drawn.
    """

    def __init__(self, world: World) -> None:
        w = world.parameters
        scale = _LONG_SIDE / max(w.width, w.height)
        wide, high = w.width * scale, w.height * scale
        size = (wide + _LEFT + _RIGHT, high + _BELOW + _ABOVE)
        self._figure = Figure(figsize=size, dpi=_DPI, facecolor="white")
        self._canvas = FigureCanvasAgg(self._figure)
        self._axes = self._figure.add_axes(
            (_LEFT / size[0], _BELOW / size[1], wide / size[0], high / size[1])
        )
        self._dress(world)
        self._title = self._figure.text(
            _LEFT / size[0], 1 - 0.5 * _ABOVE / size[1], "", color=INK, fontsize=12, va="center"
        )
        self._ground = self._axes.imshow(
            self._colors(world),
            origin="lower",
            extent=(0.0, w.width, 0.0, w.height),
            interpolation="bilinear",
        )
        still = self._draw_still(world)
        self._escorts = [_Escort(self._axes, world, k) for k in range(len(world.uavs))]
        self._tracks, self._vehicles = self._draw_vehicles(world)
        rings = [artist for escort in self._escorts for artist in escort.artists]
        self._moving: list[Artist] = [
            self._ground,
            *still,
            *rings,
            *self._tracks,
            *self._vehicles,
            self._title,
        ]
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()  # type: ignore[no-untyped-call]
        self._background = self._canvas.copy_from_bbox(self._figure.bbox)  # type: ignore[no-untyped-call]

    @staticmethod
    def _colors(world: World) -> npt.NDArray[np.uint8]:
        levels = np.minimum(world.coverage * (255.0 / world.parameters.desired), 255.0).astype(
            np.uint8
        )
        colors: npt.NDArray[np.uint8] = _COLORS[levels]
        return colors

    def _dress(self, world: World) -> None:
        axes, w = self._axes, world.parameters
        axes.set(xlim=(0.0, w.width), ylim=(0.0, w.height), aspect="equal", autoscale_on=False)
        axes.tick_params(length=0, labelsize=8.5, colors=MUTED)
        axes.set_xlabel("x [m]", fontsize=8.5, color=MUTED, labelpad=2)
        axes.set_ylabel("y [m]", fontsize=8.5, color=MUTED, labelpad=3)
        axes.spines[:].set_color(RULE)
        legend = [
            _mark(UAV[0], "o", "UAV"),
            _mark(UGV[0], "s", "UGV"),
            _mark(UGV[0], "x", "goal"),
            Line2D([], [], color=LIMIT, linewidth=1.6, label="sight is lost, $r_v$"),
            Line2D(
                [],
                [],
                color=LIMIT,
                linewidth=1.0,
                linestyle=(0, (4, 3)),
                label="only tracking, $r_s$",
            ),
            Line2D([], [], color=UAV[0], linewidth=0.8, label="sensor, $r$"),
            _mark(_SEEN, "s", "seen"),
        ]
        self._figure.legend(
            handles=legend,
            loc="lower center",
            ncols=7,
            frameon=False,
            fontsize=8.5,
            labelcolor=INK,
            columnspacing=1.6,
        )

    def _draw_still(self, world: World) -> list[Artist]:
        """What lies on the ground: the grid, and the UGVs' goals."""
        axes, w = self._axes, world.parameters
        still: list[Artist] = [
            axes.vlines(
                [x for x in axes.get_xticks() if 0.0 < x < w.width],
                0.0,
                w.height,
                color=RULE,
                linewidth=0.5,
            ),
            axes.hlines(
                [y for y in axes.get_yticks() if 0.0 < y < w.height],
                0.0,
                w.width,
                color=RULE,
                linewidth=0.5,
            ),
        ]
        for ugv in world.scenario.ugv:
            x, y = [goal[0] for goal in ugv.goals], [goal[1] for goal in ugv.goals]
            still += axes.plot(
                x, y, "x", color=UGV[0], markersize=6, markeredgewidth=1.4, alpha=0.8
            )
        return still

    def _draw_vehicles(self, world: World) -> tuple[list[Line2D], list[Line2D]]:
        tracks, marks = [], []
        blues, oranges = cycle(UAV), cycle(UGV)
        for vehicle in world.scenario.vehicles:
            color, marker = (next(oranges), "s") if isinstance(vehicle, Ugv) else (next(blues), "o")
            tracks += self._axes.plot([], [], color=color, linewidth=1.3, alpha=0.75)
            marks += self._axes.plot(
                [],
                [],
                marker,
                color=color,
                markersize=9,
                markeredgecolor="white",
                markeredgewidth=1.2,
            )
        return tracks, marks

    def draw(
        self, world: World, moment: Moment, tracks: Sequence[list[list[float]]]
    ) -> npt.NDArray[np.uint8]:
        """The picture of this moment.

        Args:
            world: Whose coverage is shown.
            moment: Where everybody is.
            tracks: Positions of all vehicles, tick by tick, up to this moment.

        Returns:
            Red, green, blue; shape (rows, columns, 3).
        """
        self._ground.set_data(self._colors(world))
        path = np.array(tracks)
        for k, (track, mark) in enumerate(zip(self._tracks, self._vehicles, strict=True)):
            track.set_data(path[:, k, 0], path[:, k, 1])
            mark.set_data(path[-1:, k, 0], path[-1:, k, 1])
        for escort in self._escorts:
            escort.move(moment)
        self._title.set_text(self._words(world, moment))
        self._canvas.restore_region(self._background)  # type: ignore[no-untyped-call]
        for artist in self._moving:
            self._figure.draw_artist(artist)
        return np.asarray(self._canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3].copy()  # type: ignore[no-untyped-call]

    @staticmethod
    def _words(world: World, moment: Moment) -> str:
        name, many = world.scenario.name or "Outrider", len(moment.measures) > 1
        distance, error = (
            max(measure[0] for measure in moment.measures),
            sum(measure[1] for measure in moment.measures),
        )
        return (
            f"{name}     $t$ = {moment.time:.2f} s     {'largest ' if many else ''}distance {distance:.2f} m     "
            f"{'sum of ' if many else ''}$e(t)$ = {error:.0f} m²"
        )
