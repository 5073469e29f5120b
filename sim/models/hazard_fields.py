r"""Hazards at random places, which never close the last way from a UGV's start to its goals.

One disc after the other is drawn, by counter; one that comes too near to a stop, that lies on or under another one, or
that closes a way, is left out and the next one is drawn. A way is a chain of tiles that nothing blocks, each beside the
next (4-connected).

It is closed if and only if blocked tiles, with the ground outside, stand in a ring (8-connected) that has one of its
ends inside and the other outside: a ring that crosses a line between them an odd number of times. So blocked tiles are
joined as they come, and each knows which lines are crossed between it and the root of its set (union-find with
parities, without path compression, so that a disc can be taken back). A join that closes an odd ring is found at once,
and no search through the free tiles is needed.
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
"""A field is full after so many places in a row at which no disc of it fits."""

_FREE, _STOP = -1, -2
"""In place of a parent: the tile is not blocked; it is not blocked and must not be."""
_PARENT, _CROSSED, _SIZE, _LOG = range(4)
"""Rows of the work array: of each tile the parent in its set, the lines crossed on the way to it, and of a root how
many tiles its set has; then how many roots have been put below others for this disc, and these roots in order."""


class HazardFieldRow(NamedTuple):
    """The columns of a table of random fields."""

    kind: int
    """Code of a row of `bus.registry.HAZARDS`."""
    discs: int
    """Number of hazards."""
    smallest: float
    largest: float
    """Radii [m]."""
    share: float
    """As in `sim.models.hazards.HazardRow`."""
    clear: float
    """Distance that its discs keep from all stops [m]."""


def work_array(rows: int, columns: int) -> IntArray:
    """Room for `place_hazards` on a map of so many tiles and a ring around them."""
    return np.zeros((4, (rows + 2) * (columns + 2)), dtype=np.int64)


@compiled
def _crossed(ways: IntArray, i: int, j: int, d_i: int, d_j: int) -> int:
    """The lines that are crossed an odd number of times between the centres of two neighbouring tiles, as bits.

    The line of a way goes from 3/8 of a tile right of the centre of its first tile and 1/4 above along the row, then
    along the column to the same place in its last tile: it meets no centre, and no step at its corner or its ends.

    Args:
        ways: As in `place_hazards`.
        i, j: Row and column of one tile.
        d_i, d_j: Of the step to the other: (0, 1), (1, -1), (1, 0) or (1, 1).
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
    """Put the sets of two neighbouring tiles together; False: their step closes a ring around one end of a way."""
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
    """Block a free tile, and join it to those around it that are blocked; False: that closes a way."""
    width = columns + 2
    node = (i + 1) * width + j + 1
    work[_PARENT, node], work[_CROSSED, node], work[_SIZE, node] = node, 0, 1
    for n in range(8):
        # the four steps forward, then the same ones from the tiles behind
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
    """Join the tiles that are blocked from the start, and all that is outside.

    Args:
        ways: As in `place_hazards`.
        tiles: Their true states.
        work: A `work_array`, changed.
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
    """Block the free tiles that a disc touches, in `work` alone; False, and all is as before: that closes a way."""
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
    """True if a disc is far enough from all stops, lies on or under no other, and hides nothing that is to be found.

    It lies on another one, or under it, if its centre's tile has its state already, or one that goes before it.
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
    """Centre and radius of a disc of one field [m]."""
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
    """Draw the hazards of random fields, one field after the other.

    Args:
        fields: A table of `HazardFieldRow`.
        stops: From which discs keep their distance [m]. Shape (stops, 2).
        ways: That stay open: rows and columns of the tiles at both ends, and the bits of the way, a word that no others
            add up to. Where there is a start without a goal, both ends are it. Shape (ways, 5).
        area: Width and height [m].
        tile: Side of a tile [m].
        key: Of the draws.
        hazards: A table of `HazardRow`, with room for all; changed.
        first: The first of its rows to be filled. Those that are left over are empty.
        tiles: The true states with all hazards of the rows before; changed.
        work: A `work_array`, changed.

    Returns:
        The first row behind those that are filled: fewer than the fields want where no more have fitted.
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
            if not _fits(fields, f, (x, y, radius), stops, tile, tiles):
                continue
            if kind == BLOCK and not _block_disc(x, y, radius, tile, ways, tiles, work):
                continue
            add_disc(x, y, radius, kind, tile, tiles)
            row = hazards[behind]
            row["kind"], row["share"] = kind, field["share"]
            row["x"], row["y"], row["radius"], row["reach"] = x, y, radius, radius
            row["first"], row["corners"] = 0, 0
            behind, misses = behind + 1, 0
    for k in range(behind, hazards.shape[0]):
        hazards[k]["kind"] = 0
    return behind
