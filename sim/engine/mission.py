"""The UGVs' mission: goals, hazards on the way, and how long before each was known. For measuring alone.

No vehicle is told of any of it. Without hazards all arrays are empty, and nothing is done.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from bus.messages import BLOCK_SIDE, Mission
from sim.engine.ground_tick import GroundConstants, GroundState
from sim.kernels.compile import FloatArray, IntArray, borrowing, inlined
from sim.kernels.records import RecordArray, record_type
from sim.models.ground import (
    BLOCK,
    CLEAR,
    FOUND,
    UNSEEN,
    TileArray,
    distance_to_hazard,
    may_be_within,
    tile_index,
)
from sim.models.vehicles import next_goal, norm
from sim.scenario.types import Scenario, Ugv

ON_WAY = 2.0
"""A hazard that a UGV comes nearer to than this is on its way [m]."""
NEAR_MISS = 0.2
"""One that blocks, and that it comes nearer to than this without touching it, is a near miss [m]."""
_SKIN = 1.0
"""So far a UGV may move until the hazards near it are listed anew [m]."""
_ROUNDING = 1e-6
"""So much farther than it must a list of them reaches [m]."""
_STILL = 0.01
"""Slower than this share of its largest speed a UGV stands still."""

TickArray = npt.NDArray[np.int32]
"""Ticks, counted from 1; 0: never."""


class MissionRecord(NamedTuple):
    """The columns of a table: how one UGV does."""

    way: float
    """That it has driven [m]."""
    seen_way: float
    """Of it on tiles that had come by radio before [m]."""
    still: int
    """Ticks in which it stood still before it had arrived."""
    reached: int
    """Goals."""
    arrived: int
    """The tick at which it had reached the last of them; -1: not yet, or it has none."""
    told: int
    """Tiles that have come by radio, each counted once."""
    listed: int
    """Number of hazards near it when they were listed; -1: not yet."""
    listed_x: float
    listed_y: float
    """Its position then [m]."""


class MissionConstants(NamedTuple):
    """The constants of all worlds."""

    goals: FloatArray
    """Of all UGVs [m]. Shape (any, 2)."""
    goal_rows: IntArray
    """First row of each UGV's. Shape (UGVs + 1,)."""
    tolerances: FloatArray
    """[m]. Shape (UGVs,)."""


class MissionState(NamedTuple):
    """The UGVs' missions in each world. All arrays have an axis for worlds in front."""

    ugvs: RecordArray
    """`MissionRecord`. Shape (worlds, UGVs)."""
    received: TickArray
    """Time at which each UGV was told of each tile by radio first. Shape (worlds, UGVs, rows, columns)."""
    told: TileArray
    """State that the radio has told of each: BLOCK stays, the rest gives way to later words. Shape as `received`."""
    warned: TickArray
    """Time at which it knew of each hazard first, by radio or by its bumper. Shape (worlds, UGVs, hazards)."""
    met: TickArray
    """Time at which it was nearer than `ON_WAY` first. Shape (worlds, UGVs, hazards)."""
    nearest: FloatArray
    """Smallest distance to each hazard [m]. Shape (worlds, UGVs, hazards)."""
    near: npt.NDArray[np.int32]
    """Those that it could come nearer to than `ON_WAY` before they are listed anew, in order: `MissionRecord.listed`
    of them. Shape (worlds, UGVs, hazards).
    """
    found: TickArray
    """Time at which any vehicle's sensor told of each hazard first. Shape (worlds, hazards)."""


def joined(arrays: Sequence[FloatArray], width: int) -> tuple[FloatArray, IntArray]:
    """Arrays one after the other, and where each begins."""
    edges = np.cumsum([0, *(len(array) for array in arrays)]).astype(np.int64)
    return np.concatenate([np.zeros((0, width)), *arrays]), edges


def mission_constants(scenario: Scenario) -> MissionConstants:
    """The goals of a scenario."""
    ugvs = [one for one in scenario.vehicles if isinstance(one, Ugv)]
    goals, goal_rows = joined(
        [np.array(one.goals, dtype=np.float64).reshape(-1, 2) for one in ugvs], 2
    )
    tolerances = np.array([one.goal_tolerance for one in ugvs], dtype=np.float64)
    return MissionConstants(goals, goal_rows, tolerances)


