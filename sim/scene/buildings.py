"""Buildings as matplotlib artists: greys by height, and the ground that they hide from the cameras."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import to_rgba
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.text import Text

from bus.messages.buildings import Building
from bus.messages.ground import GroundMap
from sim.scene.altitude import HiddenGround
from sim.scene.colors import BUILDINGS, FAINT, INK, LIMIT, SHADOW, building, mixed, rgb
from sim.scene.footprints import label_point
from sim.scene.ground_map import HIT, KNOWN, UNKNOWN
from sim.scene.model import Point, Scene

_MOST_LABELS = 60
"""Largest number of buildings with their height written on them."""
_FINER, _LARGEST_GRID = 3, 1500
"""Division of a cell of the coverage grid for the shadow, and the largest grid that is divided."""
_HATCH = 8
"""Parts of a cell from one line of the hatching to the next."""
_LABEL_SIZE = 6.5
_DARK = 1.7
"""Sum of red, green and blue below which a label is white."""


class DrawnBuildings:
    """Buildings with their heights: the taller, the darker; faint while no UGV knows them, red once touched.

    Args:
        axes: Axes to draw on.
        buildings: Buildings to draw.
        hazards: Ground with the hazards that they are; None: no hazards.
    """

    def __init__(
        self, axes: Axes, buildings: tuple[Building, ...], hazards: GroundMap | None
    ) -> None:
        outlines = [Path([*one.corners, one.corners[0]], closed=True) for one in buildings]
        self._greys = [building(one.height, buildings) for one in buildings]
        self._areas = PathCollection(outlines, edgecolors=INK, linewidths=0.8, zorder=2.6)
        axes.add_collection(self._areas, autolim=False)
        self._labels: list[Text] = []
        self._dark = [sum(rgb(grey)) < _DARK for grey in self._greys]
        for one in buildings[:_MOST_LABELS]:
            label = axes.text(
                *label_point(one),
                f"{one.height:.1f}",
                size=_LABEL_SIZE,
                ha="center",
                va="center",
                zorder=2.65,
                clip_on=True,
            )
            self._labels.append(label)
        self.show(hazards)

    @property
    def artists(self) -> list[Artist]:
        """Return all artists."""
        return [self._areas, *self._labels]

    def show(self, hazards: GroundMap | None) -> None:
        """Show the UGVs' knowledge of the buildings; None: unchanged."""
        rows, states = range(0), b""
        if hazards is not None:
            rows, states = hazards.building_rows, hazards.states
        colors, faint = [], []
        for n, grey in enumerate(self._greys):
            state = states[rows[n]] if n < len(rows) else KNOWN
            faint.append(state == UNKNOWN)
            colors.append(
                to_rgba(LIMIT if state == HIT else grey, FAINT if state == UNKNOWN else 1.0)
            )
        self._areas.set_facecolor(colors)
        for label, dark, pale in zip(self._labels, self._dark, faint, strict=False):
            label.set_color("white" if dark and not pale else INK)


class DrawnShadow:
    """Ground that is hidden from the UAVs' cameras, hatched.

    Args:
        axes: Axes to draw on.
        scene: Scene with buildings.
    """

    def __init__(self, axes: Axes, scene: Scene) -> None:
        self._ground = HiddenGround(scene)
        self.artist = axes.imshow(
            np.zeros((1, 1, 4)),
            origin="lower",
            extent=(0.0, scene.width, 0.0, scene.height),
            interpolation="nearest",
            zorder=1.5,
        )

    def show(
        self, positions: Mapping[str, Point], altitudes: Mapping[str, float], shape: tuple[int, int]
    ) -> None:
        """Show the hidden ground; arguments as of `HiddenGround.cells`."""
        if max(shape) * _FINER <= _LARGEST_GRID:
            shape = (shape[0] * _FINER, shape[1] * _FINER)
        self.artist.set_data(_hatched(self._ground.cells(positions, altitudes, shape)))


def _hatched(cells: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """Return an image with hatching on these cells. Shape (rows, columns, 4)."""
    color, paper, line = SHADOW
    rows, columns = np.indices(cells.shape)
    image = np.empty((*cells.shape, 4))
    image[..., :3] = rgb(color)
    image[..., 3] = np.where(cells, np.where((rows + columns) % _HATCH < 2, line, paper), 0.0)
    return image


def legend_of_buildings(scene: Scene, hazards: GroundMap | None) -> list[Artist]:
    """Return the entries of the legend for buildings and their shadows; empty without buildings."""
    buildings = scene.space.buildings
    if not buildings:
        return []
    faint = hazards is not None and any(hazards.states[k] == UNKNOWN for k in hazards.building_rows)
    label = "building, height [m]" + ("; faint: unknown" if faint else "")
    grey = mixed(*BUILDINGS, 0.5)
    keys: list[Artist] = [Patch(facecolor=grey, edgecolor=INK, linewidth=0.8, label=label)]
    if scene.space.camera is not None:
        color, paper, _ = SHADOW
        keys.append(
            Patch(
                facecolor=(*rgb(color), paper),
                edgecolor=(*rgb(color), 0.6),
                hatch="/////",
                linewidth=0.0,
                label="hidden from the camera",
            )
        )
    return keys
