r"""The square tiles in which the ground is seen, told and planned on, and the claims of cautious UGVs.

Tile (row i, column j) of the size s is $[j s, (j+1) s] \times [i s, (i+1) s]$, its edges with it: a hazard that touches
an edge touches the tiles on both sides.
"""

import math

import numpy as np
import numpy.typing as npt

from bus.messages.ground import BLOCK_SIDE, TILE_LETTERS
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray
from sim.models.hazards import BLOCK, FOUND, ROUGH, TOUCH

TileArray = npt.NDArray[np.uint8]
"""A map of tiles. Shape (rows, columns)."""

UNSEEN, CLEAR = 0, 1
"""States of a tile beside ROUGH, BLOCK and FOUND: nobody has seen it yet, which is not clear; and nothing touches it.

The truth is never UNSEEN."""
OUTSIDE = 5
"""In a picture of tiles: beyond the area. No tile has this state."""

NO_CLAIM, CERTIFIED, WAY_UNKNOWN, NO_STOP = range(4)
"""Claims of a cautious UGV at a tick: none; it stays on tiles that it knows to be drivable whatever becomes of its
commands; its way to a stop is not known to be drivable; its commands carry no stop."""
UNCERTIFIED = {
    WAY_UNKNOWN: "its way to a stop is not known to be drivable",
    NO_STOP: "its commands carry no stop",
}
"""Why the UGV does not certify, in words."""


def tiles_shape(width: float, height: float, tile: float) -> tuple[int, int]:
    """Rows and columns of the tiles of an area; the last ones may stick out.

    Args:
        width, height: Of the area [m].
        tile: Side of a tile [m].
    """
    return max(1, math.ceil(height / tile - TOUCH)), max(1, math.ceil(width / tile - TOUCH))


def tile_states(letters: str) -> TileArray:
    """The states of tiles from what a message calls them, letter by letter."""
    return np.array([TILE_LETTERS.index(letter) for letter in letters], dtype=np.uint8)


def block_letters(tiles: TileArray, row: int, column: int) -> str:
    """The states of a block of tiles as a message tells them; beyond the area they are not seen.

    Args:
        tiles: The map.
        row, column: Of the block: those of its first tile divided by `BLOCK_SIDE`.
    """
    side, block = BLOCK_SIDE, np.full((BLOCK_SIDE, BLOCK_SIDE), UNSEEN, np.uint8)
    cut = tiles[row * side : (row + 1) * side, column * side : (column + 1) * side]
    block[: cut.shape[0], : cut.shape[1]] = cut
    return "".join(TILE_LETTERS[state] for state in block.ravel().tolist())


@compiled
def tile_index(p: float, tile: float, count: int) -> int:
    """The row of a y, or the column of an x; the first or the last where it is outside.

    Args:
        p: Coordinate [m].
        tile: Side of a tile [m].
        count: How many rows or columns there are.
    """
    return int(min(max(math.floor(p / tile), 0), count - 1))


@compiled
def state_at(tiles: TileArray, tile: float, x: float, y: float) -> int:
    """State of the tile that a point lies in; outside the area that of the nearest.

    A point that touches a hazard lies in a tile whose true state is that of the hazard or one that goes before it:
    where this is CLEAR no hazard needs to be looked at, where it is ROUGH none that blocks.

    Args:
        tiles: The map.
        tile: Side of a tile [m].
        x, y: The point [m].
    """
    rows, columns = tiles.shape
    return int(tiles[tile_index(y, tile, rows), tile_index(x, tile, columns)])


@compiled
def span(low: float, high: float, tile: float, count: int) -> tuple[int, int]:
    """The rows or columns that an interval touches, from the first to behind the last.

    Args:
        low, high: The interval [m].
        tile: Side of a tile [m].
        count: How many rows or columns there are.
    """
    first = max(math.floor(low / tile), 0.0)
    end = min(math.floor(high / tile) + 1.0, float(count))
    return (int(first), int(end)) if first < end else (0, 0)


@compiled
def disc_rows(y: float, radius: float, tile: float, rows: int) -> tuple[int, int]:
    """The rows of tiles that a disc touches, from the first to behind the last.

    Args:
        y: Of its centre [m].
        radius: Of the disc [m].
        tile: Side of a tile [m].
        rows: How many there are.
    """
    return span(y - radius - TOUCH, y + radius + TOUCH, tile, rows)


@compiled
def disc_columns(
    x: float, y: float, radius: float, tile: float, row: int, columns: int
) -> tuple[int, int]:
    """The columns of tiles that a disc touches in a row, from the first to behind the last.

    Args:
        x, y: Its centre [m].
        radius: Of the disc [m].
        tile: Side of a tile [m].
        row: Which.
        columns: How many there are.
    """
    reach = radius + TOUCH
    away = max(row * tile - y, y - (row + 1) * tile, 0.0)
    if away > reach:
        return 0, 0
    half = math.sqrt(reach * reach - away * away)
    return span(x - half, x + half, tile, columns)


