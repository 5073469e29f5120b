"""Coverage that the UAVs of a team share, compiled: blocks of cells to send, and the map that a law sees.

The coverage (3) is a sum over UAVs. Each sends its own contribution, which only grows: a receiver keeps the largest
value of each cell and sender, so nothing counts twice, whatever arrives.
"""

import math

from agents.team.records import TeamMemory, TeamParameters
from agents.uav_inputs import ByteArray, TeamPacket
from bus.messages.team import BLOCK_CELLS, MOST_COVERAGE_BLOCKS
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.models.vehicles import State

_REPEATS = 2
"""Number of transmissions of news before blocks without news are repeated."""
_LATER = 2**40
"""Added to the tick of a block's last transmission if it has no news."""


@compiled
def hear_blocks(memory: TeamMemory, message: TeamPacket) -> None:
    """Record the coverage in a team-mate's message."""
    rows, columns = memory.sent.shape
    across, count = memory.sent_tick.shape[1], memory.sent_tick.size
    for n in range(MOST_COVERAGE_BLOCKS):
        block = message.blocks[n]
        if block < 0 or block >= count:
            continue
        row, column = block // across * BLOCK_CELLS, block % across * BLOCK_CELLS
        for k in range(BLOCK_CELLS * BLOCK_CELLS):
            r, c = row + k // BLOCK_CELLS, column + k % BLOCK_CELLS
            if r < rows and c < columns:
                known = memory.heard[message.sender, r, c]
                memory.heard[message.sender, r, c] = max(known, message.cells[n, k])


@compiled
def _code_of(coverage: float, desired: float) -> int:
    """Return the byte of a cell's coverage: 255 is fully covered."""
    return min(255, int(255.0 * coverage / desired))


@compiled
def _news(sent: ByteArray, coverage: FloatArray, desired: float, row: int, column: int) -> int:
    """Return 2 if a cell of a block has changed since it was sent, 1 if any is covered, else 0."""
    found = 0
    for r in range(row, min(row + BLOCK_CELLS, sent.shape[0])):
        for c in range(column, min(column + BLOCK_CELLS, sent.shape[1])):
            code = _code_of(coverage[r, c], desired)
            if code != sent[r, c]:
                return 2
            if code > 0:
                found = 1
    return found


@compiled
def choose_blocks(
    memory: TeamMemory, coverage: FloatArray, desired: float, tick: int, blocks: IntArray
) -> None:
    """Choose the blocks of a message and record them as sent: news first, of these the ones sent longest ago.

    Args:
        memory: Memory of the UAV, changed in place.
        coverage: Its own map. Shape (rows, columns).
        desired: Desired coverage C*.
        tick: Current tick.
        blocks: Written: index of each chosen block, -1: none. Shape (MOST_COVERAGE_BLOCKS,).
    """
    keys = [math.inf] * MOST_COVERAGE_BLOCKS
    blocks[:] = -1
    across = memory.sent_tick.shape[1]
    for block in range(memory.sent_tick.size):
        row, column = block // across, block % across
        news = _news(memory.sent, coverage, desired, row * BLOCK_CELLS, column * BLOCK_CELLS)
        if news == 2:
            memory.repeats[row, column] = _REPEATS
        elif news == 0:
            continue
        key = float(memory.sent_tick[row, column])
        if memory.repeats[row, column] == 0:
            key += _LATER
        place = MOST_COVERAGE_BLOCKS
        while place > 0 and key < keys[place - 1]:
            place -= 1
        for k in range(MOST_COVERAGE_BLOCKS - 1, place, -1):
            keys[k], blocks[k] = keys[k - 1], blocks[k - 1]
        if place < MOST_COVERAGE_BLOCKS:
            keys[place], blocks[place] = key, block
    for k in range(MOST_COVERAGE_BLOCKS):
        if blocks[k] >= 0:
            _record_sent(memory, coverage, desired, blocks[k], tick)


@compiled
def _record_sent(
    memory: TeamMemory, coverage: FloatArray, desired: float, block: int, tick: int
) -> None:
    across, (rows, columns) = memory.sent_tick.shape[1], memory.sent.shape
    row, column = block // across, block % across
    memory.sent_tick[row, column] = tick
    memory.repeats[row, column] = max(0, memory.repeats[row, column] - 1)
    first, start = row * BLOCK_CELLS, column * BLOCK_CELLS
    for r in range(first, min(first + BLOCK_CELLS, rows)):
        for c in range(start, min(start + BLOCK_CELLS, columns)):
            memory.sent[r, c] = _code_of(coverage[r, c], desired)


@compiled
def share_coverage(
    parameters: TeamParameters,
    memory: TeamMemory,
    coverage: FloatArray,
    state: State,
    tick: int,
    cell: float,
    desired: float,
) -> None:
    """Write the coverage as the law sees it: the team's, and ground nearer to a team-mate as covered (Voronoi cells).

    Args:
        parameters: Constants of the UAV.
        memory: Memory of the UAV; `coverage` is changed.
        coverage: Its own map. Shape (rows, columns).
        state: Its state.
        tick: Current tick.
        cell: Width of a cell [m].
        desired: Desired coverage C*.
    """
    shown, mates = memory.coverage, memory.mates
    shown[:] = coverage
    scale = desired / 255.0
    for k in range(mates.shape[0]):
        mate = mates[k]
        if k == parameters.row or mate.tick < 0:
            continue
        near = tick - mate.tick <= parameters.silence_ticks
        for r in range(shown.shape[0]):
            y = (r + 0.5) * cell
            own_y, mate_y = (y - state.p_y) ** 2, (y - mate.y) ** 2
            for c in range(shown.shape[1]):
                x = (c + 0.5) * cell
                shown[r, c] += scale * memory.heard[k, r, c]
                if near and (x - mate.x) ** 2 + mate_y < (x - state.p_x) ** 2 + own_y:
                    shown[r, c] = max(shown[r, c], desired)
