"""The ground as a UGV knows it: the tiles that its bumper and the radio have told it, and its plan on them.

Tile (row i, column j) of the size s is [j s, (j + 1) s] x [i s, (i + 1) s], its edges with it.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.messages.ground import BLOCK_SIDE
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.records import RecordArray, records
from sim.models.ground import NO_CLAIM, UNSEEN, TileArray
from sim.models.hazards import BLOCK
from sim.models.motion import no_motions

_NEVER = -1

PlaceArray = npt.NDArray[np.int32]
"""Tiles, row by row, or places of them."""


class GroundFlags(NamedTuple):
    """The whole numbers of a memory, and how far its plan goes: a row of an array of one."""

    goal: int = 0
    """Number of the goal that it drives to."""
    planned: int = _NEVER
    """In which tick its last search began; -1: none has yet."""
    target: int = _NEVER
    """The tile of the goal that the plan which it follows leads to, row by row; -1: it has none yet."""
    stale: int = 1
    """1 if tiles have changed since the last search began."""
    searching: int = 0
    """1 if that has not ended yet."""
    aim: int = _NEVER
    """The tile of the goal that it searches for a way to, or has last."""
    open: int = 0
    """Number of tiles in its heap."""
    plans: int = 0
    """Number of searches that have ended."""
    claim: int = NO_CLAIM
    """Claim of the newest tick: one of `sim.models.ground`'s."""
    settled: float = np.inf
    """Costs up to this one are final, when the search has ended; infinite: all are."""


class GroundMemory(NamedTuple):
    """A UGV's memory of the ground; from `ground_memory`. All arrays are changed in place."""

    tiles: TileArray
    """States. Shape (rows, columns)."""
    sure: TileArray
    """1 where the bumper has told the state, which makes no errors. Shape (rows, columns)."""
    draft: TileArray
    """Of the search: each tile as it was when that began, and the step to the next, see `agents.drivers.planning`.

    Shape (rows * columns,).
    """
    way: TileArray
    """The plan that is followed, as `draft` when the search ended. Shape (rows * columns,)."""
    cost: FloatArray
    """Of the search: of the cheapest way from the centre of a tile that it has touched to that of the goal's.

    Shape (rows * columns,).
    """
    heap: PlaceArray
    place: PlaceArray
    """Of the search: a binary heap of tiles, and where in it each is. Shape (rows * columns,)."""
    sent: RecordArray
    """`CheckedTrajectory` of the commands that were sent: that of tick k in row k % rows. (delay + 2,)"""
    flown: RecordArray
    """`CheckedTrajectory` of what the UGV flies, in a prediction. Shape (1,)."""
    flags: RecordArray
    """`GroundFlags`. Shape (1,)."""


def ground_memory(rows: int, columns: int, delay: int = 0) -> GroundMemory:
    """A fresh memory: no tile is known.

    Args:
        rows, columns: Of the tiles; (0, 0) for a driver that knows no ground.
        delay: So many ticks after it was sent a command acts.
    """
    size = rows * columns
    return GroundMemory(
        tiles=np.full((rows, columns), UNSEEN, dtype=np.uint8),
        sure=np.zeros((rows, columns), dtype=np.uint8),
        draft=np.full(size, UNSEEN, dtype=np.uint8),
        way=np.full(size, UNSEEN, dtype=np.uint8),
        cost=np.full(size, np.inf),
        heap=np.zeros(size, dtype=np.int32),
        place=np.full(size, _NEVER, dtype=np.int32),
        sent=no_motions(delay + 2),
        flown=no_motions(1),
        flags=records(GroundFlags, [GroundFlags()]),
    )


@compiled
def _set_tile(memory: GroundMemory, row: int, column: int, state: int) -> None:
    if memory.tiles[row, column] != state:
        memory.tiles[row, column] = state
        memory.flags[0].stale = 1


@compiled
def note_tiles(memory: GroundMemory, rows: IntArray, columns: IntArray, states: TileArray) -> None:
    """Take in tiles that the bumper has seen: its word stands against the radio's, before and after.

    Args:
        memory: Changed in place.
        rows, columns: Of each tile; those outside the map are ignored. Shape (tiles,).
        states: Of each tile; UNSEEN tells nothing. Shape (tiles,).
    """
    height, width = memory.tiles.shape
    for k in range(rows.shape[0]):
        i, j = rows[k], columns[k]
        if 0 <= i < height and 0 <= j < width and states[k] != UNSEEN:
            _set_tile(memory, i, j, states[k])
            memory.sure[i, j] = 1


@compiled
def note_block(memory: GroundMemory, block_row: int, block_column: int, states: TileArray) -> None:
    """Take in a block of tiles that the radio tells.

    What the bumper has said stays; of what the radio says of a tile BLOCK stays, the rest gives way to later words.

    Args:
        memory: Changed in place.
        block_row, block_column: Of the block; the first tile is BLOCK_SIDE times that.
        states: Row by row; those outside the map are ignored, UNSEEN tells nothing. Shape (BLOCK_SIDE²,).
    """
    height, width = memory.tiles.shape
    for k in range(min(BLOCK_SIDE * BLOCK_SIDE, states.shape[0])):
        i = block_row * BLOCK_SIDE + k // BLOCK_SIDE
        j = block_column * BLOCK_SIDE + k % BLOCK_SIDE
        if i < 0 or i >= height or j < 0 or j >= width or states[k] == UNSEEN:
            continue
        if memory.sure[i, j] == 0 and memory.tiles[i, j] != BLOCK:
            _set_tile(memory, i, j, states[k])
