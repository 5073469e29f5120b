"""Ground with hazards as matplotlib artists: a shade over unknown tiles, and the hazards on it."""

from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.path import Path

from bus.messages.ground import GroundMap, Hazard
from sim.models.ground import UNSEEN
from sim.scene.colors import FAINT, HAZARDS, INK, LIMIT, TILES, rgb
from sim.scene.ground_map import HIT, KNOWN, UNKNOWN

_SHADES = np.array([(*rgb(color), opacity) for color, opacity in TILES])
_SOLID: dict[str, Any] = {"facecolor": HAZARDS["block"], "edgecolor": HAZARDS["block"]}
_ROUGH: dict[str, Any] = {"facecolor": "none", "edgecolor": HAZARDS["rough"], "hatch": "////"}
_STAR: dict[str, Any] = {"marker": "*", "markersize": 11, "linestyle": "", "markeredgewidth": 0.9}
_FOUND: dict[str, Any] = {"color": HAZARDS["find"], "markeredgecolor": INK}
_NOT_FOUND: dict[str, Any] = {"color": "white", "markeredgecolor": HAZARDS["find"]}


def _outline(hazard: Hazard) -> Path:
    if hazard.polygon:
        return Path([*hazard.polygon, hazard.polygon[0]], closed=True)
    return Path.circle(hazard.middle, hazard.radius or 0.0)


class DrawnGround:
    """Known ground and hazards, drawn over the coverage.

    Args:
        axes: Axes to draw on.
        ground: First map to show, with the hazards; its buildings are left to `DrawnBuildings`.
    """

    def __init__(self, axes: Axes, ground: GroundMap) -> None:
        self._kinds = [
            "" if k in ground.building_rows else hazard.kind
            for k, hazard in enumerate(ground.hazards)
        ]
        self._outlines = [_outline(hazard) for hazard in ground.hazards]
        self._centers = np.array([one.middle for one in ground.hazards]).reshape(-1, 2)
        width, height = ground.columns * ground.tile, ground.rows * ground.tile
        self._veil = axes.imshow(
            np.zeros((1, 1, 4)),
            origin="lower",
            extent=(0.0, width, 0.0, height),
            interpolation="nearest",
            zorder=1.0,
        )
        self._areas: dict[tuple[str, int], PathCollection] = {}
        for kind, state in product(("block", "rough"), (UNKNOWN, KNOWN, HIT)):
            style = _SOLID if kind == "block" else _ROUGH
            if state == HIT:
                style = style | {"facecolor": LIMIT, "edgecolor": HAZARDS[kind]}
            area = PathCollection(
                [],
                linewidths=0.8,
                alpha=FAINT if state == UNKNOWN else None,
                zorder=2.6 if kind == "block" else 2.5,
                **style,
            )
            self._areas[kind, state] = area
            axes.add_collection(area, autolim=False)
        self._stars: dict[int, Line2D] = {}
        for state, style in ((UNKNOWN, _NOT_FOUND), (KNOWN, _FOUND)):
            (self._stars[state],) = axes.plot([], [], zorder=3.6, **_STAR, **style)
        self._states = b"not drawn yet"
        self.show(ground)

    @property
    def artists(self) -> list[Artist]:
        """Return all artists."""
        return [self._veil, *self._areas.values(), *self._stars.values()]

    def show(self, ground: GroundMap) -> None:
        """Show another moment of the same ground."""
        tiles: npt.NDArray[np.uint8] = np.frombuffer(ground.tiles, dtype=np.uint8)
        self._veil.set_data(_SHADES[tiles.reshape(ground.rows, ground.columns)])
        if ground.states == self._states:
            return
        self._states = ground.states
        of = list(zip(self._kinds, ground.states, strict=True))
        for drawn, area in self._areas.items():
            area.set_paths([self._outlines[k] for k, one in enumerate(of) if one == drawn])
        for state, stars in self._stars.items():
            shown = self._centers[[k for k, one in enumerate(of) if one == ("find", state)]]
            stars.set_data(shown[:, 0], shown[:, 1])


def legend_of_ground(ground: GroundMap) -> list[Artist]:
    """Return the entries of its legend: each kind of hazard present, buildings apart, and the shade."""
    kinds = {
        hazard.kind for k, hazard in enumerate(ground.hazards) if k not in ground.building_rows
    }
    keys: list[Artist] = []
    if "block" in kinds:
        keys.append(Patch(label="blocked, faint: unknown", linewidth=0.8, **_SOLID))
    if "block" in kinds or ground.building_rows:
        keys.append(Patch(label="hit", linewidth=0.8, **(_SOLID | {"facecolor": LIMIT})))
    if "rough" in kinds:
        keys.append(Patch(label="rough", linewidth=0.8, **_ROUGH))
    if "find" in kinds:
        keys.append(Line2D([], [], label="found, hollow: not yet", **_STAR, **_FOUND))
    color, opacity = TILES[0]
    if UNSEEN in ground.tiles:
        keys.append(Patch(facecolor=color, alpha=opacity, label="unknown to the UGV"))
    return keys