@inlined
def goals_of(c: MissionConstants, n: int) -> FloatArray:
    """The goals of UGV n [m]: a view. Shape (goals, 2)."""
    return c.goals[c.goal_rows[n] : c.goal_rows[n + 1]]


def mission_state(ground: GroundState) -> MissionState:
    """Nothing has happened yet on this ground."""
    worlds, ugvs = ground.before.shape[:2]
    count = ground.hazards.shape[1]
    numbers = np.zeros((worlds, ugvs), dtype=record_type(MissionRecord))
    numbers["arrived"] = numbers["listed"] = -1
    return MissionState(
        ugvs=numbers,
        received=np.zeros((worlds, ugvs, *ground.tiles.shape[1:]), np.int32),
        told=np.zeros((worlds, ugvs, *ground.tiles.shape[1:]), np.uint8),
        warned=np.zeros((worlds, ugvs, count), np.int32),
        met=np.zeros((worlds, ugvs, count), np.int32),
        nearest=np.full((worlds, ugvs, count), np.inf),
        near=np.zeros((worlds, ugvs, count), np.int32),
        found=np.zeros((worlds, count), np.int32),
    )


@borrowing
def _note(
    t: GroundConstants, g: GroundState, k: int, row: int, column: int, ticks: TickArray, tick: int
) -> None:
    """Somebody is told that there is a hazard on a tile: note it for those that are."""
    tile = t.parameters[0].tile
    x, y, half = (column + 0.5) * tile, (row + 0.5) * tile, math.sqrt(0.5) * tile
    for h in range(ticks.shape[0]):
        if ticks[h] == 0 and g.hazards[k, h].kind > 0:
            near = may_be_within(g.hazards[k], h, x, y, half)
            if near and distance_to_hazard(g.hazards[k], t.corners, h, x, y) <= half:
                ticks[h] = tick + 1


@borrowing
def receive_block(
    t: GroundConstants,
    g: GroundState,
    m: MissionState,
    k: int,
    n: int,
    tick: int,
    block: tuple[int, int],
    states: npt.NDArray[np.uint8],
) -> None:
    """UGV n of world k is told of a block of tiles by radio.

    Args:
        t, g: The ground of all worlds.
        m: Is changed.
        k, n: Which.
        tick: Now.
        block: Row and column of the block.
        states: Of its tiles, row by row. Shape (BLOCK_SIDE * BLOCK_SIDE,).
    """
    received = m.received[k, n]
    for place in range(states.shape[0]):
        state = states[place]
        row = block[0] * BLOCK_SIDE + place // BLOCK_SIDE
        column = block[1] * BLOCK_SIDE + place % BLOCK_SIDE
        if state == UNSEEN or row >= received.shape[0] or column >= received.shape[1]:
            continue
        if m.told[k, n, row, column] != BLOCK:
            m.told[k, n, row, column] = state
        if received[row, column] == 0:
            received[row, column] = tick + 1
            m.ugvs[k, n].told += 1
            if state != CLEAR:
                _note(t, g, k, row, column, m.warned[k, n], tick)


@borrowing
def _note_sensors(t: GroundConstants, g: GroundState, m: MissionState, k: int, tick: int) -> None:
    """Note the hazards of which the vehicles' own sensors have just told."""
    columns = g.tiles.shape[2]
    for v in range(g.told.shape[1]):
        for i in range(g.told[k, v]):
            row, column = g.seen[k, v, i] // columns, g.seen[k, v, i] % columns
            if g.known[k, v, row, column] == CLEAR or g.tiles[k, row, column] == CLEAR:
                continue  # missed, or a false alarm
            _note(t, g, k, row, column, m.found[k], tick)
            for n in range(t.ugvs.shape[0]):
                if t.ugvs[n] == v:
                    _note(t, g, k, row, column, m.warned[k, n], tick)


@borrowing
def _list_near(hazards: RecordArray, near: TickArray, x: float, y: float) -> int:
    """List the hazards on whose way a UGV may come before it is `_SKIN` away from (x, y) [m]; their number."""
    listed = 0
    for h in range(hazards.shape[0]):
        if hazards[h].kind == 0 or hazards[h].kind == FOUND:
            continue
        if may_be_within(hazards, h, x, y, ON_WAY + _SKIN + _ROUNDING):
            near[listed] = h
            listed += 1
    return listed


