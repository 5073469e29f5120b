"""Occupancy grid of a UGV: tiles reported by its own sensor and by radio, and its plan on them.

Tile (row i, column j) of the size s is [j s, (j + 1) s] x [i s, (i + 1) s], edges included.

A UGV that keeps a distance c from unknown buildings plans on its reports, enlarged by c: a tile is blocked if a tile
within c of it was reported as blocked, and unseen if one within c was not reported yet.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.messages.ground import BLOCK_SIDE
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.records import RecordArray, records
from sim.models.ground import NO_CLAIM, UNSEEN, TileArray
from sim.models.hazards import BLOCK
from sim.models.trajectories import NO_TRAJECTORY, no_trajectories

_NEVER = -1
MEASURED, MAPPED = 1, 2
"""Sources of a tile's state that no radio report overrides: the UGV's own sensor or a complete map, which are exact;
and a building of the map, near which the UGV must not drive even where the ground is clear.
"""

IndexArray = npt.NDArray[np.int32]
"""Tiles, row by row, or positions of tiles."""


class GridFlags(NamedTuple):
    """Scalars of an occupancy grid: flags, counters and the extent of its plan."""

    goal: int = 0
    """Number of the current goal."""
    planned: int = _NEVER
    """Tick in which the last search started; -1: none yet."""
    target: int = _NEVER
    """Goal tile of the plan in use, row by row; -1: none yet."""
    stale: int = 1
    """1 if tiles have changed since the last search started."""
    searching: int = 0
    """1 if the search has not ended yet."""
    aim: int = _NEVER
    """Goal tile of the current or last search, row by row."""
    open: int = 0
    """Number of tiles in the heap."""
    plans: int = 0
    """Number of completed searches."""
    claim: int = NO_CLAIM
    """Claim of the newest tick: a constant of `sim.models.ground`."""
    settled: float = np.inf
    """Cost up to which the costs of a completed search are final; infinite: all are."""
    clearance: float = -1.0
    """Distance to keep from every tile that is not known to be drivable, in sides of a tile; -1: none."""
    answered: int = _NEVER
    """Last tick with a command; -1: none, or its command may not have been sent."""
    since: int = _NEVER
    """First tick of the first trajectory that shows that no other commands are in effect; -1: none ever were."""
    p_x: float = 0.0
    p_y: float = 0.0
    v_x: float = 0.0
    v_y: float = 0.0
    heading: float = 0.0
    """State of the UGV in the tick `answered`: position [m], velocity [m/s] and heading [rad]."""
    gear: int = 0
    """Direction in which a car turns about: 1: forwards; -1: in reverse; 0: it does not."""


class OccupancyGrid(NamedTuple):
    """Occupancy grid of a UGV, from `occupancy_grid`. All arrays are changed in place."""

    tiles: TileArray
    """States to plan on: the reported ones, enlarged by the clearance. Shape (rows, columns)."""
    reported: TileArray
    """Reported states. Shape (rows, columns)."""
    blocked: IndexArray
    unseen: IndexArray
    """Number of tiles within the clearance that are blocked, or unseen. Shape (rows, columns)."""
    measured: TileArray
    """`MEASURED` or `MAPPED` if the state has this source; else 0. Shape (rows, columns)."""
    snapshot: TileArray
    """Snapshot for the search: tiles at its start, with the step to the next tile, see `agents.drivers.planning`.

    Shape (rows * columns,).
    """
    path: TileArray
    """Plan in use: a copy of `snapshot` from the end of the search. Shape (rows * columns,)."""
    cost: FloatArray
    """Cost of the cheapest known path from the centre of a touched tile to the centre of the goal's tile.

    Shape (rows * columns,).
    """
    heap: IndexArray
    heap_row: IndexArray
    """Binary heap of tiles in the search, and the index of each tile in it. Shape (rows * columns,)."""
    sent: RecordArray
    """`CheckedTrajectory` of each sent command: the one of tick k in row k % rows. Shape (delay + 2,)."""
    committed: RecordArray
    """`CheckedTrajectory` that the UGV executes, during a prediction. Shape (1,)."""
    flags: RecordArray
    """`GridFlags`. Shape (1,)."""


EXTRA_ROWS = 2
"""Rows of pending commands beyond the delay [ticks]."""


def occupancy_grid(
    rows: int, columns: int, delay: int = 0, clearance: float = -1.0
) -> OccupancyGrid:
    """Return an empty occupancy grid: no tile is known.

    Args:
        rows, columns: Size of the grid; (0, 0) for a driver that knows no ground.
        delay: Delay after which a sent command takes effect [ticks].
        clearance: See `GridFlags`.
    """
    size = rows * columns
    return OccupancyGrid(
        tiles=np.full((rows, columns), UNSEEN, dtype=np.uint8),
        reported=np.full((rows, columns), UNSEEN, dtype=np.uint8),
        blocked=np.zeros((rows, columns), dtype=np.int32),
        unseen=_near_tiles(rows, columns, clearance),
        measured=np.zeros((rows, columns), dtype=np.uint8),
        snapshot=np.full(size, UNSEEN, dtype=np.uint8),
        path=np.full(size, UNSEEN, dtype=np.uint8),
        cost=np.full(size, np.inf),
        heap=np.zeros(size, dtype=np.int32),
        heap_row=np.full(size, _NEVER, dtype=np.int32),
        sent=no_trajectories(delay + EXTRA_ROWS),
        committed=no_trajectories(1),
        flags=records(GridFlags, [GridFlags(clearance=clearance)]),
    )


def forget_plan(memory: OccupancyGrid) -> None:
    """Forget plan, commands and claims, and keep all tiles: a new driver takes over."""
    clearance = float(memory.flags[0]["clearance"])
    memory.flags[...] = records(GridFlags, [GridFlags(clearance=clearance)])
    memory.sent[...] = no_trajectories(len(memory.sent))
    memory.path[...] = UNSEEN


def forget_sent(memory: OccupancyGrid) -> None:
    """Forget the commands so far: they were not sent, or another process sent them."""
    memory.sent["begins"], memory.flags["answered"] = NO_TRAJECTORY, _NEVER


def _near_tiles(rows: int, columns: int, clearance: float) -> IndexArray:
    """Return the number of tiles within the clearance of each tile. Shape (rows, columns)."""
    i, j = np.arange(rows), np.arange(columns)
    found, margin = np.zeros((rows, columns), dtype=np.int32), math.floor(clearance) + 1
    for away in range(-margin, margin + 1):
        rest = math.floor(clearance * clearance) - max(abs(away) - 1, 0) ** 2
        half = math.isqrt(rest) + 1 if margin else 0
        inside = (i + away >= 0) & (i + away < rows)
        found += np.outer(inside, np.minimum(j + half, columns - 1) - np.maximum(j - half, 0) + 1)
    return found


@compiled
def _is_near(clearance: float, d_row: int, d_column: int) -> bool:
    """Return whether two tiles have points within the clearance."""
    rows, columns = max(abs(d_row) - 1.0, 0.0), max(abs(d_column) - 1.0, 0.0)
    same = d_row == 0 and d_column == 0
    return same or (clearance >= 0.0 and rows * rows + columns * columns <= clearance * clearance)


@compiled
def _set_tile(memory: OccupancyGrid, row: int, column: int, state: int) -> None:
    """Store a reported state, and update the tiles near it."""
    before = memory.reported[row, column]
    if before == state:
        return
    memory.reported[row, column] = state
    clearance, (height, width) = memory.flags[0].clearance, memory.reported.shape
    margin = math.floor(clearance) + 1
    for i in range(max(row - margin, 0), min(row + margin + 1, height)):
        for j in range(max(column - margin, 0), min(column + margin + 1, width)):
            if not _is_near(clearance, i - row, j - column):
                continue
            memory.blocked[i, j] += (state == BLOCK) - (before == BLOCK)
            memory.unseen[i, j] += (state == UNSEEN) - (before == UNSEEN)
            enlarged = memory.reported[i, j]
            if memory.unseen[i, j] > 0:
                enlarged = UNSEEN
            if memory.blocked[i, j] > 0:
                enlarged = BLOCK
            if memory.tiles[i, j] != enlarged:
                memory.tiles[i, j] = enlarged
                memory.flags[0].stale = 1


@compiled
def record_tiles(
    memory: OccupancyGrid, rows: IntArray, columns: IntArray, states: TileArray
) -> None:
    """Record tiles measured by the UGV's own sensor; they override all radio reports, earlier and later ones.

    Tiles that the map has blocked keep their state.

    Args:
        memory: Changed in place.
        rows, columns: Tiles; those outside the map are ignored. Shape (tiles,).
        states: State of each tile; UNSEEN carries no information. Shape (tiles,).
    """
    height, width = memory.tiles.shape
    for k in range(rows.shape[0]):
        i, j = rows[k], columns[k]
        if i < 0 or i >= height or j < 0 or j >= width or states[k] == UNSEEN:
            continue
        if memory.measured[i, j] != MAPPED:
            _set_tile(memory, i, j, states[k])
            memory.measured[i, j] = MEASURED


@compiled
def record_block(
    memory: OccupancyGrid, block_row: int, block_column: int, states: TileArray
) -> None:
    """Record a block of tiles received by radio.

    Tiles measured by the UGV's own sensor, or known from its map, keep their state. A tile reported as BLOCK by radio
    also keeps it; other states are overwritten by later reports.

    Args:
        memory: Changed in place.
        block_row, block_column: Index of the block; its first tile is BLOCK_SIDE times the index.
        states: States row by row; tiles outside the map and UNSEEN are ignored. Shape (BLOCK_SIDE²,).
    """
    height, width = memory.tiles.shape
    for k in range(min(BLOCK_SIDE * BLOCK_SIDE, states.shape[0])):
        i = block_row * BLOCK_SIDE + k // BLOCK_SIDE
        j = block_column * BLOCK_SIDE + k % BLOCK_SIDE
        if i < 0 or i >= height or j < 0 or j >= width or states[k] == UNSEEN:
            continue
        if memory.measured[i, j] == 0 and memory.reported[i, j] != BLOCK:
            _set_tile(memory, i, j, states[k])
