"""Mission results of the UGVs: goals, hazards on the path, and warning times. For evaluation only.

No vehicle receives any of them.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from bus.messages.ground import BLOCK_SIDE
from bus.messages.telemetry import MissionResult, UgvGuarantee
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.records import RecordArray, row_of
from sim.engine.ground_state import GroundState, TickArray
from sim.engine.world_state import BatchState, BatchTables
from sim.models.ground import (
    CERTIFIED,
    CLEAR,
    NO_STOP,
    NOT_OWN,
    PATH_UNKNOWN,
    UNCERTIFIED,
    UNSEEN,
    tile_index,
)
from sim.models.hazards import BLOCK, FOUND, ROUGH, distance_to_hazard, may_be_within
from sim.models.polygons import path_distance
from sim.models.vehicles import next_goal, norm

NEAR_PATH = 2.0
"""Distance below which a hazard counts as on a UGV's path [m]."""
NEAR_MISS = 0.2
"""Distance below which a blocking hazard that is not touched counts as a near miss [m]."""
_SKIN = 1.0
"""Distance after which a UGV's list of near hazards is renewed [m]."""
_ROUNDING = 1e-6
"""Extra range of the list, for rounding [m]."""
_STILL = 0.01
"""Share of its maximum speed below which a UGV stands still."""


@compiled
def goals_of(goals: FloatArray, goal_rows: IntArray, ugv: int) -> FloatArray:
    """Return the goals of a UGV [m], a view of all goals. Shape (goals, 2)."""
    return goals[goal_rows[ugv] : goal_rows[ugv + 1]]


@compiled
def _record_hazards(
    ground: GroundState, world: int, row: int, column: int, ticks: TickArray, tick: int
) -> None:
    """Record the first knowledge of the hazards on a tile."""
    tile = ground.parameters[0].tile
    x, y, half = (column + 0.5) * tile, (row + 0.5) * tile, math.sqrt(0.5) * tile
    for h in range(ticks.shape[0]):
        if ticks[h] == 0 and ground.hazards[world, h].kind > 0:
            near = may_be_within(ground.hazards[world], h, x, y, half)
            if near and distance_to_hazard(ground.hazards[world], ground.corners, h, x, y) <= half:
                ticks[h] = tick + 1


@compiled
def record_claim(ugvs: RecordArray, ugv: int, claim: int) -> None:
    """Record the claim of a UGV for the next tick.

    Args:
        ugvs: `Progress` of each UGV; changed. Shape (UGVs,).
        ugv: Index of the UGV.
        claim: A constant of `sim.models.ground`. After NOT_OWN no certificate counts as broken: the assumptions ended.
    """
    record = ugvs[ugv]
    ended = record.claim == CERTIFIED and claim in (PATH_UNKNOWN, NO_STOP)
    record.broken += 1 if ended and record.untrue == 0 else 0
    record.certified += 1 if claim == CERTIFIED else 0
    record.path_unknown += 1 if claim == PATH_UNKNOWN else 0
    record.no_stop += 1 if claim == NO_STOP else 0
    record.not_own += 1 if claim == NOT_OWN else 0
    record.claim = claim


@compiled
def keeps_clearance(clearances: RecordArray, ugvs: RecordArray, ugv: int) -> bool:
    """Return whether a UGV keeps the distance from buildings that certificates assume, or need not keep it.

    The driver in control must guarantee it, must not have reported that it cannot, and must be at this distance.

    Args:
        clearances: `Clearance` of each UGV. Shape (UGVs,).
        ugvs: `Progress` of each UGV. Shape (UGVs,).
        ugv: Index of the UGV.
    """
    one, progress = clearances[ugv], ugvs[ugv]
    doubtful = progress.claim == PATH_UNKNOWN or progress.claim == NO_STOP
    return not one.needed or (one.guaranteed and not progress.near and not doubtful)


