"""Cheapest path over tiles to a goal: Dijkstra's search from the goal, with a binary heap, compiled.

A library would do for one UGV; a batch of worlds needs the same bits from compiled code. Equal costs are ordered by
tile, so equal tiles give the same plan to the bit.

A search settles a limited number of tiles per tick and resumes in the next, on the tiles as they were when it started.
The previous plan stays in use until the search ends. The limit is a number of tiles, never a time.
"""

import math

from agents.drivers.tile_map import IndexArray, OccupancyGrid
from sim.compiling.compile import FloatArray, compiled
from sim.models.ground import UNSEEN, TileArray
from sim.models.hazards import BLOCK, ROUGH

_DONE, _UNTOUCHED = -2, -1
DIAGONAL = math.sqrt(2.0)

_STATE, _BESIDE, _STEP = 7, 8, 16
"""Layout of the byte of a tile in a plan: mask of the state, flag of a blocked neighbour, unit of the step."""
_HERE = 5
"""Step of the goal. Steps are numbered like a keypad, row by row; 0: unknown."""
_BLOCKED_GOAL = 5
"""State of a goal in a blocked tile."""

UNSEEN_PRICE = 1.5
"""Cost of a metre on unseen ground, which is assumed to be passable; a metre on clear ground costs 1."""
BESIDE_PRICE = 0.5
"""Additional cost per metre of a tile beside a blocked one."""


@compiled
def is_beside_block(tiles: TileArray, i: int, j: int) -> bool:
    """Return whether a tile or one of its eight neighbours is blocked."""
    rows, columns = tiles.shape
    for r in range(max(i - 1, 0), min(i + 2, rows)):
        for c in range(max(j - 1, 0), min(j + 2, columns)):
            if tiles[r, c] == BLOCK:
                return True
    return False


@compiled
def price_of(rough: float, byte: int) -> float:
    """Return the cost of a metre in a tile that a search has touched; infinite if it is blocked.

    Args:
        rough: Cost of a metre on rough ground.
        byte: Byte of the tile in a plan.
    """
    state, cost = byte & _STATE, 1.0
    if state == BLOCK:
        return math.inf
    if state == ROUGH:
        cost = rough
    elif state == UNSEEN:
        cost = UNSEEN_PRICE
    if byte & _BESIDE:
        cost += BESIDE_PRICE
    return cost


@compiled
def _comes_first(cost: FloatArray, a: int, b: int) -> bool:
    return bool(cost[a] < cost[b] or (cost[a] == cost[b] and a < b))


@compiled
def _rise(cost: FloatArray, heap: IndexArray, heap_row: IndexArray, at: int) -> None:
    n = heap[at]
    while at > 0:
        above = (at - 1) // 2
        if not _comes_first(cost, n, heap[above]):
            break
        heap[at] = heap[above]
        heap_row[heap[at]] = at
        at = above
    heap[at] = n
    heap_row[n] = at


@compiled
def _sink(cost: FloatArray, heap: IndexArray, heap_row: IndexArray, count: int) -> None:
    n, at = heap[0], 0
    while 2 * at + 1 < count:
        below = 2 * at + 1
        if below + 1 < count and _comes_first(cost, heap[below + 1], heap[below]):
            below += 1
        if not _comes_first(cost, heap[below], n):
            break
        heap[at] = heap[below]
        heap_row[heap[at]] = at
        at = below
    heap[at] = n
    heap_row[n] = at


@compiled
def _touch(snapshot: TileArray, rows: int, columns: int, n: int) -> None:
    """Flag a tile that the search has reached if it is beside a blocked one."""
    i, j = n // columns, n % columns
    for r in range(max(i - 1, 0), min(i + 2, rows)):
        for c in range(max(j - 1, 0), min(j + 2, columns)):
            state = snapshot[r * columns + c] & _STATE
            if state in (BLOCK, _BLOCKED_GOAL):
                snapshot[n] |= _BESIDE
                return


@compiled
def start_search(memory: OccupancyGrid, goal: int) -> None:
    """Start a search on the tiles as they are known now; a goal in a blocked tile is approached.

    Args:
        memory: Changed in place.
        goal: Tile of the goal, row by row.
    """
    snapshot, heap_row, flags = memory.snapshot, memory.heap_row, memory.flags[0]
    rows, columns = memory.tiles.shape
    for i in range(rows):
        for j in range(columns):
            snapshot[i * columns + j] = memory.tiles[i, j]
            heap_row[i * columns + j] = _UNTOUCHED
    if snapshot[goal] == BLOCK:
        snapshot[goal] = _BLOCKED_GOAL
    _touch(snapshot, rows, columns, goal)
    snapshot[goal] |= _HERE * _STEP
    memory.cost[goal], memory.heap[0], heap_row[goal] = 0.0, goal, 0
    flags.aim, flags.open, flags.searching = goal, 1, 1


