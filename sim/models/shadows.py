r"""Ground that buildings hide from a downward camera, cell by cell.

A building of height H hides a point q of the ground if the segment from q towards the camera p touches the footprint B
within the share H/z of its length. The hidden points are thus the points of B, scaled about p by the factors from 1 to
$F = z / (z - H)$; F is infinite for a camera that is not above the roof.

Outline of this set: a ray from p enters B through a front edge, at r_1, and leaves it through a back edge, at r_2; the
points from r_1 to F r_2 are hidden. The curve that follows front edges, follows back edges scaled by F, and joins them
along rays winds once around each such stretch. Hence a point is hidden if and only if this curve has a positive winding
number there, for a footprint of any shape. The winding numbers of several buildings add up.

A point on an outline is hidden if all points just around it are: buildings are open sets, as in
`sim.models.buildings.line_of_sight`. The winding number is counted on the four sides of each cell's center.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.lanes import LANES
from sim.compiling.records import RecordArray
from sim.models.grid import disc_chords

_LARGEST_FACTOR = 1e10
"""Bound of F. Scaled by it, every wall farther than 1e-9 m from the camera is beyond a range of 10 m."""

_TIE = 1e-9
"""Distance from a row, column or center up to which a point is on it [cells]; it exceeds the rounding error."""

Corner = tuple[float, float]
"""Corner of an outline in units of cells: column before row, counted from the center of the disc's first row."""


class Occlusion(NamedTuple):
    """Known buildings, and the height from which a camera looks down on them."""

    buildings: RecordArray
    """Table as from `building_table`. Shape (buildings,)."""
    corners: FloatArray
    """Corners of the footprints [m]. Shape (corners, 2)."""
    known: npt.NDArray[np.bool_]
    """True for the buildings that hide ground; the others are as if they did not exist. Shape (buildings,)."""
    z: float
    """Height of the camera above the ground [m]; above the roof of a building that the camera is over."""


@compiled
def all_known(buildings: RecordArray, corners: FloatArray, z: float) -> Occlusion:
    """Return the occlusion by all buildings of a table. Arguments as in `Occlusion`."""
    return Occlusion(buildings, corners, np.ones(buildings.shape[0], dtype=np.bool_), z)


class _Outlines(NamedTuple):
    """Outlines of hidden sets, by row."""

    chords: IntArray
    """Cells of each row, as from `disc_chords`. Shape (2, rows)."""
    changes: npt.NDArray[np.int16]
    """Change of the winding number from the cell to the left, at four points next to each cell's center: above it and
    below it, each right and left of it. Shape (rows, columns + 1, 4).
    """
    span: IntArray
    """First cell of each row that may be hidden, and the one after the last. Shape (2, rows)."""


class Shadow(NamedTuple):
    """Winding numbers of the outlines of all hidden sets, at the cells of a sensor's disc."""

    chords: IntArray
    """Cells of each row, as from `disc_chords`. Shape (2, rows)."""
    winding: npt.NDArray[np.int16]
    """Least winding number around the center of each cell of a chord: positive if the cell is hidden. The first cell
    of a chord is at `LANES`. Shape (rows, columns + 2 LANES).
    """
    span: IntArray
    """First cell of each row that may be hidden, and the one after the last, counted from its chord. Shape (2, rows).

    Without such cells, the first is not below the end.
    """


@compiled
def _snapped(a: float) -> float:
    """Return a number of cells, rounded if it is next to a whole number."""
    whole: float = np.rint(a)
    return whole if abs(a - whole) <= _TIE else a


@compiled
def _add_side(outlines: _Outlines, u: Corner, v: Corner, turn: int) -> None:
    """Add the crossings of the rows by one side of an outline, which turns counterclockwise from u to v.

    Args:
        outlines: The outlines; changed.
        u: Start of the side and, on a ray, its end near the camera.
        v: End of the side.
        turn: 1; -1 for a side from v to u.
    """
    (u_column, u_row), (v_column, v_row), rows = u, v, float(outlines.span.shape[1])
    low, high = min(u_row, v_row), max(u_row, v_row)
    begin, end = int(max(np.ceil(low), 0.0)), int(min(np.floor(high) + 1.0, rows))
    if end <= begin or low == high:
        return
    slope = (v_column - u_column) / (v_row - u_row)
    change = 1 if (turn > 0) == (v_row < u_row) else -1
    for n in range(begin, end):
        column = _snapped(u_column + (n - u_row) * slope)
        first, behind = float(outlines.chords[0, n]), float(outlines.chords[1, n])
        for left in range(2):  # of a center on the side, only the point right of it is beyond
            beyond = np.floor(column) + 1.0 if left else np.ceil(column)
            cell = int(max(min(beyond, behind), first) - first)  # a chord may be empty
            if n < high:
                outlines.changes[n, cell, left] += change
            if n > low:
                outlines.changes[n, cell, 2 + left] += change
            outlines.span[0, n] = min(outlines.span[0, n], cell)
            outlines.span[1, n] = max(outlines.span[1, n], cell)


@compiled
def _scaled(p: Corner, factor: float, a: Corner) -> Corner:
    """Return a point, scaled about p."""
    return _snapped(p[0] + factor * (a[0] - p[0])), _snapped(p[1] + factor * (a[1] - p[1]))


