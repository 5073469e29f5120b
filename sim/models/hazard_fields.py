r"""Random hazards that never block the last route from a UGV's start to its goals.

Discs are drawn one after the other, by counter. A disc too close to a stop, overlapping another one, or blocking a
route is skipped. A route is a chain of adjacent tiles (4-connected) without blocking hazards.

A route is blocked if and only if blocked tiles, together with the outside, form a ring (8-connected) with one of its
ends inside and the other outside: a ring that crosses a line between them an odd number of times. Blocked tiles are
therefore joined as they are added, and each stores the lines crossed between it and the root of its set (union-find
with parities, without path compression, so that a disc can be removed again). A join that closes an odd ring is
detected at once, without a search through the free tiles.
"""

from typing import NamedTuple

import numpy as np

from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.records import RecordArray
from sim.models.ground import CLEAR, TileArray, add_disc, disc_columns, disc_rows, state_at
from sim.models.hazards import BLOCK, FOUND
from sim.models.randomness import HAZARD_PLACE, Key, draw, to_uniform
from sim.models.vehicles import norm

MOST_MISSES = 500
"""Consecutive skipped discs after which a field is full."""

_FREE, _STOP = -1, -2
"""Special parents: the tile is free; the tile is free and must stay free."""
_PARENT, _CROSSED, _SIZE, _LOG = range(4)
"""Rows of the work array: for each tile, its parent in its set, and the lines crossed up to it; for a root, the size of
its set; and a log of the roots that this disc has joined to others, with their number first.
"""


class HazardFieldRow(NamedTuple):
    """Random field, a row of a table."""

    kind: int
    """Code of a row of `bus.registry.HAZARDS`."""
    discs: int
    """Number of hazards."""
    smallest: float
    largest: float
    """Smallest and largest radius [m]."""
    share: float
    """Share of its maximum speed that a vehicle keeps; see `sim.models.hazards.HazardRow`."""
    clear: float
    """Smallest distance of its discs from all stops [m]."""
    kept: float
    """Distance from its discs at which routes stay open [m]; 0 unless they block."""


def work_array(rows: int, columns: int) -> IntArray:
    """Return the work array of `place_hazards` for a map of this size and a ring around it."""
    return np.zeros((4, (rows + 2) * (columns + 2)), dtype=np.int64)


@compiled
def _crossed(ways: IntArray, i: int, j: int, d_i: int, d_j: int) -> int:
    """Return the lines crossed an odd number of times between the centers of two adjacent tiles, as bits.

    The line of a route starts 3/8 of a tile right of its first tile's center and 1/4 above it, follows the row, then
    the column to the same position in the last tile. It meets no center, and no step meets its corner or ends.

    Args:
        ways: As in `place_hazards`.
        i, j: Row and column of one tile.
        d_i, d_j: Step to the other tile: (0, 1), (1, -1), (1, 0) or (1, 1).
    """
    bits = 0
    for p in range(ways.shape[0]):
        row, column, last_row, last_column = ways[p, 0], ways[p, 1], ways[p, 2], ways[p, 3]
        crossed = False
        if d_i == 1 and i == row:
            x = j + 0.25 * d_j
            crossed = (x > column + 0.375) != (x > last_column + 0.375)
        left = j + min(d_j, 0)
        if d_j != 0 and left == last_column:
            y = (i + 0.375 * d_i) if d_j > 0 else (i + 0.625 * d_i)
            if (y > row + 0.25) != (y > last_row + 0.25):
                crossed = not crossed
        if crossed:
            bits ^= ways[p, 4]
    return bits


@compiled
def _joined(work: IntArray, one: int, other: int, crossed: int) -> bool:
    """Join the sets of two adjacent tiles; return False if this closes a ring around one end of a route."""
    while work[_PARENT, one] != one:
        crossed ^= work[_CROSSED, one]
        one = work[_PARENT, one]
    while work[_PARENT, other] != other:
        crossed ^= work[_CROSSED, other]
        other = work[_PARENT, other]
    if one == other:
        return crossed == 0
    if work[_SIZE, one] > work[_SIZE, other]:
        one, other = other, one
    work[_PARENT, one], work[_CROSSED, one] = other, crossed
    work[_SIZE, other] += work[_SIZE, one]
    work[_LOG, 0] += 1
    work[_LOG, work[_LOG, 0]] = one
    return True


@compiled
def _block(work: IntArray, ways: IntArray, i: int, j: int, columns: int) -> bool:
    """Block a free tile and join it to the blocked tiles around it; return False if this blocks a route."""
    width = columns + 2
    node = (i + 1) * width + j + 1
    work[_PARENT, node], work[_CROSSED, node], work[_SIZE, node] = node, 0, 1
    for n in range(8):
        # the four steps forward, then the same steps from the previous tiles
        d_i, d_j = (0, 1) if n % 4 == 0 else (1, n % 4 - 2)
        away, back = d_i * width + d_j, n // 4
        other = node + away * (1 - 2 * back)
        if work[_PARENT, other] >= 0:
            crossed = _crossed(ways, i - back * d_i, j - back * d_j, d_i, d_j)
            if not _joined(work, node, other, crossed):
                return False
    return True


