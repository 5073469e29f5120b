"""The radio messages of a UAV to its UGV about the ground: which block of tiles, and when. Beyond Klodt 2015.

It tells of the blocks around where it believes the UGV to be: the nearest of those with news first, and each several
times, as the radio loses messages; where there are no news it repeats what it told longest ago. It tells what its own
sensor has told, and nothing of its own position, velocity or plan.
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
"""Number of times that news are told before what is older is repeated."""
_REACH = 12.0
"""Largest distance from the UGV of a block that it is told of [m]."""
_WORD_TILES = 16
"""Tiles in a number of a message, three bits each."""
BLOCK_TILES = BLOCK_SIDE * BLOCK_SIDE
BLOCK_WORDS = BLOCK_TILES // _WORD_TILES


class TellingMemory(NamedTuple):
    """A UAV's memory of the ground and of what it has told; arrays that change in place."""

    tiles: TileArray
    """As its sensor has told them. Shape (rows, columns)."""
    news: IntArray
    """Number of times that each block is still to be told as news. Shape (block rows, block columns)."""
    told: IntArray
    """The tick in which each was told last; -1: never. Likewise."""


def telling_memory(width: float, height: float, tile: float) -> TellingMemory:
    """Nothing is known yet.

    Args:
        width, height: Of the area [m].
        tile: Width of a tile [m]; 0: there is no ground to tell of.
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
    """That of one UAV in one world: views, no copies."""
    return TellingMemory(memory.tiles[world, uav], memory.news[world, uav], memory.told[world, uav])


@compiled
def note_tile(memory: TellingMemory, column: int, row: int, state: int) -> None:
    """The UAV's own sensor tells of a tile."""
    if row < memory.tiles.shape[0] and column < memory.tiles.shape[1]:
        memory.tiles[row, column] = state
        memory.news[row // BLOCK_SIDE, column // BLOCK_SIDE] = _REPEATS


@compiled
def next_block(
    memory: TellingMemory, tile: float, tick: int, g_x: float, g_y: float
) -> tuple[int, int]:
    """The block to tell of at this tick, row and column; -1, -1: there is nothing to tell. It then counts as told.

    Args:
        memory: Is changed.
        tile: Width of a tile [m].
        tick: Now.
        g_x, g_y: Where the UGV is believed to be [m].
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
    """Write the states of a block of tiles as numbers, three bits a tile, the first lowest. Shape (BLOCK_WORDS,)."""
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
    """The state of a tile of a block, from what `block_words` has written."""
    return int(words[place // _WORD_TILES] >> (3 * (place % _WORD_TILES))) & 7


def telling_ticks(telling: float, dt: float) -> int:
    """Every how many ticks of this length [s] a block is told of, at so many a second [1/s]; 0: never."""
    return max(1, round(1.0 / (telling * dt))) if telling > 0.0 else 0


class GroundTeller:
    """Chooses what a UAV's computer radios of the ground, whoever flies the UAV.

    Args:
        briefing: What the UAV is told when it joins.
    """

    def __init__(self, briefing: UavBriefing) -> None:
        ground, area = briefing.ground, briefing.area
        self._tile = ground.tile if ground is not None else 0.0
        self.memory = telling_memory(area.width, area.height, self._tile)
        """Its memory."""
        self._period = (
            telling_ticks(ground.map_update_rate, briefing.dt) if ground is not None else 0
        )

    def note(self, tiles: Sequence[TileReport]) -> None:
        """Its own sensor has told of these tiles."""
        for tile in tiles:
            note_tile(self.memory, tile.column, tile.row, TILE_LETTERS.index(tile.state))

    def blocks(self, tick: int, target: tuple[float, float] | None) -> tuple[MapUpdate, ...]:
        """The blocks that it radios at this tick.

        Args:
            tick: Now.
            target: Where it believes the UGV to be [m]; None: it does not know.
        """
        if not self._period or target is None or tick % self._period:
            return ()
        row, column = next_block(self.memory, self._tile, tick, *target)
        if row < 0:
            return ()
        letters = block_letters(self.memory.tiles, row, column)
        return (MapUpdate(column=column, row=row, tiles=letters),)
