"""Compiled tick of the ground: contact of vehicles with hazards, and ground sensors.

The ground is divided into tiles. A UAV's sensor accumulates (3) at their centers; once a tile reaches C*, the sensor
reports its state once, possibly with an error. A UGV's sensor reports the tiles around it without errors. Without
hazards all arrays are empty, and nothing is done.
"""

import math

from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import row_of
from sim.engine.ground_state import GroundParameters, GroundState
from sim.engine.space_tick import view_of
from sim.engine.world_state import BatchState, BatchTables, Rows, Vehicle, WorldParameters
from sim.models.field import accumulate
from sim.models.ground import CERTIFIED, CLEAR, UNSEEN, TileArray, state_at, tile_index
from sim.models.hazards import BLOCK, ROUGH, crosses_hazard, rough_share
from sim.models.randomness import GROUND_UPDATE, TILE_CHANCE, WordArray, key_of, uniform
from sim.models.sensor import SensorParameters
from sim.models.shadows import Occlusion

_POINTS = 8
"""Segments of the path driven in a tick, whose ends are checked for tiles."""


@compiled
def _tile_range(center: float, margin: float, tile: float, count: int) -> tuple[int, int]:
    """Return the range of tiles on one axis with a point within `margin` [m] of the center: first and end."""
    first = math.ceil((center - margin) / tile) - 1
    last = math.floor((center + margin) / tile)
    return max(0, first), min(count, last + 1)


@compiled
def _report(
    ground: GroundState, world: int, vehicle: int, row: int, column: int, state: int
) -> None:
    """Record the report of a tile by a vehicle's sensor."""
    ground.known[world, vehicle, row, column] = state
    n = ground.report_counts[world, vehicle]
    ground.seen[world, vehicle, n] = row * ground.tiles.shape[2] + column
    ground.report_counts[world, vehicle] = n + 1


@compiled
def _reported_state(
    parameters: GroundParameters, state: int, keys: WordArray, row: int, column: int
) -> int:
    """Return the state that a UAV's sensor reports for a tile with this true state."""
    if state == CLEAR:
        chance, wrong = parameters.false_alarm, BLOCK
    else:
        chance, wrong = parameters.miss, CLEAR
    if chance == 0.0:
        return state
    key = key_of(keys, GROUND_UPDATE)
    return wrong if uniform(key, TILE_CHANCE, row, column) < chance else state


@compiled
def _update_sensor(
    numbers: WorldParameters,
    ground: GroundState,
    one: Vehicle,
    sensor: SensorParameters,
    occlusion: Occlusion | None,
    rows: Rows,
) -> None:
    """Update a UAV's ground sensor at its reference position.

    Args:
        numbers: Parameters of the world.
        ground: Ground of all worlds; changed.
        one: The UAV.
        sensor: Its sensor, at its altitude.
        occlusion: Buildings, as seen from there; None: there are none.
        rows: Rows of the UAV.
    """
    world, uav, vehicle = rows
    settings = ground.parameters[0]
    x, y = one.reference_position[0], one.reference_position[1]
    tile_coverage, known = ground.tile_coverage[world, uav], ground.known[world, vehicle]
    accumulate(
        tile_coverage,
        x,
        y,
        sensor,
        settings.tile,
        settings.period * numbers.dt,
        occlusion,
    )
    first_row, end_row = _tile_range(y, sensor.sensing_range, settings.tile, tile_coverage.shape[0])
    first, end = _tile_range(x, sensor.sensing_range, settings.tile, tile_coverage.shape[1])
    for row in range(first_row, end_row):
        sums, states, news = tile_coverage[row, first:end], known[row, first:end], 0
        for i in range(sums.size):  # count first, vectorized: mostly there are none
            news += 1 if (sums[i] >= numbers.desired) & (states[i] == UNSEEN) else 0
        if news == 0:
            continue
        for column in range(first, end):
            if known[row, column] == UNSEEN and tile_coverage[row, column] >= numbers.desired:
                true = ground.tiles[world, row, column]
                reported = _reported_state(settings, true, one.keys, row, column)
                _report(ground, world, vehicle, row, column, reported)


@compiled
def _sense_near(ground: GroundState, one: Vehicle, world: int, vehicle: int) -> None:
    """Report the tiles with a point within the range of a UGV's own sensor."""
    parameters = ground.parameters[0]
    x, y = one.reference_position[0], one.reference_position[1]
    known = ground.known[world, vehicle]
    first_row, end_row = _tile_range(y, parameters.bumper, parameters.tile, known.shape[0])
    first, end = _tile_range(x, parameters.bumper, parameters.tile, known.shape[1])
    for row in range(first_row, end_row):
        d_y = max(row * parameters.tile - y, y - (row + 1) * parameters.tile, 0.0)
        for column in range(first, end):
            if known[row, column] != UNSEEN:
                continue
            d_x = max(column * parameters.tile - x, x - (column + 1) * parameters.tile, 0.0)
            if d_x * d_x + d_y * d_y <= parameters.bumper * parameters.bumper:
                _report(ground, world, vehicle, row, column, ground.tiles[world, row, column])


@compiled
def _meets_block(
    ground: GroundState, world: int, p: FloatArray, q: FloatArray
) -> tuple[int, float]:
    """Return the blocking hazard on the segment from p to q [m], and the share of the segment before it; -1: none."""
    tile, tiles = ground.parameters[0].tile, ground.tiles[world]
    rows, columns = tiles.shape
    first, end = tile_index(min(p[1], q[1]), tile, rows), tile_index(max(p[1], q[1]), tile, rows)
    left = tile_index(min(p[0], q[0]), tile, columns)
    right = tile_index(max(p[0], q[0]), tile, columns)
    for row in range(first, end + 1):
        for column in range(left, right + 1):
            if tiles[row, column] == BLOCK:
                start, stop = (p[0], p[1]), (q[0], q[1])
                return crosses_hazard(ground.hazards[world], ground.corners, BLOCK, start, stop)
    return -1, math.inf