@compiled
def begin_work(ways: IntArray, tiles: TileArray, work: IntArray) -> None:
    """Join the tiles that are blocked initially, and all outside tiles.

    Args:
        ways: As in `place_hazards`.
        tiles: True states of the tiles.
        work: A `work_array`; changed.
    """
    rows, columns = tiles.shape
    width = columns + 2
    work[_PARENT, :] = _FREE
    for i in range(rows + 2):
        for j in range(0, width, 1 if i in (0, rows + 1) else width - 1):
            work[_PARENT, i * width + j], work[_CROSSED, i * width + j] = 0, 0
    work[_SIZE, 0] = 2 * (rows + width)
    for i in range(rows):
        for j in range(columns):
            if tiles[i, j] == BLOCK:
                work[_LOG, 0] = 0
                _block(work, ways, i, j, columns)
    for p in range(ways.shape[0]):
        for end in (0, 2):
            node = (ways[p, end] + 1) * width + ways[p, end + 1] + 1
            if work[_PARENT, node] == _FREE:
                work[_PARENT, node] = _STOP


@compiled
def _block_disc(
    x: float, y: float, radius: float, tile: float, ways: IntArray, tiles: TileArray, work: IntArray
) -> bool:
    """Block the free tiles of a disc in `work` only; return False, without a change, if this blocks a route."""
    rows, columns = tiles.shape
    width = columns + 2
    low, high = disc_rows(y, radius, tile, rows)
    work[_LOG, 0], open_yet = 0, True
    for i in range(low, high):
        first, end = disc_columns(x, y, radius, tile, i, columns)
        for j in range(first, end):
            parent = work[_PARENT, (i + 1) * width + j + 1]
            if parent == _STOP:
                open_yet = False
            elif parent == _FREE and open_yet:
                open_yet = _block(work, ways, i, j, columns)
        if not open_yet:
            break
    if open_yet:
        return True
    for n in range(work[_LOG, 0], 0, -1):
        root = work[_LOG, n]
        work[_SIZE, work[_PARENT, root]] -= work[_SIZE, root]
        work[_PARENT, root], work[_CROSSED, root] = root, 0
    for i in range(low, high):
        first, end = disc_columns(x, y, radius, tile, i, columns)
        for j in range(first, end):
            node = (i + 1) * width + j + 1
            if work[_PARENT, node] >= 0 and tiles[i, j] != BLOCK:
                work[_PARENT, node] = _FREE
    return False


@compiled
def _fits(
    fields: RecordArray,
    f: int,
    place: tuple[float, float, float],
    stops: FloatArray,
    tile: float,
    tiles: TileArray,
) -> bool:
    """Return whether a disc is far enough from all stops, overlaps no other disc, and hides no object to find.

    It overlaps another one if the tile at its center already has its state, or one with precedence.
    """
    x, y, radius = place
    kind, clear = fields[f]["kind"], fields[f]["clear"]
    for n in range(stops.shape[0]):
        if norm(x - stops[n, 0], y - stops[n, 1]) < radius + clear:
            return False
    there = state_at(tiles, tile, x, y)
    if there in (kind, BLOCK):
        return False
    low, high = disc_rows(y, radius, tile, tiles.shape[0])
    for i in range(low, high):
        first, end = disc_columns(x, y, radius, tile, i, tiles.shape[1])
        for j in range(first, end):
            state = tiles[i, j]
            if state == FOUND or (kind == FOUND and state != CLEAR):
                return False
    return True


@compiled
def _drawn(
    fields: RecordArray, f: int, attempt: int, area: tuple[float, float], key: Key
) -> tuple[float, float, float]:
    """Draw the center and radius of a disc of one field [m]."""
    field = fields[f]
    first, second, third, _ = draw(key, HAZARD_PLACE, f, attempt)
    radius = field["smallest"] + to_uniform(third) * (field["largest"] - field["smallest"])
    return to_uniform(first) * area[0], to_uniform(second) * area[1], radius


@compiled
def place_hazards(
    fields: RecordArray,
    stops: FloatArray,
    ways: IntArray,
    area: tuple[float, float],
    tile: float,
    key: Key,
    hazards: RecordArray,
    first: int,
    tiles: TileArray,
    work: IntArray,
) -> int:
    """Draw the hazards of random fields, field by field.

    Args:
        fields: Table of `HazardFieldRow`.
        stops: Points from which discs keep their clearance [m]. Shape (stops, 2).
        ways: Routes that stay open: rows and columns of the tiles at both ends, and the route's bits, which no sum of
            other routes' bits equals. A start without a goal is a route from the start to itself. Shape (routes, 5).
        area: Width and height of the area [m].
        tile: Side of a tile [m].
        key: Key of the random numbers.
        hazards: Table of `HazardRow`, with capacity for all; changed.
        first: First row to fill. Unused rows are empty.
        tiles: True states with the hazards of earlier rows, enlarged by `kept`; changed.
        work: A `work_array`; changed.

    Returns:
        The row after the last filled one; fewer rows than the fields request if no more fit.
    """
    begin_work(ways, tiles, work)
    behind = first
    for f in range(fields.shape[0]):
        field = fields[f]
        kind, last = field["kind"], behind + field["discs"]
        attempt, misses = -1, 0
        while behind < last and misses < MOST_MISSES:
            attempt, misses = attempt + 1, misses + 1
            x, y, radius = _drawn(fields, f, attempt, area, key)
            reach = radius + field["kept"]
            if not _fits(fields, f, (x, y, reach), stops, tile, tiles):
                continue
            if kind == BLOCK and not _block_disc(x, y, reach, tile, ways, tiles, work):
                continue
            add_disc(x, y, reach, kind, tile, tiles)
            row = hazards[behind]
            row["kind"], row["share"] = kind, field["share"]
            row["x"], row["y"], row["radius"], row["reach"] = x, y, radius, radius
            row["first"], row["corners"] = 0, 0
            behind, misses = behind + 1, 0
    for k in range(behind, hazards.shape[0]):
        hazards[k]["kind"] = 0
    return behind