@compiled
def _in_cells(corners: FloatArray, n: int, per_cell: float, bottom: float) -> Corner:
    """Return a corner of a footprint in units of cells."""
    return _snapped(corners[n, 0] * per_cell - 0.5), _snapped(corners[n, 1] * per_cell - bottom)


@compiled
def _is_back(p: Corner, a: Corner, b: Corner) -> bool:
    """Return whether a ray from p leaves a counterclockwise polygon through its edge from a to b."""
    return (a[0] - p[0]) * (b[1] - p[1]) > (a[1] - p[1]) * (b[0] - p[0])


@compiled
def _add_building(
    outlines: _Outlines,
    occlusion: Occlusion,
    k: int,
    camera: Corner,
    per_cell: float,
    bottom: float,
) -> None:
    """Add the outline of the set that a building hides.

    Args:
        outlines: The outlines; changed.
        occlusion: The buildings.
        k: Index of the building.
        camera: Position of the camera.
        per_cell: Number of cells per length [1/m].
        bottom: Row of the center of the disc's first row, from the edge of the area.
    """
    row, corners, z = occlusion.buildings[k], occlusion.corners, occlusion.z
    height = row["height"]
    factor = min(z / (z - height), _LARGEST_FACTOR) if height < z else _LARGEST_FACTOR
    first, end = row["first"], row["first"] + row["corners"]
    a = _in_cells(corners, end - 2, per_cell, bottom)
    b = _in_cells(corners, end - 1, per_cell, bottom)
    was_back, far_b = _is_back(camera, a, b), _scaled(camera, factor, b)
    for n in range(first, end):
        a, far_a = b, far_b
        b = _in_cells(corners, n, per_cell, bottom)
        back, far_b = _is_back(camera, a, b), _scaled(camera, factor, b)
        if back != was_back:
            _add_side(outlines, a, far_a, 1 if back else -1)
        if back:
            _add_side(outlines, far_a, far_b, 1)
        else:
            _add_side(outlines, a, b, 1)
        was_back = back


@compiled
def cast_shadow(
    occlusion: Occlusion,
    x: float,
    y: float,
    radius: float,
    cell: float,
    first_row: int,
    chords: IntArray,
) -> Shadow:
    """Return the shadow of the known buildings in a sensor's disc.

    Only buildings that meet the disc matter: it contains the segments from its points to the camera.

    Args:
        occlusion: The buildings, and the height of the camera.
        x, y: Position of the camera [m].
        radius: Range of the sensor [m].
        cell: Width of a cell [m].
        first_row, chords: Cells of the disc, as from `disc_chords`.
    """
    rows, columns = chords.shape[1], 0
    for n in range(rows):
        columns = max(columns, chords[1, n] - chords[0, n])
    shadow = Shadow(
        chords,
        np.zeros((rows, columns + 2 * LANES), dtype=np.int16),
        np.zeros((2, rows), dtype=np.int64),
    )
    shadow.span[0] = columns
    changes = np.zeros((rows, columns + 1, 4), dtype=np.int16)
    outlines = _Outlines(chords, changes, shadow.span)
    per_cell, bottom = 1.0 / cell, first_row + 0.5
    camera = x * per_cell - 0.5, y * per_cell - bottom
    for k in range(occlusion.buildings.shape[0]):
        if not occlusion.known[k]:
            continue
        row = occlusion.buildings[k]
        d_x, d_y, far = row["x"] - x, row["y"] - y, row["bounding_radius"] + radius
        if d_x * d_x + d_y * d_y <= far * far:
            _add_building(outlines, occlusion, k, camera, per_cell, bottom)
    for n in range(rows):
        row_winding = shadow.winding[n, LANES:]
        a = b = c = d = 0
        for i in range(shadow.span[0, n], shadow.span[1, n] + 1):  # 0 again beyond
            a += changes[n, i, 0]
            b += changes[n, i, 1]
            c += changes[n, i, 2]
            d += changes[n, i, 3]
            row_winding[i] = min(a, b, c, d)
    return shadow


@compiled
def hidden_cells(
    occlusion: Occlusion, x: float, y: float, radius: float, cell: float, shape: tuple[int, int]
) -> npt.NDArray[np.bool_]:
    """Return the cells of a grid that are in a sensor's disc and hidden from the camera, by their centers.

    Args:
        occlusion: The buildings, and the height of the camera.
        x, y: Position of the camera [m].
        radius: Range of the sensor [m].
        cell: Width of a cell [m].
        shape: Rows and columns of the grid.

    Returns:
        True for each hidden cell in the disc. Shape (rows, columns).
    """
    hidden = np.zeros(shape, dtype=np.bool_)
    first_row, chords = disc_chords(x, y, radius, cell, shape[0], shape[1])
    shadow = cast_shadow(occlusion, x, y, radius, cell, first_row, chords)
    for n in range(chords.shape[1]):
        for i in range(chords[0, n], chords[1, n]):
            hidden[first_row + n, i] = shadow.winding[n, LANES + i - chords[0, n]] > 0
    return hidden