@inlined
def _drive(
    c: MissionConstants,
    t: GroundConstants,
    g: GroundState,
    m: MissionState,
    k: int,
    n: int,
    tick: int,
    x: float,
    y: float,
) -> None:
    """UGV n has come to (x, y) [m]."""
    row, goals = m.ugvs[k, n], goals_of(c, n)
    if tick > 0:
        way = norm(x - g.before[k, n, 0], y - g.before[k, n, 1])
        tile, (rows, columns) = t.parameters[0].tile, g.tiles[k].shape
        received = m.received[k, n, tile_index(y, tile, rows), tile_index(x, tile, columns)]
        row.way += way
        row.seen_way += way if 0 < received <= tick else 0.0
        if row.arrived < 0 and way < _STILL * t.strides[n]:
            row.still += 1
    if row.reached < goals.shape[0]:
        row.reached, _ = next_goal(goals, row.reached, c.tolerances[n], x, y)
        if row.reached == goals.shape[0]:
            row.arrived = tick
    moved_x, moved_y = x - row.listed_x, y - row.listed_y
    if row.listed < 0 or moved_x * moved_x + moved_y * moved_y > _SKIN * _SKIN:
        row.listed = _list_near(g.hazards[k], m.near[k, n], x, y)
        row.listed_x, row.listed_y = x, y
    for i in range(row.listed):
        h = m.near[k, n, i]
        if not may_be_within(g.hazards[k], h, x, y, ON_WAY):
            continue
        away = distance_to_hazard(g.hazards[k], t.corners, h, x, y)
        m.nearest[k, n, h] = min(m.nearest[k, n, h], away)
        if away <= ON_WAY and m.met[k, n, h] == 0:
            m.met[k, n, h] = tick + 1


@inlined
def note_mission(
    c: MissionConstants,
    t: GroundConstants,
    g: GroundState,
    m: MissionState,
    k: int,
    tick: int,
    position: FloatArray,
) -> None:
    """Take in a tick of world k: what sensors have told of, and where the UGVs have come.

    Args:
        c, t, g: Of all worlds.
        m: Is changed.
        k: The world.
        tick: Now.
        position: Of its vehicles [m]. Shape (vehicles, 2).
    """
    _note_sensors(t, g, m, k, tick)
    for n in range(t.ugvs.shape[0]):
        v = t.ugvs[n]
        _drive(c, t, g, m, k, n, tick, position[v, 0], position[v, 1])


def mission_numbers(mission: Mission) -> dict[str, float]:
    """All of it by name, NaN for None."""
    told = msgspec.structs.asdict(mission)
    return {name: math.nan if value is None else value for name, value in told.items()}


def mission_of(c: MissionConstants, g: GroundState, m: MissionState, k: int, dt: float) -> Mission:
    """The mission of world k so far.

    Args:
        c, g, m: Of all worlds.
        k: Which.
        dt: Length of a tick [s].
    """
    ugvs, kinds = m.ugvs[k], g.hazards["kind"][k]
    met, warned, blocks = m.met[k] > 0, m.warned[k], kinds == BLOCK
    before = met & (warned > 0) & (warned < m.met[k])
    bound_for = np.diff(c.goal_rows) > 0
    arrived = bool(bound_for.any() and (ugvs["arrived"][bound_for] >= 0).all())
    way, ahead = float(ugvs["way"].sum()), (m.met[k] - warned)[before]
    near = (m.nearest[k] < NEAR_MISS) & (g.hits[k] == 0) & blocks
    finds = kinds == FOUND
    return Mission(
        arrived=arrived,
        mission_time=float(ugvs["arrived"].max() * dt) if arrived else None,
        hazards_hit=int(g.hits[k].sum()),
        near_misses=int(near.sum()),
        hazards_on_way=int(met.sum()),
        warned=int(before.sum()),
        warned_before=float(ahead.mean() * dt) if ahead.size else None,
        seen_ahead=float(ugvs["seen_way"].sum()) / way if way > 0.0 else None,
        still_time=float(ugvs["still"].sum() * dt),
        finds=int(finds.sum()),
        found=int((m.found[k][finds] > 0).sum()),
    )
