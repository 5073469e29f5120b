"""Animated scene: constant parts are drawn once, moving artists are updated."""

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bus.messages.ground import GroundMap
from sim.compiling.compile import FloatArray
from sim.scene.colors import COVERED, LIMIT, MUTED
from sim.scene.drawing import DPI, Estimate, Map, key, legend_of, look
from sim.scene.model import Scene

_HEADER, _FOOTER, _SIDE = 92, 116, 68
"""Margins above, below and beside the ground [px]."""
_LEGEND_OF_GROUND = 48
"""Extra margin below, for the legend of hazards [px]."""
_LABELS = 10
"""Extra offset of the ground to the right, for labels of three digits and the axis label [px]."""
_TALLEST = 1000
"""Maximum height of the ground [px]."""


class Frames:
    """Pictures of a scene from above, in sequence.

    Args:
        scene: Scene to draw.
        width: Width of a picture [px]; its height follows from the ground's, and is even.
        facts: Line below the title.
        estimates: True to show the UAVs' estimates.
        hazards: Ground with its hazards; None: no hazards.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        width: int,
        facts: str = "",
        estimates: bool = False,
        hazards: GroundMap | None = None,
    ) -> None:
        scale = min((width - 2 * _SIDE) / scene.width, _TALLEST / scene.height)
        across, tall = scene.width * scale, scene.height * scale
        footer = _FOOTER if hazards is None else _FOOTER + _LEGEND_OF_GROUND
        total = round(tall + _HEADER + footer) // 2 * 2  # video requires even numbers
        self._left, self._rows = _SIDE / 2 / width, (1.0 - 20 / total, 1.0 - 58 / total)
        with look():
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
                    *legend_of(scene, estimates=estimates, hazards=hazards),
                    key(COVERED[-1], "covered", marker="s", linestyle="", markersize=7),
                ],
                loc="lower center",
                ncols=4,
                fontsize=7.5,
                columnspacing=1.3 if hazards is None else 1.0,
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
        distance: float | None,
        r_v: float | None,
        facts: str | None = None,
        hazards: GroundMap | None = None,
    ) -> npt.NDArray[np.uint8]:
        """Return the picture of a moment; the first three arguments and `hazards` as in `Map.show`.

        Args:
            tracks: Path of each vehicle so far [m].
            coverage: Coverage of the ground.
            estimates: Estimate of each UAV that has one.
            time: Simulated time [s].
            distance: Largest distance between a UAV and its UGV [m]; None: no UAV.
            r_v: Visibility radius [m]; None: unknown.
            facts: Line below the title; None: unchanged.
            hazards: Ground with its hazards; None: unchanged.

        Returns:
            Red, green, blue and opacity; shape (rows, columns, 4). Each call returns a new array.
        """
        self._map.show(tracks, coverage, estimates, hazards)
        lost = distance is not None and r_v is not None and distance >= r_v
        limit = "" if r_v is None else f" of {r_v:g} m"
        text = "" if distance is None else f"distance {distance:5.2f} m{limit}"
        self._clock.set_text(f"{time:7.1f} s")
        self._distance.set_text(f"{text}{'  OUT OF SIGHT' if lost else ''}")
        self._distance.set_color(LIMIT if lost else MUTED)
        if facts is not None:
            self._facts.set_text(facts)
        self._canvas.restore_region(self._background)  # type: ignore[no-untyped-call]
        for artist in self._moving:
            self._figure.draw_artist(artist)
        return np.array(self._canvas.buffer_rgba(), dtype=np.uint8)  # type: ignore[no-untyped-call]