@compiled
def receive_block(
    ground: GroundState,
    world: int,
    ugv: int,
    tick: int,
    block: tuple[int, int],
    states: npt.NDArray[np.uint8],
) -> None:
    """Record a map update that a UGV has received by radio.

    Args:
        ground: Changed.
        world, ugv: Indices.
        tick: Current tick.
        block: Row and column of the block.
        states: States of its tiles, row by row. Shape (BLOCK_SIDE * BLOCK_SIDE,).
    """
    received = ground.received[world, ugv]
    for k in range(states.shape[0]):
        state = states[k]
        row = block[0] * BLOCK_SIDE + k // BLOCK_SIDE
        column = block[1] * BLOCK_SIDE + k % BLOCK_SIDE
        if state == UNSEEN or row >= received.shape[0] or column >= received.shape[1]:
            continue
        true, before = ground.tiles[world, row, column], ground.radioed[world, ugv, row, column]
        wrong = state != BLOCK and true in (BLOCK, ROUGH) and state != true
        if wrong or (state == BLOCK and before not in (UNSEEN, BLOCK)):
            ground.missions[world, ugv].untrue = 1
        if before != BLOCK:
            ground.radioed[world, ugv, row, column] = state
        if received[row, column] == 0:
            received[row, column] = tick + 1
            ground.missions[world, ugv].received_tiles += 1
            if state != CLEAR:
                _record_hazards(ground, world, row, column, ground.warned[world, ugv], tick)


@compiled
def _record_sensors(ground: GroundState, world: int, tick: int) -> None:
    """Record the hazards that the vehicles' own sensors have just reported."""
    columns = ground.tiles.shape[2]
    for v in range(ground.report_counts.shape[1]):
        for i in range(ground.report_counts[world, v]):
            row, column = ground.seen[world, v, i] // columns, ground.seen[world, v, i] % columns
            if (
                ground.known[world, v, row, column] == CLEAR
                or ground.tiles[world, row, column] == CLEAR
            ):
                continue  # missed, or a false alarm
            _record_hazards(ground, world, row, column, ground.found[world], tick)
            for n in range(ground.ugvs.shape[0]):
                if ground.ugvs[n] == v:
                    _record_hazards(ground, world, row, column, ground.warned[world, n], tick)


@compiled
def _list_near(hazards: RecordArray, near: TickArray, x: float, y: float) -> int:
    """List the hazards that a UGV may approach within `_SKIN` of (x, y) [m]; return their number."""
    listed = 0
    for h in range(hazards.shape[0]):
        if hazards[h].kind == 0 or hazards[h].kind == FOUND:
            continue
        if may_be_within(hazards, h, x, y, NEAR_PATH + _SKIN + _ROUNDING):
            near[listed] = h
            listed += 1
    return listed


@compiled
def _is_near_building(
    ground: GroundState,
    world: int,
    ugv: int,
    start: tuple[float, float],
    end: tuple[float, float],
) -> bool:
    """Return whether a UGV's path from start to end [m] is nearer to a building than the clearance that it declares."""
    parameters, clearance = ground.parameters[0], ground.clearances[ugv].declared
    if clearance == 0.0:
        return False
    hazards, far = ground.hazards[world], norm(end[0] - start[0], end[1] - start[1]) + clearance
    for h in range(parameters.first_building, parameters.end_building):
        if hazards[h].kind == 0 or not may_be_within(hazards, h, end[0], end[1], far):
            continue
        first, count = hazards[h].first, hazards[h].corners
        if path_distance(ground.corners, first, count, start, end) < clearance:
            return True
    return False


@compiled
def _drive(
    tables: BatchTables, state: BatchState, ground: GroundState, world: int, ugv: int
) -> None:
    """Update the mission of a UGV after it has moved."""
    tick, vehicle = state.ticks[world], state.vehicles[world, tables.ugvs[ugv]]
    x, y = vehicle.position[0], vehicle.position[1]
    row, goals = ground.missions[world, ugv], goals_of(tables.goals, tables.goal_rows, ugv)
    start = x, y
    if tick > 0:
        start = ground.before[world, ugv, 0], ground.before[world, ugv, 1]
    row.near = _is_near_building(ground, world, ugv, start, (x, y))
    row.near_building += 1 if row.near else 0
    row.near_excused += 1 if row.near and not ground.clearances[ugv].guaranteed else 0
    if tick > 0:
        driven = norm(x - start[0], y - start[1])
        tile, (rows, columns) = ground.parameters[0].tile, ground.tiles[world].shape
        received = ground.received[
            world, ugv, tile_index(y, tile, rows), tile_index(x, tile, columns)
        ]
        row.driven += driven
        row.seen_length += driven if 0 < received <= tick else 0.0
        if (
            row.arrived < 0
            and driven < _STILL * ground.strides[row_of(ground.strides.shape[0], world), ugv]
        ):
            row.still += 1
    if row.reached < goals.shape[0]:
        row.reached, _ = next_goal(goals, row.reached, tables.tolerances[ugv], x, y)
        if row.reached == goals.shape[0]:
            row.arrived = tick
    moved_x, moved_y = x - row.listed_x, y - row.listed_y
    if row.listed < 0 or moved_x * moved_x + moved_y * moved_y > _SKIN * _SKIN:
        row.listed = _list_near(ground.hazards[world], ground.near[world, ugv], x, y)
        row.listed_x, row.listed_y = x, y
    for i in range(row.listed):
        h = ground.near[world, ugv, i]
        if not may_be_within(ground.hazards[world], h, x, y, NEAR_PATH):
            continue
        away = distance_to_hazard(ground.hazards[world], ground.corners, h, x, y)
        ground.nearest[world, ugv, h] = min(ground.nearest[world, ugv, h], away)
        if away <= NEAR_PATH and ground.met[world, ugv, h] == 0:
            ground.met[world, ugv, h] = tick + 1


