"""Coarse cells that buildings hide from the candidate trajectories of the law `lookahead`."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from agents.laws.horizon import Ahead
from agents.uav_parameters import UavParameters
from sim.compiling.compile import compiled
from sim.compiling.dispatch import unless_none
from sim.compiling.lanes import LANES
from sim.models.grid import disc_chords
from sim.models.shadows import Occlusion, cast_shadow


class Views(NamedTuple):
    """Coarse cells that buildings hide from a camera over each coarse cell; computed when first needed."""

    occlusion: Occlusion
    """Buildings, and the altitude of the camera."""
    hidden: npt.NDArray[np.uint8]
    """1: the last two axes' cell is hidden from the first two axes' cell. Shape (rows, columns, rows, columns)."""
    computed: npt.NDArray[np.uint8]
    """1: the cells hidden from this one are known. Shape (rows, columns)."""


@unless_none
@compiled
def empty_views(occlusion: Occlusion, ahead: Ahead) -> Views:
    """Return `Views` without any computed one; None if there are no buildings."""
    size = ahead.lack.shape[0]
    return Views(
        occlusion, np.zeros((size, size, size, size), np.uint8), np.zeros((size, size), np.uint8)
    )


@compiled
def hidden_from(
    views: Views, uav: UavParameters, ahead: Ahead, x: float, y: float
) -> npt.NDArray[np.uint8]:
    """Return the coarse cells that are hidden from a position, as if the camera were over the center of its cell.

    Args:
        views: Changed in place.
        uav: Constants of the UAV.
        ahead: Data from `look_ahead`.
        x, y: Position of the camera [m].

    Returns:
        1 for each hidden cell. Shape (rows, columns).
    """
    size, cell = ahead.lack.shape[0], ahead.cell
    column = min(max(math.floor((x - ahead.x) / cell), 0), size - 1)
    row = min(max(math.floor((y - ahead.y) / cell), 0), size - 1)
    hidden: npt.NDArray[np.uint8] = views.hidden[row, column]
    if views.computed[row, column]:
        return hidden
    views.computed[row, column] = 1
    x, y = ahead.x + (column + 0.5) * cell, ahead.y + (row + 0.5) * cell
    radius = uav.sensor.sensing_range + cell
    rows, columns = math.ceil(uav.height / cell), math.ceil(uav.width / cell)
    first_row, chords = disc_chords(x, y, radius, cell, rows, columns)
    shadow = cast_shadow(views.occlusion, x, y, radius, cell, first_row, chords)
    left, low = round(ahead.x / cell), round(ahead.y / cell)
    for n in range(chords.shape[1]):
        for i in range(chords[0, n], chords[1, n]):
            j, k = first_row + n - low, i - left
            if 0 <= j < size and 0 <= k < size and shadow.winding[n, LANES + i - chords[0, n]] > 0:
                hidden[j, k] = 1
    return hidden