@compiled
def _contact(
    ground: GroundState, world: int, ugv: int, p: FloatArray, q: FloatArray
) -> tuple[bool, float]:
    """Record the blocking hazards that a UGV touches first on its segment from p to q [m].

    Returns:
        True if it is stuck there, and the share of the segment before.
    """
    hit, share = _meets_block(ground, world, p, q)
    if hit < 0:
        return False, math.inf
    ground.hits[world, ugv, hit] = 1
    parameters = ground.parameters[0]
    if parameters.stuck or parameters.first_building <= hit < parameters.end_building:
        return True, share
    # a building may stop a vehicle that other hazards only damage
    first, end = parameters.first_building, parameters.end_building
    start, stop = (p[0], p[1]), (q[0], q[1])
    wall, share = crosses_hazard(
        ground.hazards[world, first:end], ground.corners, BLOCK, start, stop
    )
    if wall >= 0:
        ground.hits[world, ugv, first + wall] = 1
    return wall >= 0, share


@compiled
def _enters_unknown(
    tile: float,
    known: TileArray,
    received: TileArray,
    start: FloatArray,
    end: FloatArray,
    last: tuple[float, float],
) -> bool:
    """Return whether a UGV's path in a tick touches a tile that it does not know to be drivable.

    Args:
        tile: Width of a tile [m].
        known: States reported by its own sensor, or by a complete map; they take precedence over the radio's.
        received: States received by radio.
        start, end: Ends of the path [m], a parabola; at rest it enters no tile.
        last: Displacement in a tick at its final velocity [m].
    """
    if start[0] == end[0] and start[1] == end[1]:
        return False
    rows, columns = known.shape
    bend_x, bend_y = last[0] - (end[0] - start[0]), last[1] - (end[1] - start[1])
    for k in range(_POINTS + 1):
        share = k / _POINTS
        rest = share * (1.0 - share)
        x = start[0] + share * (end[0] - start[0]) - rest * bend_x
        y = start[1] + share * (end[1] - start[1]) - rest * bend_y
        first, stop = _tile_range(y, 0.0, tile, rows)  # closed intervals: two tiles on an edge
        left, right = _tile_range(x, 0.0, tile, columns)
        for i in range(first, stop):
            for j in range(left, right):
                state = known[i, j] if known[i, j] != UNSEEN else received[i, j]
                if state in (UNSEEN, BLOCK):
                    return True
    return False


@compiled
def drive_on(numbers: WorldParameters, ground: GroundState, state: BatchState, world: int) -> None:
    """Check the UGVs for contact with hazards on their path from `before`; a stuck UGV stops."""
    parameters = ground.parameters[0]
    for n in range(ground.ugvs.shape[0]):
        v, start = ground.ugvs[n], ground.before[world, n]
        vehicle = state.vehicles[world, v]
        position, velocity = vehicle.reference_position, vehicle.reference_velocity
        if _enters_unknown(
            parameters.tile,
            ground.tiles[world] if parameters.mapped else ground.known[world, v],
            ground.radioed[world, n],
            start,
            position,
            (numbers.dt * velocity[0], numbers.dt * velocity[1]),
        ):
            row = ground.missions[world, n]
            row.entered += 1
            row.broken += 1 if row.claim == CERTIFIED and row.untrue == 0 else 0
        if ground.pace[world, v] == 0.0:
            continue
        stuck, share = _contact(ground, world, n, start, position)
        if stuck:
            ground.pace[world, v] = 0.0
            for i in range(2):
                position[i] = start[i] + share * (position[i] - start[i])
                velocity[i] = 0.0
            continue
        x, y = position[0], position[1]
        ground.pace[world, v] = 1.0
        if state_at(ground.tiles[world], parameters.tile, x, y) in (ROUGH, BLOCK):
            ground.pace[world, v] = rough_share(ground.hazards[world], ground.corners, x, y)


@compiled
def store_positions(ground: GroundState, state: BatchState, world: int) -> None:
    """Store the UGVs' positions before they move."""
    for n in range(ground.ugvs.shape[0]):
        position = state.vehicles[world, ground.ugvs[n]].reference_position
        ground.before[world, n, 0], ground.before[world, n, 1] = position[0], position[1]


@compiled
def perceive_ground(
    tables: BatchTables, ground: GroundState, state: BatchState, world: int
) -> None:
    """Report the tiles that each vehicle's sensor has observed since the previous tick."""
    numbers = tables.world[row_of(tables.world.shape[0], world)]
    escorts, tick = tables.escorts, state.ticks[world]
    for v in range(ground.report_counts.shape[1]):
        ground.report_counts[world, v] = 0
    if tick > 0 and tick % ground.parameters[0].period == 0:
        for u in range(escorts.shape[0]):
            v = escorts[u, 0]
            one = state.vehicles[world, v]
            sensor, occlusion = view_of(tables.cameras, numbers, state.buildings, world, u, one)
            _update_sensor(numbers, ground, one, sensor, occlusion, Rows(world, u, v))
    for n in range(ground.ugvs.shape[0]):
        _sense_near(ground, state.vehicles[world, ground.ugvs[n]], world, ground.ugvs[n])