@compiled
def _expand(rough: float, tile: float, memory: OccupancyGrid, count: int, n: int) -> int:
    """Update the paths of a settled tile's neighbours, and return the number of tiles in the heap."""
    snapshot, cost, heap, heap_row = memory.snapshot, memory.cost, memory.heap, memory.heap_row
    rows, columns = memory.tiles.shape
    i, j, price = n // columns, n % columns, price_of(rough, snapshot[n])
    for row_step in range(-1 if i > 0 else 0, 2 if i + 1 < rows else 1):
        for column_step in range(-1 if j > 0 else 0, 2 if j + 1 < columns else 1):
            m = n + row_step * columns + column_step
            if heap_row[m] == _DONE or (snapshot[m] & _STATE) == BLOCK:
                continue
            length = tile
            if row_step != 0 and column_step != 0:
                if (
                    snapshot[n + row_step * columns] & _STATE == BLOCK
                    or snapshot[n + column_step] & _STATE == BLOCK
                ):
                    continue  # the step would cut a corner
                length = DIAGONAL * tile
            fresh = heap_row[m] == _UNTOUCHED
            if fresh:
                _touch(snapshot, rows, columns, m)
            new = cost[n] + 0.5 * (price + price_of(rough, snapshot[m])) * length
            back = (_HERE - 3 * row_step - column_step) * _STEP
            if fresh or new < cost[m]:
                cost[m] = new
                snapshot[m] = (snapshot[m] & (_STEP - 1)) | back
                if fresh:
                    heap[count], heap_row[m] = m, count
                    count += 1
                _rise(cost, heap, heap_row, heap_row[m])
            elif new == cost[m] and back < snapshot[m] & ~(_STEP - 1):
                snapshot[m] = (snapshot[m] & (_STEP - 1)) | back
    return count


@compiled
def continue_search(
    rough: float, tile: float, memory: OccupancyGrid, until: int, most: int
) -> bool:
    """Continue the search until the cheapest cost from a given tile to the goal is known.

    Args:
        rough: Cost of a metre on rough ground.
        tile: Side of a tile [m].
        memory: Changed in place, including `flags.settled` when the search ends.
        until: Tile at which the search may end; -1: none.
        most: Largest number of tiles to settle.

    Returns:
        True if the search has ended; the plan is in `snapshot`.
    """
    heap, heap_row, flags = memory.heap, memory.heap_row, memory.flags[0]
    count, settled = flags.open, 0
    if until < 0 or heap_row[until] != _DONE:
        while count > 0 and heap[0] != until:
            if settled == most:
                flags.open = count
                return False
            n = heap[0]
            settled += 1
            count -= 1
            heap_row[n] = _DONE
            if count > 0:
                heap[0] = heap[count]
                _sink(memory.cost, heap, heap_row, count)
            count = _expand(rough, tile, memory, count, n)
    flags.open, flags.searching = count, 0
    flags.settled = memory.cost[heap[0]] if count > 0 else math.inf
    return True


@compiled
def adopt_plan(memory: OccupancyGrid) -> None:
    """Adopt the plan of the search that has ended."""
    for n in range(memory.path.shape[0]):
        memory.path[n] = memory.snapshot[n]
    flags = memory.flags[0]
    flags.target = flags.aim
    flags.plans += 1


@compiled
def is_settled(memory: OccupancyGrid, n: int) -> bool:
    """Return whether the last search settled the cheapest path from a tile, or that there is none."""
    settled = memory.flags[0].settled
    return bool(
        math.isinf(settled) or (memory.heap_row[n] != _UNTOUCHED and memory.cost[n] <= settled)
    )


@compiled
def next_tile(path: TileArray, columns: int, n: int) -> int:
    """Return the next tile of a plan; the tile itself at the goal, or without a path.

    Args:
        path: Plan. Shape (rows * columns,).
        columns: Number of columns of the map.
        n: Tile.
    """
    step = path[n] // _STEP
    if step == 0:
        return n
    return int(n + ((step - 1) // 3 - 1) * columns + (step - 1) % 3 - 1)


@compiled
def path_corners(path: TileArray, columns: int, n: int, corners: IndexArray) -> int:
    """Find the tiles in which the path of a plan turns, including the first tile and the goal.

    Args:
        path: Plan. Shape (rows * columns,).
        columns: Number of columns of the map.
        n: First tile.
        corners: Changed in place; corners beyond its size are omitted. Shape (room,).

    Returns:
        The number of corners; 0 without a path.
    """
    count, before = 0, 0
    while count < corners.shape[0]:
        step = path[n] // _STEP
        if step != before:
            corners[count] = n
            count += 1
        if step in (0, _HERE):
            break
        n, before = next_tile(path, columns, n), step
    return count


@compiled
def has_path(path: TileArray, n: int) -> bool:
    """Return whether a plan has a path from a tile to its goal."""
    return bool(path[n] >= _STEP)