@compiled
def add_disc(x: float, y: float, radius: float, state: int, tile: float, tiles: TileArray) -> None:
    """Give the tiles that a disc touches a state; those that are BLOCK stay so.

    Args:
        x, y: Its centre [m].
        radius: Of the disc [m].
        state: ROUGH, BLOCK or FOUND.
        tile: Side of a tile [m].
        tiles: The map, changed.
    """
    rows, columns = tiles.shape
    first, end = disc_rows(y, radius, tile, rows)
    for i in range(first, end):
        begin, behind = disc_columns(x, y, radius, tile, i, columns)
        for j in range(begin, behind):
            if tiles[i, j] != BLOCK:
                tiles[i, j] = state


@compiled
def edge_within(
    a_x: float, a_y: float, b_x: float, b_y: float, low: float, high: float
) -> tuple[float, float]:
    """The least and the largest x of the part of an edge whose y lies between two; turned round where none does.

    Args:
        a_x, a_y, b_x, b_y: Its ends [m].
        low, high: The two [m].
    """
    if max(a_y, b_y) < low or min(a_y, b_y) > high:
        return math.inf, -math.inf
    begin, end = 0.0, 1.0
    if a_y != b_y:
        one, other = (low - a_y) / (b_y - a_y), (high - a_y) / (b_y - a_y)
        begin, end = max(begin, min(one, other)), min(end, max(one, other))
    one, other = a_x + begin * (b_x - a_x), a_x + end * (b_x - a_x)
    return min(one, other), max(one, other)


@compiled
def _fill_polygon(corners: FloatArray, state: int, tile: float, tiles: TileArray) -> None:
    """Set the tiles that a polygon touches: those its edges pass, and those whose centre line lies in it."""
    rows, columns = tiles.shape
    count = corners.shape[0]
    crossings = np.empty(count)
    lowest, highest = span(corners[:, 1].min() - TOUCH, corners[:, 1].max() + TOUCH, tile, rows)
    for i in range(lowest, highest):
        low, middle, high = i * tile - TOUCH, (i + 0.5) * tile, (i + 1) * tile + TOUCH
        met = 0
        a_x, a_y = corners[count - 1, 0], corners[count - 1, 1]
        for n in range(count):
            b_x, b_y = corners[n, 0], corners[n, 1]
            left, right = edge_within(a_x, a_y, b_x, b_y, low, high)
            if left <= right:
                first, behind = span(left - TOUCH, right + TOUCH, tile, columns)
                tiles[i, first:behind] = state
            if (a_y > middle) != (b_y > middle):
                crossings[met] = a_x + (b_x - a_x) * (middle - a_y) / (b_y - a_y)
                met += 1
            a_x, a_y = b_x, b_y
        inside = np.sort(crossings[:met])
        for n in range(0, met - 1, 2):
            first, behind = span(inside[n], inside[n + 1], tile, columns)
            tiles[i, first:behind] = state


@compiled
def fill_tiles(hazards: RecordArray, corners: FloatArray, tile: float, tiles: TileArray) -> None:
    """Give each tile its true state: BLOCK if a blocking hazard touches it, else ROUGH, else FOUND, else CLEAR.

    Args:
        hazards, corners: As in `distance_to_hazard`.
        tile: Side of a tile [m].
        tiles: The map, changed.
    """
    tiles[:, :] = CLEAR
    for kind in (FOUND, ROUGH, BLOCK):
        for k in range(hazards.shape[0]):
            row = hazards[k]
            if row["kind"] != kind:
                continue
            if row["corners"] == 0:
                add_disc(row["x"], row["y"], row["radius"], kind, tile, tiles)
            else:
                end = row["first"] + row["corners"]
                _fill_polygon(corners[row["first"] : end], kind, tile, tiles)


@compiled
def tile_patches(tiles: TileArray, tile: float, position: FloatArray, pictures: TileArray) -> None:
    """Fill pictures with the tiles around those that vehicles stand on, which are their middles; rows go north.

    Args:
        tiles: States, as each vehicle knows them. Shape (vehicles, rows, columns).
        tile: Side of a tile [m].
        position: Of each [m]. Shape (vehicles, 2).
        pictures: Are changed; OUTSIDE beyond the area. Shape (vehicles, side, side), an odd number.
    """
    rows, columns = tiles.shape[1], tiles.shape[2]
    side = pictures.shape[1]
    for k in range(pictures.shape[0]):
        first = tile_index(position[k, 1], tile, rows) - side // 2
        left = tile_index(position[k, 0], tile, columns) - side // 2
        for i in range(side):
            for j in range(side):
                row, column = first + i, left + j
                inside = 0 <= row < rows and 0 <= column < columns
                pictures[k, i, j] = tiles[k, row, column] if inside else OUTSIDE
