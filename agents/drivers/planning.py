"""The cheapest way over tiles to a goal: Dijkstra's search from the goal, with a binary heap, compiled.

A library would do for one UGV; a batch of worlds needs the same bits from compiled code. Of equal costs the tile
that comes first goes first, so the same tiles give the same plan to the bit.
"""

import math
from typing import NamedTuple

from agents.drivers.tile_map import GroundMemory
from sim.kernels.compile import FloatArray, IntArray, borrowing, compiled
from sim.models.ground import BLOCK, ROUGH, UNSEEN, TileArray

_DONE, _UNTOUCHED = -2, -1
DIAGONAL = math.sqrt(2.0)


class Prices(NamedTuple):
    """Cost of a metre, where one on clear ground costs 1."""

    rough: float
    """On rough ground."""
    unseen: float
    """On ground that nobody has seen: the way is believed to go on there."""
    beside: float
    """Beside a blocked tile, in addition."""


@compiled
def is_beside_block(tiles: TileArray, i: int, j: int) -> bool:
    """True if a tile is blocked, or one of the eight around it."""
    rows, columns = tiles.shape
    for r in range(max(i - 1, 0), min(i + 2, rows)):
        for c in range(max(j - 1, 0), min(j + 2, columns)):
            if tiles[r, c] == BLOCK:
                return True
    return False


@borrowing
def set_prices(prices: Prices, tiles: TileArray, price: FloatArray) -> None:
    """Give each tile its cost of a metre; infinite where it is blocked.

    Args:
        prices: What a state costs.
        tiles: The map.
        price: Changed. Shape (rows * columns,).
    """
    rows, columns = tiles.shape
    for i in range(rows):
        for j in range(columns):
            state, cost = tiles[i, j], 1.0
            if state == BLOCK:
                cost = math.inf
            elif state == ROUGH:
                cost = prices.rough
            elif state == UNSEEN:
                cost = prices.unseen
            if state != BLOCK and is_beside_block(tiles, i, j):
                cost += prices.beside
            price[i * columns + j] = cost


@compiled
def _comes_first(cost: FloatArray, a: int, b: int) -> bool:
    return bool(cost[a] < cost[b] or (cost[a] == cost[b] and a < b))


@borrowing
def _rise(cost: FloatArray, heap: IntArray, place: IntArray, at: int) -> None:
    n = heap[at]
    while at > 0:
        above = (at - 1) // 2
        if not _comes_first(cost, n, heap[above]):
            break
        heap[at] = heap[above]
        place[heap[at]] = at
        at = above
    heap[at] = n
    place[n] = at


@borrowing
def _sink(cost: FloatArray, heap: IntArray, place: IntArray, count: int) -> None:
    n, at = heap[0], 0
    while 2 * at + 1 < count:
        below = 2 * at + 1
        if below + 1 < count and _comes_first(cost, heap[below + 1], heap[below]):
            below += 1
        if not _comes_first(cost, heap[below], n):
            break
        heap[at] = heap[below]
        place[heap[at]] = at
        at = below
    heap[at] = n
    place[n] = at


@compiled
def step_cost(
    price: FloatArray, columns: int, tile: float, n: int, row_step: int, column_step: int
) -> float:
    """Cost of the way from the centre of a tile to that of a neighbour; infinite where it cuts a blocked corner.

    Args:
        price: Of each tile.
        columns: Of the map.
        tile: Side of a tile [m].
        n: The tile; its neighbour is in the map.
        row_step, column_step: To the neighbour: -1, 0 or 1.
    """
    m = n + row_step * columns + column_step
    mean = float(0.5 * (price[n] + price[m]))
    if row_step == 0 or column_step == 0:
        return mean * tile
    if math.isinf(price[n + row_step * columns]) or math.isinf(price[n + column_step]):
        return math.inf
    return mean * (DIAGONAL * tile)


@borrowing
def search(
    price: FloatArray,
    columns: int,
    tile: float,
    goal: int,
    until: int,
    cost: FloatArray,
    heap: IntArray,
    place: IntArray,
) -> float:
    """The cost of the cheapest way from each tile to the goal, until that from one of them is known.

    Args:
        price: Of a metre in each tile; infinite: there is no way. Shape (rows * columns,).
        columns: Of the map.
        tile: Side of a tile [m].
        goal: The goal's tile, row by row.
        until: Where the search may end; -1: nowhere.
        cost: Changed; infinite where there is no way. Shape (rows * columns,).
        heap, place: Room for the search, likewise.

    Returns:
        Costs up to this one are final; infinite: all are.
    """
    size = price.shape[0]
    rows = size // columns
    for n in range(size):
        cost[n], place[n] = math.inf, _UNTOUCHED
    cost[goal], heap[0], place[goal], count = 0.0, goal, 0, 1
    while count > 0:
        n = heap[0]
        if n == until:
            return float(cost[n])
        count -= 1
        place[n] = _DONE
        if count > 0:
            heap[0] = heap[count]
            _sink(cost, heap, place, count)
        i, j = n // columns, n % columns
        for row_step in range(-1 if i > 0 else 0, 2 if i + 1 < rows else 1):
            for column_step in range(-1 if j > 0 else 0, 2 if j + 1 < columns else 1):
                m = n + row_step * columns + column_step
                if place[m] == _DONE:
                    continue
                new = cost[n] + step_cost(price, columns, tile, n, row_step, column_step)
                if new < cost[m]:
                    cost[m] = new
                    if place[m] == _UNTOUCHED:
                        heap[count], place[m] = m, count
                        count += 1
                    _rise(cost, heap, place, place[m])
    return math.inf


@borrowing
def plan(prices: Prices, tile: float, memory: GroundMemory, goal: int, until: int) -> float:
    """Plan anew to a goal on the tiles as they are known now; a goal in a blocked tile is approached.

    Args:
        prices: What ground costs.
        tile: Side of a tile [m].
        memory: `price` and `cost` are changed.
        goal, until: As in `search`.

    Returns:
        As `search`.
    """
    set_prices(prices, memory.tiles, memory.price)
    if math.isinf(memory.price[goal]):
        memory.price[goal] = 1.0 + prices.beside
    columns = memory.tiles.shape[1]
    return search(memory.price, columns, tile, goal, until, memory.cost, memory.heap, memory.place)


@borrowing
def next_tile(price: FloatArray, cost: FloatArray, columns: int, tile: float, n: int) -> int:
    """The neighbour through which the cheapest way goes; the tile itself where it ends, or where there is none.

    Args:
        price, cost: Of each tile, after a search.
        columns: Of the map.
        tile: Side of a tile [m].
        n: The tile.
    """
    rows = price.shape[0] // columns
    i, j = n // columns, n % columns
    best, least = n, math.inf
    if cost[n] == 0.0:
        return n
    for row_step in range(-1 if i > 0 else 0, 2 if i + 1 < rows else 1):
        for column_step in range(-1 if j > 0 else 0, 2 if j + 1 < columns else 1):
            if row_step == 0 and column_step == 0:
                continue
            m = n + row_step * columns + column_step
            on = cost[m] + step_cost(price, columns, tile, n, row_step, column_step)
            if on < least:
                best, least = m, on
    return best