@compiled
def record_mission(tables: BatchTables, state: BatchState, ground: GroundState, world: int) -> None:
    """Record a tick of a world: sensor reports, and the UGVs' progress."""
    _record_sensors(ground, world, state.ticks[world])
    for n in range(ground.ugvs.shape[0]):
        _drive(tables, state, ground, world, n)


def _guarantee(row: RecordArray) -> UgvGuarantee:
    fields = {PATH_UNKNOWN: "path_unknown", NO_STOP: "no_stop", NOT_OWN: "not_own"}
    by_reason = {code: int(row[field]) for code, field in fields.items()}
    return UgvGuarantee(
        entered_unknown_tile=int(row["entered"]),
        ticks=int(row["certified"]) + sum(by_reason.values()),
        certified=int(row["certified"]),
        uncertified={UNCERTIFIED[code]: ticks for code, ticks in by_reason.items() if ticks},
        certificate_broken=int(row["broken"]),
        near_building=int(row["near_building"]),
        near_building_excused=int(row["near_excused"]),
    )


def mission_of(
    goal_rows: IntArray, ground: GroundState, world: int, dt: float, names: Sequence[str]
) -> MissionResult:
    """Return the mission results of a world so far.

    Args:
        goal_rows: As in `BatchTables`.
        ground: Ground of all worlds.
        world: Index of the world.
        dt: Duration of a tick [s].
        names: Names of the UGVs.
    """
    ugvs, kinds = ground.missions[world], ground.hazards["kind"][world]
    met, warned, blocks = ground.met[world] > 0, ground.warned[world], kinds == BLOCK
    before = met & (warned > 0) & (warned < ground.met[world])
    bound_for = np.diff(goal_rows) > 0
    arrived = bool(bound_for.any() and (ugvs["arrived"][bound_for] >= 0).all())
    driven, ahead = float(ugvs["driven"].sum()), (ground.met[world] - warned)[before]
    near = (ground.nearest[world] < NEAR_MISS) & (ground.hits[world] == 0) & blocks
    finds, declared = kinds == FOUND, bool(ground.clearances["declared"].any())
    guarantees = {name: _guarantee(row) for name, row in zip(names, ugvs, strict=True)}
    reported = sum(one.ticks for one in guarantees.values())
    certified = sum(one.certified for one in guarantees.values())
    return MissionResult(
        arrived=arrived,
        mission_time=float(ugvs["arrived"].max() * dt) if arrived else None,
        hazards_hit=int(ground.hits[world].sum()),
        near_misses=int(near.sum()),
        hazards_on_path=int(met.sum()),
        warned=int(before.sum()),
        mean_warning_time=float(ahead.mean() * dt) if ahead.size else None,
        reported_share=float(ugvs["seen_length"].sum()) / driven if driven > 0.0 else None,
        ground_certified_share=certified / reported if reported else None,
        entered_unknown_tile=int(ugvs["entered"].sum()),
        ground_certificate_broken=int(ugvs["broken"].sum()),
        near_building=int(ugvs["near_building"].sum()) if declared else None,
        near_building_excused=int(ugvs["near_excused"].sum()) if declared else None,
        guarantees=guarantees,
        stationary_time=float(ugvs["still"].sum() * dt),
        finds=int(finds.sum()),
        found=int((ground.found[world][finds] > 0).sum()),
    )
