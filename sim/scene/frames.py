"""Animated scene: constant parts are drawn once, moving artists are updated."""

import math
import textwrap
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bus.messages.ground import GroundMap
from bus.messages.team import Role
from sim.compiling.compile import FloatArray, IntArray
from sim.scene.altitude import HIDDEN, Sight
from sim.scene.colors import COVERED, LIMIT, MUTED
from sim.scene.drawing import DPI, Estimate, Map, key, legend_of, plot_style
from sim.scene.model import Moment, Scene

_HEADER, _FOOTER, _SIDE = 92, 116, 68
"""Margins above, below and beside the ground [px]."""
_LEGEND_OF_GROUND = 48
"""Extra margin below, for the legend of hazards [px]."""
_LEGEND_OF_TEAM = 44
"""Extra margin below, for the legend of roles [px]."""
_LABELS = 10
"""Extra offset of the ground to the right, for labels of three digits and the axis label [px]."""
_TALLEST = 1000
"""Maximum height of the ground [px]."""
_PLANE = Moment()
_NO_ROLES: Mapping[str, IntArray] = MappingProxyType({})


class Frames:
    """Pictures of a scene from above, in sequence.

    Args:
        scene: Scene to draw.
        width: Width of a picture [px]; its height follows from the ground's, and is even.
        facts: Line below the title.
        estimates: True to show the UAVs' estimates.
        hazards: Ground with its hazards; None: no hazards.
        roles: Roles that occur in teams.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        width: int,
        facts: str = "",
        estimates: bool = False,
        hazards: GroundMap | None = None,
        roles: Collection[Role] = (),
    ) -> None:
        scale = min((width - 2 * _SIDE) / scene.width, _TALLEST / scene.height)
        across, tall = scene.width * scale, scene.height * scale
        footer = _FOOTER if hazards is None else _FOOTER + _LEGEND_OF_GROUND
        footer += _LEGEND_OF_TEAM if roles else 0
        total = round(tall + _HEADER + footer) // 2 * 2  # video requires even numbers
        self._left, self._rows = _SIDE / 2 / width, (1.0 - 20 / total, 1.0 - 58 / total)
        with plot_style():
            self._figure = Figure(figsize=(width / DPI, total / DPI), dpi=DPI, facecolor="white")
            self._canvas = FigureCanvasAgg(self._figure)
            axes = self._figure.add_axes(
                (
                    0.5 + (_LABELS - across / 2) / width,
                    footer / total,
                    across / width,
                    tall / total,
                ),
                zorder=1,
            )
            self._map = Map(axes, scene, estimates=estimates, hazards=hazards)
            self._write(scene.title, facts, width)
            self._figure.legend(
                handles=[
                    *legend_of(scene, estimates=estimates, hazards=hazards, roles=roles),
                    key(COVERED[-1], "covered", marker="s", linestyle="", markersize=7),
                ],
                loc="lower center",
                ncols=4,
                fontsize=7.0 if scene.space.buildings else 7.5,
                columnspacing=1.3 if hazards is None else 0.9,
                handletextpad=0.5,
            )
            self._moving: list[Artist] = [
                *self._map.artists,
                self._facts,
                self._clock,
                self._distance,
            ]
            for artist in self._moving:
                artist.set_animated(True)
            self._canvas.draw()  # type: ignore[no-untyped-call]
            self._background = self._canvas.copy_from_bbox(self._figure.bbox)  # type: ignore[no-untyped-call]

    def _write(self, title: str, facts: str, width: int) -> None:
        upper, lower = self._rows
        bold: dict[str, Any] = {"fontweight": "bold", "va": "top"}
        name = textwrap.shorten(title, width // 18, placeholder="…")[: width // 18]
        self._figure.text(self._left, upper, name, fontsize=13, parse_math=False, **bold)
        self._facts = self._figure.text(
            self._left, lower, facts, color=MUTED, va="top", parse_math=False
        )
        right: dict[str, Any] = {"ha": "right", "fontfamily": "DejaVu Sans Mono"}
        self._clock = self._figure.text(1.0 - self._left, upper, "", fontsize=11, **bold, **right)
        self._distance = self._figure.text(1.0 - self._left, lower, "", va="top", **right)

    def draw(
        self,
        tracks: Mapping[str, FloatArray],
        coverage: npt.NDArray[Any] | None,
        estimates: Mapping[str, Estimate] | None = None,
        *,
        time: float,
        sight: Sight | None,
        facts: str | None = None,
        hazards: GroundMap | None = None,
        moment: Moment = _PLANE,
        roles: Mapping[str, IntArray] = _NO_ROLES,
    ) -> npt.NDArray[np.uint8]:
        """Return the picture of a moment; other arguments as in `Map.show`.

        Args:
            tracks: Path of each vehicle so far [m].
            coverage: Coverage of the ground.
            estimates: Estimate of each UAV that has one.
            time: Simulated time [s].
            sight: Pair that is closest to losing sight; an infinite radius is unknown. None: no UAV.
            facts: Line below the title; None: unchanged.
            hazards: Ground with its hazards; None: unchanged.
            moment: State of the vehicles.
            roles: Code of the role at each point of the path of each UAV in a team.

        Returns:
            Red, green, blue and opacity; shape (rows, columns, 4). Each call returns a new array.
        """
        self._map.show(tracks, coverage, estimates, hazards, moment, roles)
        self._clock.set_text(f"{time:7.1f} s")
        self._distance.set_text(_sight_text(sight, moment.altitudes))
        self._distance.set_color(LIMIT if sight is not None and sight.lost else MUTED)
        if facts is not None:
            self._facts.set_text(facts)
        self._canvas.restore_region(self._background)  # type: ignore[no-untyped-call]
        for artist in self._moving:
            self._figure.draw_artist(artist)
        return np.array(self._canvas.buffer_rgba(), dtype=np.uint8)  # type: ignore[no-untyped-call]


def _sight_text(sight: Sight | None, altitudes: Mapping[str, float]) -> str:
    """Return the lowest altitude, and the distance between UAV and UGV with its limit."""
    text = f"z = {min(altitudes.values()):.1f} m   " if altitudes else ""
    if sight is None:
        return text
    text += f"distance {sight.distance:5.2f} m"
    if sight.hidden:
        return f"{text}  {HIDDEN.upper()}"
    limit = f" of {sight.radius:.4g} m" if math.isfinite(sight.radius) else ""
    return f"{text}{limit}{'  OUT OF SIGHT' if sight.lost else ''}"
