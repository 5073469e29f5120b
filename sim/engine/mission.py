"""The UGVs' mission: goals, hazards on the way, and how long before each was known. For measuring alone.

No vehicle is told of any of it. Without hazards all arrays are empty, and nothing is done.
"""

import math
from collections.abc import Sequence

import msgspec
import numpy as np
import numpy.typing as npt

from bus.messages import BLOCK_SIDE, Mission, UgvGuarantee
from sim.engine.ground_state import (
    GroundConstants,
    GroundState,
    MissionConstants,
    MissionState,
    TickArray,
)
from sim.engine.world_state import BatchState, BatchTables
from sim.kernels.compile import FloatArray, borrowing, inlined
from sim.kernels.records import RecordArray
from sim.models.ground import (
    BLOCK,
    CERTIFIED,
    CLEAR,
    FOUND,
    NO_STOP,
    ROUGH,
    UNCERTIFIED,
    UNSEEN,
    WAY_UNKNOWN,
    distance_to_hazard,
    may_be_within,
    tile_index,
)
from sim.models.vehicles import next_goal, norm

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


@inlined
def goals_of(constants: MissionConstants, ugv: int) -> FloatArray:
    """The goals of a UGV [m]: a view. Shape (goals, 2)."""
    return constants.goals[constants.goal_rows[ugv] : constants.goal_rows[ugv + 1]]


@borrowing
def _note(
    tables: GroundConstants,
    ground: GroundState,
    world: int,
    row: int,
    column: int,
    ticks: TickArray,
    tick: int,
) -> None:
    """Somebody is told that there is a hazard on a tile: note it for those that are."""
    tile = tables.parameters[0].tile
    x, y, half = (column + 0.5) * tile, (row + 0.5) * tile, math.sqrt(0.5) * tile
    for h in range(ticks.shape[0]):
        if ticks[h] == 0 and ground.hazards[world, h].kind > 0:
            near = may_be_within(ground.hazards[world], h, x, y, half)
            if near and distance_to_hazard(ground.hazards[world], tables.corners, h, x, y) <= half:
                ticks[h] = tick + 1


@borrowing
def note_claim(ugvs: RecordArray, ugv: int, claim: int) -> None:
    """A UGV claims this at the tick that is flown next, or nothing.

    Args:
        ugvs: `MissionRecord` of each, is changed. Shape (UGVs,).
        ugv: Which.
        claim: NO_CLAIM, CERTIFIED, WAY_UNKNOWN or NO_STOP.
    """
    record = ugvs[ugv]
    ended = record.claim == CERTIFIED and claim in (WAY_UNKNOWN, NO_STOP)
    record.broken += 1 if ended and record.untrue == 0 else 0
    record.certified += 1 if claim == CERTIFIED else 0
    record.way_unknown += 1 if claim == WAY_UNKNOWN else 0
    record.no_stop += 1 if claim == NO_STOP else 0
    record.claim = claim


@borrowing
def receive_block(
    tables: GroundConstants,
    ground: GroundState,
    mission: MissionState,
    world: int,
    ugv: int,
    tick: int,
    block: tuple[int, int],
    states: npt.NDArray[np.uint8],
) -> None:
    """A UGV is told of a block of tiles by radio.

    Args:
        tables, ground: The ground of all worlds.
        mission: Is changed.
        world, ugv: Which.
        tick: Now.
        block: Row and column of the block.
        states: Of its tiles, row by row. Shape (BLOCK_SIDE * BLOCK_SIDE,).
    """
    received = mission.received[world, ugv]
    for place in range(states.shape[0]):
        state = states[place]
        row = block[0] * BLOCK_SIDE + place // BLOCK_SIDE
        column = block[1] * BLOCK_SIDE + place % BLOCK_SIDE
        if state == UNSEEN or row >= received.shape[0] or column >= received.shape[1]:
            continue
        true, before = ground.tiles[world, row, column], mission.told[world, ugv, row, column]
        wrong = state != BLOCK and true in (BLOCK, ROUGH) and state != true
        if wrong or (state == BLOCK and before not in (UNSEEN, BLOCK)):
            mission.ugvs[world, ugv].untrue = 1
        if before != BLOCK:
            mission.told[world, ugv, row, column] = state
        if received[row, column] == 0:
            received[row, column] = tick + 1
            mission.ugvs[world, ugv].told += 1
            if state != CLEAR:
                _note(tables, ground, world, row, column, mission.warned[world, ugv], tick)


