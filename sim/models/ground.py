r"""Square ground tiles for observation, reports and planning, and the claims of cautious UGVs.

Tile (row i, column j) of size s is $[j s, (j+1) s] \times [i s, (i+1) s]$, including its edges: a hazard that touches
an edge touches the tiles on both sides.
"""

import math

import numpy as np
import numpy.typing as npt

from bus.messages.ground import BLOCK_SIDE, TILE_LETTERS
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray
from sim.models.hazards import BLOCK, FOUND, ROUGH, TOUCH
from sim.models.polygons import segment_distance2

TileArray = npt.NDArray[np.uint8]
"""Map of tiles. Shape (rows, columns)."""

UNSEEN, CLEAR = 0, 1
"""States of a tile besides ROUGH, BLOCK and FOUND: unknown, which is not clear, and touched by no hazard.

True states are never UNSEEN."""
OUTSIDE = 5
"""State outside the area, in a picture of tiles. No tile has it."""

NO_CLAIM, CERTIFIED, PATH_UNKNOWN, NO_STOP, NOT_OWN = range(5)
"""Claims of a cautious UGV at a tick: none; it stays on tiles known to be drivable, even if commands are lost; its
stopping path is not known to be drivable; its commands carry no stopping trajectory; it may still execute commands of
another driver.
"""
UNCERTIFIED = {
    PATH_UNKNOWN: "its stopping path is not known to be drivable",
    NO_STOP: "its commands carry no stopping trajectory",
    NOT_OWN: "it may still execute commands of another driver or process",
}
"""Reason why the UGV is not certified, as text."""


def tiles_shape(width: float, height: float, tile: float) -> tuple[int, int]:
    """Return the rows and columns of the tiles of an area; the last ones may extend beyond it.

    Args:
        width, height: Size of the area [m].
        tile: Side of a tile [m].
    """
    return max(1, math.ceil(height / tile - TOUCH)), max(1, math.ceil(width / tile - TOUCH))


def tile_states(letters: str) -> TileArray:
    """Return the states of tiles from their letters in a message."""
    return np.array([TILE_LETTERS.index(letter) for letter in letters], dtype=np.uint8)


def block_letters(tiles: TileArray, row: int, column: int) -> str:
    """Return the states of a block of tiles as letters for a message; tiles outside the area are unknown.

    Args:
        tiles: The map.
        row, column: Index of the block: row and column of its first tile divided by `BLOCK_SIDE`.
    """
    side, block = BLOCK_SIDE, np.full((BLOCK_SIDE, BLOCK_SIDE), UNSEEN, np.uint8)
    cut = tiles[row * side : (row + 1) * side, column * side : (column + 1) * side]
    block[: cut.shape[0], : cut.shape[1]] = cut
    return "".join(TILE_LETTERS[state] for state in block.ravel().tolist())


@compiled
def tile_index(p: float, tile: float, count: int) -> int:
    """Return the row of a y, or the column of an x; outside, the first or the last.

    Args:
        p: Coordinate [m].
        tile: Side of a tile [m].
        count: Number of rows or columns.
    """
    return int(min(max(math.floor(p / tile), 0), count - 1))


@compiled
def state_at(tiles: TileArray, tile: float, x: float, y: float) -> int:
    """Return the state of the tile at a point; outside the area, of the nearest tile.

    Its true state equals the state of any hazard at the point, or takes precedence over it: at CLEAR there is no hazard
    to check, at ROUGH no blocking one.

    Args:
        tiles: The map.
        tile: Side of a tile [m].
        x, y: The point [m].
    """
    rows, columns = tiles.shape
    return int(tiles[tile_index(y, tile, rows), tile_index(x, tile, columns)])


@compiled
def span(low: float, high: float, tile: float, count: int) -> tuple[int, int]:
    """Return the rows or columns that an interval touches: the first, and the one after the last.

    Args:
        low, high: The interval [m].
        tile: Side of a tile [m].
        count: Number of rows or columns.
    """
    first = max(math.floor(low / tile), 0.0)
    end = min(math.floor(high / tile) + 1.0, float(count))
    return (int(first), int(end)) if first < end else (0, 0)


@compiled
def disc_rows(y: float, radius: float, tile: float, rows: int) -> tuple[int, int]:
    """Return the rows of tiles that a disc touches: the first, and the one after the last.

    Args:
        y: Center of the disc [m].
        radius: Radius of the disc [m].
        tile: Side of a tile [m].
        rows: Number of rows.
    """
    return span(y - radius - TOUCH, y + radius + TOUCH, tile, rows)


