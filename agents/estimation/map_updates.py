"""Map updates of a UAV to its UGV: which block of tiles to send by radio, and when. Beyond Klodt 2015.

The UAV sends the blocks around the UGV's estimated position: of those with new reports, the nearest first. It sends new
reports several times, since the radio loses messages. Without new reports it repeats the block sent longest ago. A map
update contains only reports of the UAV's own sensor, never its position, velocity or plan.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.messages.ground import BLOCK_SIDE, TILE_LETTERS, MapUpdate, TileReport
from bus.messages.vehicle import UavBriefing
from sim.compiling.compile import IntArray, compiled, inlined
from sim.models.ground import TileArray, block_letters, tiles_shape

_REPEATS = 3
"""Number of transmissions of new reports before older blocks are repeated."""
_MOST_DISTANCE = 12.0
"""Largest distance of a transmitted block from the UGV [m]."""
_TILES_PER_NUMBER = 16
"""Tiles per number of a message, three bits each."""
BLOCK_TILES = BLOCK_SIDE * BLOCK_SIDE
BLOCK_NUMBERS = BLOCK_TILES // _TILES_PER_NUMBER


class MapUpdateMemory(NamedTuple):
    """A UAV's map of the ground and its transmission state; the arrays change in place."""

    tiles: TileArray
    """States reported by the UAV's own sensor. Shape (rows, columns)."""
    repeats: IntArray
    """Remaining transmissions of each block as new. Shape (block rows, block columns)."""
    sent_tick: IntArray
    """Tick of the last transmission of each block; -1: never. Shape (block rows, block columns)."""


def map_update_memory(width: float, height: float, tile: float) -> MapUpdateMemory:
    """Return an empty map without transmissions.

    Args:
        width, height: Size of the area [m].
        tile: Width of a tile [m]; 0 without ground.
    """
    rows, columns = tiles_shape(width, height, tile) if tile > 0.0 else (0, 0)
    blocks = (-(-rows // BLOCK_SIDE), -(-columns // BLOCK_SIDE))
    return MapUpdateMemory(
        tiles=np.zeros((rows, columns), np.uint8),
        repeats=np.zeros(blocks, np.int64),
        sent_tick=np.full(blocks, -1, np.int64),
    )


@inlined
def map_updates_of(memory: MapUpdateMemory, world: int, uav: int) -> MapUpdateMemory:
    """Return the memory of one UAV in one world: views, no copies."""
    return MapUpdateMemory(
        memory.tiles[world, uav], memory.repeats[world, uav], memory.sent_tick[world, uav]
    )


@compiled
def record_tile(memory: MapUpdateMemory, column: int, row: int, state: int) -> None:
    """Record a tile reported by the UAV's own sensor."""
    if row < memory.tiles.shape[0] and column < memory.tiles.shape[1]:
        memory.tiles[row, column] = state
        memory.repeats[row // BLOCK_SIDE, column // BLOCK_SIDE] = _REPEATS


@compiled
def next_block(
    memory: MapUpdateMemory, tile: float, tick: int, g_x: float, g_y: float
) -> tuple[int, int]:
    """Select the block to send at this tick and mark it as sent; row and column, or -1, -1 if there is none.

    Args:
        memory: Changed in place.
        tile: Width of a tile [m].
        tick: Current tick.
        g_x, g_y: Estimated position of the UGV [m].
    """
    side, best_row, best_column = BLOCK_SIDE * tile, -1, -1
    best_is_new, best = False, math.inf
    for row in range(memory.repeats.shape[0]):
        d_y = (row + 0.5) * side - g_y
        for column in range(memory.repeats.shape[1]):
            is_new, sent_tick = memory.repeats[row, column] > 0, memory.sent_tick[row, column]
            if sent_tick < 0 and not is_new:
                continue
            d_x = (column + 0.5) * side - g_x
            far = d_x * d_x + d_y * d_y
            if far > _MOST_DISTANCE * _MOST_DISTANCE or (best_is_new and not is_new):
                continue
            value = far if is_new else float(sent_tick)
            if value < best or (is_new and not best_is_new):
                best_row, best_column, best_is_new, best = row, column, is_new, value
    if best_row >= 0:
        memory.sent_tick[best_row, best_column] = tick
        memory.repeats[best_row, best_column] = max(0, memory.repeats[best_row, best_column] - 1)
    return best_row, best_column


@compiled
def encode_block(tiles: TileArray, row: int, column: int, words: IntArray) -> None:
    """Encode the states of a block of tiles, three bits per tile, lowest bits first. Shape (BLOCK_WORDS,)."""
    for n in range(BLOCK_NUMBERS):
        word = 0
        for i in range(_TILES_PER_NUMBER):
            index = n * _TILES_PER_NUMBER + i
            r, c = row * BLOCK_SIDE + index // BLOCK_SIDE, column * BLOCK_SIDE + index % BLOCK_SIDE
            if r < tiles.shape[0] and c < tiles.shape[1]:
                word |= int(tiles[r, c]) << (3 * i)
        words[n] = word


@compiled
def decode_tile(words: IntArray, index: int) -> int:
    """Decode the state of one tile of a block from the numbers of `encode_block`."""
    return int(words[index // _TILES_PER_NUMBER] >> (3 * (index % _TILES_PER_NUMBER))) & 7


def map_update_ticks(rate: float, dt: float) -> int:
    """Return the period of map updates in ticks of dt [s], at a rate [1/s]; 0: no updates."""
    return max(1, round(1.0 / (rate * dt))) if rate > 0.0 else 0


class MapUpdateScheduler:
    """Scheduler of the map updates that a UAV's computer sends, whatever controls the UAV.

    Args:
        briefing: Briefing of the UAV.
    """

    def __init__(self, briefing: UavBriefing) -> None:
        ground, area = briefing.ground, briefing.area
        self._tile = ground.tile if ground is not None else 0.0
        self.memory = map_update_memory(area.width, area.height, self._tile)
        """Map and transmission state."""
        self._period = (
            map_update_ticks(ground.map_update_rate, briefing.dt) if ground is not None else 0
        )

    def record(self, tiles: Sequence[TileReport]) -> None:
        """Record tiles reported by the UAV's own sensor."""
        for tile in tiles:
            record_tile(self.memory, tile.column, tile.row, TILE_LETTERS.index(tile.state))

    def due(self, tick: int, target: tuple[float, float] | None) -> tuple[MapUpdate, ...]:
        """Return the map updates of this tick.

        Args:
            tick: Current tick.
            target: Estimated position of the UGV [m]; None if unknown.
        """
        if not self._period or target is None or tick % self._period:
            return ()
        row, column = next_block(self.memory, self._tile, tick, *target)
        if row < 0:
            return ()
        letters = block_letters(self.memory.tiles, row, column)
        return (MapUpdate(column=column, row=row, tiles=letters),)