@borrowing
def _note_sensors(
    tables: GroundConstants, ground: GroundState, mission: MissionState, world: int, tick: int
) -> None:
    """Note the hazards of which the vehicles' own sensors have just told."""
    columns = ground.tiles.shape[2]
    for v in range(ground.told.shape[1]):
        for i in range(ground.told[world, v]):
            row, column = ground.seen[world, v, i] // columns, ground.seen[world, v, i] % columns
            if (
                ground.known[world, v, row, column] == CLEAR
                or ground.tiles[world, row, column] == CLEAR
            ):
                continue  # missed, or a false alarm
            _note(tables, ground, world, row, column, mission.found[world], tick)
            for n in range(tables.ugvs.shape[0]):
                if tables.ugvs[n] == v:
                    _note(tables, ground, world, row, column, mission.warned[world, n], tick)


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
def _drive(tables: BatchTables, state: BatchState, world: int, ugv: int) -> None:
    """A UGV has come to where it is."""
    ground, mission, tick = state.ground, state.mission, state.ticks[world]
    vehicle = tables.ground.ugvs[ugv]
    x, y = state.truth.position[world, vehicle, 0], state.truth.position[world, vehicle, 1]
    row, goals = mission.ugvs[world, ugv], goals_of(tables.mission, ugv)
    if tick > 0:
        way = norm(x - ground.before[world, ugv, 0], y - ground.before[world, ugv, 1])
        tile, (rows, columns) = tables.ground.parameters[0].tile, ground.tiles[world].shape
        received = mission.received[
            world, ugv, tile_index(y, tile, rows), tile_index(x, tile, columns)
        ]
        row.way += way
        row.seen_way += way if 0 < received <= tick else 0.0
        if row.arrived < 0 and way < _STILL * tables.ground.strides[ugv]:
            row.still += 1
    if row.reached < goals.shape[0]:
        row.reached, _ = next_goal(goals, row.reached, tables.mission.tolerances[ugv], x, y)
        if row.reached == goals.shape[0]:
            row.arrived = tick
    moved_x, moved_y = x - row.listed_x, y - row.listed_y
    if row.listed < 0 or moved_x * moved_x + moved_y * moved_y > _SKIN * _SKIN:
        row.listed = _list_near(ground.hazards[world], mission.near[world, ugv], x, y)
        row.listed_x, row.listed_y = x, y
    for i in range(row.listed):
        h = mission.near[world, ugv, i]
        if not may_be_within(ground.hazards[world], h, x, y, ON_WAY):
            continue
        away = distance_to_hazard(ground.hazards[world], tables.ground.corners, h, x, y)
        mission.nearest[world, ugv, h] = min(mission.nearest[world, ugv, h], away)
        if away <= ON_WAY and mission.met[world, ugv, h] == 0:
            mission.met[world, ugv, h] = tick + 1


@inlined
def note_mission(tables: BatchTables, state: BatchState, world: int) -> None:
    """Take in a tick of a world: what sensors have told of, and where the UGVs have come."""
    _note_sensors(tables.ground, state.ground, state.mission, world, state.ticks[world])
    for n in range(tables.ground.ugvs.shape[0]):
        _drive(tables, state, world, n)


def mission_numbers(mission: Mission) -> dict[str, float]:
    """All of it by name, NaN for None."""
    told = msgspec.structs.asdict(mission)
    del told["guarantees"]
    return {name: math.nan if value is None else value for name, value in told.items()}


def _guarantee(row: RecordArray) -> UgvGuarantee:
    by_reason = {WAY_UNKNOWN: int(row["way_unknown"]), NO_STOP: int(row["no_stop"])}
    return UgvGuarantee(
        entered_unknown_tile=int(row["entered"]),
        ticks=int(row["certified"]) + sum(by_reason.values()),
        certified=int(row["certified"]),
        uncertified={UNCERTIFIED[code]: ticks for code, ticks in by_reason.items() if ticks},
        certificate_broken=int(row["broken"]),
    )


def mission_of(
    constants: MissionConstants,
    ground: GroundState,
    mission: MissionState,
    world: int,
    dt: float,
    names: Sequence[str],
) -> Mission:
    """The mission of a world so far.

    Args:
        constants, ground, mission: Of all worlds.
        world: Which.
        dt: Length of a tick [s].
        names: Of the UGVs.
    """
    ugvs, kinds = mission.ugvs[world], ground.hazards["kind"][world]
    met, warned, blocks = mission.met[world] > 0, mission.warned[world], kinds == BLOCK
    before = met & (warned > 0) & (warned < mission.met[world])
    bound_for = np.diff(constants.goal_rows) > 0
    arrived = bool(bound_for.any() and (ugvs["arrived"][bound_for] >= 0).all())
    way, ahead = float(ugvs["way"].sum()), (mission.met[world] - warned)[before]
    near = (mission.nearest[world] < NEAR_MISS) & (ground.hits[world] == 0) & blocks
    finds = kinds == FOUND
    return Mission(
        arrived=arrived,
        mission_time=float(ugvs["arrived"].max() * dt) if arrived else None,
        hazards_hit=int(ground.hits[world].sum()),
        near_misses=int(near.sum()),
        hazards_on_way=int(met.sum()),
        warned=int(before.sum()),
        warned_before=float(ahead.mean() * dt) if ahead.size else None,
        seen_ahead=float(ugvs["seen_way"].sum()) / way if way > 0.0 else None,
        entered_unknown_tile=int(ugvs["entered"].sum()),
        ground_certificate_broken=int(ugvs["broken"].sum()),
        guarantees={name: _guarantee(row) for name, row in zip(names, ugvs, strict=True)},
        still_time=float(ugvs["still"].sum() * dt),
        finds=int(finds.sum()),
        found=int((mission.found[world][finds] > 0).sum()),
    )
