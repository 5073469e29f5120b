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
_REACH = 12.0
"""Largest distance of a transmitted block from the UGV [m]."""
_WORD_TILES = 16
"""Tiles per number of a message, three bits each."""
BLOCK_TILES = BLOCK_SIDE * BLOCK_SIDE
BLOCK_WORDS = BLOCK_TILES // _WORD_TILES


class TellingMemory(NamedTuple):
    """A UAV's map of the ground and its transmission state; the arrays change in place."""

    tiles: TileArray
    """States reported by the UAV's own sensor. Shape (rows, columns)."""
    news: IntArray
    """Remaining transmissions of each block as new. Shape (block rows, block columns)."""
    told: IntArray
    """Tick of the last transmission of each block; -1: never. Shape (block rows, block columns)."""


def telling_memory(width: float, height: float, tile: float) -> TellingMemory:
    """Return an empty map without transmissions.

    Args:
        width, height: Size of the area [m].
        tile: Width of a tile [m]; 0 without ground.
    """
    rows, columns = tiles_shape(width, height, tile) if tile > 0.0 else (0, 0)
    blocks = (-(-rows // BLOCK_SIDE), -(-columns // BLOCK_SIDE))
    return TellingMemory(
        tiles=np.zeros((rows, columns), np.uint8),
        news=np.zeros(blocks, np.int64),
        told=np.full(blocks, -1, np.int64),
    )


@inlined
def telling_of(memory: TellingMemory, world: int, uav: int) -> TellingMemory:
    """Return the memory of one UAV in one world: views, no copies."""
    return TellingMemory(memory.tiles[world, uav], memory.news[world, uav], memory.told[world, uav])


@compiled
def note_tile(memory: TellingMemory, column: int, row: int, state: int) -> None:
    """Record a tile reported by the UAV's own sensor."""
    if row < memory.tiles.shape[0] and column < memory.tiles.shape[1]:
        memory.tiles[row, column] = state
        memory.news[row // BLOCK_SIDE, column // BLOCK_SIDE] = _REPEATS


@compiled
def next_block(
    memory: TellingMemory, tile: float, tick: int, g_x: float, g_y: float
) -> tuple[int, int]:
    """Select the block to send at this tick and mark it as sent; row and column, or -1, -1 if there is none.

    Args:
        memory: Changed in place.
        tile: Width of a tile [m].
        tick: Current tick.
        g_x, g_y: Estimated position of the UGV [m].
    """
    side, best_row, best_column = BLOCK_SIDE * tile, -1, -1
    best_news, best = False, math.inf
    for row in range(memory.news.shape[0]):
        d_y = (row + 0.5) * side - g_y
        for column in range(memory.news.shape[1]):
            news, told = memory.news[row, column] > 0, memory.told[row, column]
            if told < 0 and not news:
                continue
            d_x = (column + 0.5) * side - g_x
            far = d_x * d_x + d_y * d_y
            if far > _REACH * _REACH or (best_news and not news):
                continue
            value = far if news else float(told)
            if value < best or (news and not best_news):
                best_row, best_column, best_news, best = row, column, news, value
    if best_row >= 0:
        memory.told[best_row, best_column] = tick
        memory.news[best_row, best_column] = max(0, memory.news[best_row, best_column] - 1)
    return best_row, best_column


@compiled
def block_words(tiles: TileArray, row: int, column: int, words: IntArray) -> None:
    """Encode the states of a block of tiles, three bits per tile, lowest bits first. Shape (BLOCK_WORDS,)."""
    for n in range(BLOCK_WORDS):
        word = 0
        for i in range(_WORD_TILES):
            place = n * _WORD_TILES + i
            r, c = row * BLOCK_SIDE + place // BLOCK_SIDE, column * BLOCK_SIDE + place % BLOCK_SIDE
            if r < tiles.shape[0] and c < tiles.shape[1]:
                word |= int(tiles[r, c]) << (3 * i)
        words[n] = word


@compiled
def word_state(words: IntArray, place: int) -> int:
    """Decode the state of one tile of a block from the numbers of `block_words`."""
    return int(words[place // _WORD_TILES] >> (3 * (place % _WORD_TILES))) & 7


def telling_ticks(telling: float, dt: float) -> int:
    """Return the period of map updates in ticks of dt [s], at a rate [1/s]; 0: no updates."""
    return max(1, round(1.0 / (telling * dt))) if telling > 0.0 else 0


class GroundTeller:
    """Scheduler of the map updates that a UAV's computer sends, whoever controls the UAV.

    Args:
        briefing: Briefing of the UAV.
    """

    def __init__(self, briefing: UavBriefing) -> None:
        ground, area = briefing.ground, briefing.area
        self._tile = ground.tile if ground is not None else 0.0
        self.memory = telling_memory(area.width, area.height, self._tile)
        """Map and transmission state."""
        self._period = (
            telling_ticks(ground.map_update_rate, briefing.dt) if ground is not None else 0
        )

    def note(self, tiles: Sequence[TileReport]) -> None:
        """Record tiles reported by the UAV's own sensor."""
        for tile in tiles:
            note_tile(self.memory, tile.column, tile.row, TILE_LETTERS.index(tile.state))

    def blocks(self, tick: int, target: tuple[float, float] | None) -> tuple[MapUpdate, ...]:
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