@compiled
def disc_columns(
    x: float, y: float, radius: float, tile: float, row: int, columns: int
) -> tuple[int, int]:
    """Return the columns of tiles that a disc touches in a row: the first, and the one after the last.

    Args:
        x, y: Center of the disc [m].
        radius: Radius of the disc [m].
        tile: Side of a tile [m].
        row: Index of the row.
        columns: Number of columns.
    """
    touching = radius + TOUCH
    away = max(row * tile - y, y - (row + 1) * tile, 0.0)
    if away > touching:
        return 0, 0
    half = math.sqrt(touching * touching - away * away)
    return span(x - half, x + half, tile, columns)


@compiled
def add_disc(x: float, y: float, radius: float, state: int, tile: float, tiles: TileArray) -> None:
    """Set the state of the tiles that a disc touches, except for BLOCK tiles.

    Args:
        x, y: Center of the disc [m].
        radius: Radius of the disc [m].
        state: ROUGH, BLOCK or FOUND.
        tile: Side of a tile [m].
        tiles: The map; changed.
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
    """Return the smallest and largest x of the part of an edge with y in an interval; inverted if there is none.

    Args:
        a_x, a_y, b_x, b_y: Ends of the edge [m].
        low, high: The interval [m].
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
    """Set the tiles that a polygon touches: those crossed by its edges, and those whose center line lies inside."""
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
def _end_distance2(
    a_x: float, a_y: float, b_x: float, b_y: float, left: float, low: float, tile: float
) -> float:
    """Return the squared distance between a segment and a tile from the ends of one to the other [m²].

    It is the squared distance of the two if they have no common point: the nearest points of convex polygons include
    a corner.
    """
    right, high, nearest = left + tile, low + tile, math.inf
    for x in (left, right):
        for y in (low, high):
            nearest = min(nearest, segment_distance2(a_x, a_y, b_x, b_y, x, y))
    for x, y in ((a_x, a_y), (b_x, b_y)):
        d_x, d_y = max(left - x, x - right, 0.0), max(low - y, y - high, 0.0)
        nearest = min(nearest, d_x * d_x + d_y * d_y)
    return nearest


@compiled
def add_polygon(
    corners: FloatArray, margin: float, state: int, tile: float, tiles: TileArray
) -> None:
    """Set the state of the tiles that a polygon touches, or comes as near as `margin`.

    Every point of another tile is farther than `margin` from the polygon.

    Args:
        corners: Corners of a simple polygon in order [m]. Shape (corners, 2).
        margin: Distance [m].
        state: ROUGH, BLOCK or FOUND.
        tile: Side of a tile [m].
        tiles: The map; changed.
    """
    _fill_polygon(corners, state, tile, tiles)
    rows, columns = tiles.shape
    far = margin + TOUCH
    a_x, a_y = corners[corners.shape[0] - 1, 0], corners[corners.shape[0] - 1, 1]
    for n in range(corners.shape[0]):
        b_x, b_y = corners[n, 0], corners[n, 1]
        first, end = span(min(a_y, b_y) - far, max(a_y, b_y) + far, tile, rows)
        for i in range(first, end):
            low, high = i * tile - far, (i + 1) * tile + far
            left, right = edge_within(a_x, a_y, b_x, b_y, low, high)
            if left > right:
                continue
            begin, behind = span(left - far, right + far, tile, columns)
            for j in range(begin, behind):
                if tiles[i, j] != state and (
                    _end_distance2(a_x, a_y, b_x, b_y, j * tile, i * tile, tile) <= far * far
                ):
                    tiles[i, j] = state
        a_x, a_y = b_x, b_y


@compiled
def fill_tiles(hazards: RecordArray, corners: FloatArray, tile: float, tiles: TileArray) -> None:
    """Set the true state of each tile: BLOCK if a blocking hazard touches it, else ROUGH, else FOUND, else CLEAR.

    Args:
        hazards, corners: As in `distance_to_hazard`.
        tile: Side of a tile [m].
        tiles: The map; changed.
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
    """Fill pictures with the tiles around vehicles; the vehicle's tile is in the middle, and rows increase northwards.

    Args:
        tiles: States, as each vehicle knows them. Shape (vehicles, rows, columns).
        tile: Side of a tile [m].
        position: Position of each vehicle [m]. Shape (vehicles, 2).
        pictures: Pictures; changed. OUTSIDE beyond the area. Shape (vehicles, side, side), side odd.
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
