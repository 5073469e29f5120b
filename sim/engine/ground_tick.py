"""The ground of worlds: its hazards, what vehicles meet on it, and what their sensors tell of it. Compiled.

The ground is divided into tiles. A UAV's sensor accumulates (3) at their centres; where that reaches C* it tells once
what is there, as well as it can. A UGV's bumper tells of the tiles around it without errors. Without hazards all
arrays are empty, and nothing is done.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sim.kernels.compile import FloatArray, IntArray, borrowing, inlined
from sim.kernels.records import RecordArray, records
from sim.models.field import accumulate
from sim.models.ground import (
    BLOCK,
    CLEAR,
    ROUGH,
    UNSEEN,
    TileArray,
    crosses_hazard,
    rough_share,
    state_at,
    tile_index,
)
from sim.models.randomness import GROUND_LOOK, TILE_CHANCE, WordArray, key_of, uniform
from sim.scenario.ground_tables import ground_tables
from sim.scenario.types import Scenario, Ugv


class GroundParameters(NamedTuple):
    """The numbers of the ground, in SI units."""

    tile: float
    period: int
    """Ticks between two looks of a UAV's sensor at the ground."""
    miss: float
    false_alarm: float
    """Chances of a tile with a hazard to be told as clear, and of a clear one to be told as blocked."""
    bumper: float
    stuck: bool
    """True if a vehicle that touches what blocks stays there; else it is damaged and drives on."""


class GroundConstants(NamedTuple):
    """The constants of all worlds."""

    parameters: RecordArray
    """`GroundParameters`. Shape (1,); (0,) where there are no hazards."""
    corners: FloatArray
    """Of all polygons [m]. Shape (any, 2)."""
    ugvs: IntArray
    """For each UGV its row among the vehicles. Shape (UGVs,)."""
    strides: FloatArray
    """The longest way of each UGV in a tick [m]. Shape (UGVs,)."""


class GroundState(NamedTuple):
    """The ground of each world. All arrays have an axis for worlds in front."""

    hazards: RecordArray
    """`HazardRow`: those of the scenario, then those that were drawn. Shape (worlds, hazards)."""
    tiles: TileArray
    """The true state of each tile. Shape (worlds, rows, columns)."""
    looked: npt.NDArray[np.float32]
    """C of (3) of each UAV alone at the tiles' centres. Shape (worlds, UAVs, rows, columns)."""
    known: TileArray
    """Tiles as each vehicle's own sensor has told them. Shape (worlds, vehicles, rows, columns)."""
    seen: npt.NDArray[np.int32]
    """The tiles of which it has told since the tick before, row * columns + column. Shape (worlds, vehicles, room)."""
    told: IntArray
    """Their number. Shape (worlds, vehicles)."""
    pace: FloatArray
    """Share of its largest speed that each vehicle has where it is; 0: it is stuck. Shape (worlds, vehicles)."""
    before: FloatArray
    """Position of each UGV before it moved [m]. Shape (worlds, UGVs, 2)."""
    hits: npt.NDArray[np.uint8]
    """1 where a UGV has touched a hazard that blocks. Shape (worlds, UGVs, hazards)."""


def ground_constants(scenario: Scenario) -> GroundConstants:
    """The constants of a scenario's ground."""
    ground, rows = scenario.ground, list[GroundParameters]()
    if scenario.has_ground:
        rows.append(
            GroundParameters(
                tile=float(ground.tile),
                period=scenario.ground_period,
                miss=float(ground.miss),
                false_alarm=float(ground.false_alarm),
                bumper=float(ground.bumper),
                stuck=ground.touch == "stuck",
            )
        )
    ugvs = [(k, one) for k, one in enumerate(scenario.vehicles) if isinstance(one, Ugv)]
    return GroundConstants(
        parameters=records(GroundParameters, rows),
        corners=ground_tables(scenario).corners,
        ugvs=np.array([k for k, _ in ugvs], dtype=np.int64),
        strides=np.array([one.max_speed * scenario.dt for _, one in ugvs]),
    )


def ground_state(scenario: Scenario, worlds: int) -> GroundState:
    """The ground before anything has been drawn or seen."""
    tables, ground = ground_tables(scenario), scenario.ground
    hazards, tiles = tables.hazards, tables.tiles
    if scenario.has_ground:
        reach = max(scenario.sensor.range, ground.bumper)
        room = min(tiles.size, (2 * math.ceil(reach / ground.tile) + 3) ** 2)
        vehicles, uavs, ugvs = len(scenario.vehicles), len(scenario.uav), len(scenario.ugv)
    else:
        tiles = np.zeros((0, 0), np.uint8)
        room = vehicles = uavs = ugvs = 0
    rows, columns = tiles.shape
    return GroundState(
        hazards=np.repeat(hazards[None], worlds, axis=0),
        tiles=np.repeat(tiles[None], worlds, axis=0),
        looked=np.zeros((worlds, uavs, rows, columns), np.float32),
        known=np.zeros((worlds, vehicles, rows, columns), np.uint8),
        seen=np.zeros((worlds, vehicles, room), np.int32),
        told=np.zeros((worlds, vehicles), np.int64),
        pace=np.ones((worlds, vehicles)),
        before=np.zeros((worlds, ugvs, 2)),
        hits=np.zeros((worlds, ugvs, len(hazards)), np.uint8),
    )


@borrowing
def _tile_range(center: float, reach: float, tile: float, count: int) -> tuple[int, int]:
    """The tiles on one axis that have a point within `reach` [m] of here: the first, and the one after the last."""
    first = math.ceil((center - reach) / tile) - 1
    last = math.floor((center + reach) / tile)
    return max(0, first), min(count, last + 1)


@borrowing
def _tell(ground: GroundState, world: int, vehicle: int, row: int, column: int, state: int) -> None:
    """The sensor of a vehicle tells of a tile."""
    ground.known[world, vehicle, row, column] = state
    n = ground.told[world, vehicle]
    ground.seen[world, vehicle, n] = row * ground.tiles.shape[2] + column
    ground.told[world, vehicle] = n + 1


@borrowing
def _told_state(
    parameters: GroundParameters, state: int, keys: WordArray, vehicle: int, row: int, column: int
) -> int:
    """State that the sensor of UAV v tells of a tile which truly is in this one."""
    if state == CLEAR:
        chance, wrong = parameters.false_alarm, BLOCK
    else:
        chance, wrong = parameters.miss, CLEAR
    if chance == 0.0:
        return state
    key = key_of(keys, GROUND_LOOK, vehicle)
    return wrong if uniform(key, TILE_CHANCE, row, column) < chance else state


@inlined
def _look(
    parameters: RecordArray,
    tables: GroundConstants,
    ground: GroundState,
    world: int,
    uav: int,
    vehicle: int,
    keys: WordArray,
    x: float,
    y: float,
) -> None:
    """A UAV looks at the ground from (x, y) [m]."""
    settings, numbers, looked = tables.parameters[0], parameters[0], ground.looked[world, uav]
    accumulate(
        looked,
        x,
        y,
        numbers.sensor,
        numbers.peak,
        numbers.reach,
        settings.tile,
        settings.period * numbers.dt,
    )
    known, rows, columns = ground.known[world, vehicle], looked.shape[0], looked.shape[1]
    first_row, end_row = _tile_range(y, numbers.reach, settings.tile, rows)
    first, end = _tile_range(x, numbers.reach, settings.tile, columns)
    for row in range(first_row, end_row):
        sums, states, news = looked[row, first:end], known[row, first:end], 0
        for i in range(sums.size):  # several to a vector: mostly there is none
            news += 1 if (sums[i] >= numbers.desired) & (states[i] == UNSEEN) else 0
        if news == 0:
            continue
        for column in range(first, end):
            if known[row, column] == UNSEEN and looked[row, column] >= numbers.desired:
                state = ground.tiles[world, row, column]
                _tell(
                    ground,
                    world,
                    vehicle,
                    row,
                    column,
                    _told_state(settings, state, keys, vehicle, row, column),
                )


@inlined
def _feel(
    tables: GroundConstants, ground: GroundState, world: int, vehicle: int, x: float, y: float
) -> None:
    """The bumper of UGV v at (x, y) [m] tells of the tiles that have a point within its range."""
    parameters, known = tables.parameters[0], ground.known[world, vehicle]
    first_row, end_row = _tile_range(y, parameters.bumper, parameters.tile, known.shape[0])
    first, end = _tile_range(x, parameters.bumper, parameters.tile, known.shape[1])
    for row in range(first_row, end_row):
        d_y = max(row * parameters.tile - y, y - (row + 1) * parameters.tile, 0.0)
        for column in range(first, end):
            if known[row, column] != UNSEEN:
                continue
            d_x = max(column * parameters.tile - x, x - (column + 1) * parameters.tile, 0.0)
            if d_x * d_x + d_y * d_y <= parameters.bumper * parameters.bumper:
                _tell(ground, world, vehicle, row, column, ground.tiles[world, row, column])


@borrowing
def _meets_block(
    tables: GroundConstants, ground: GroundState, world: int, p: FloatArray, q: FloatArray
) -> tuple[int, float]:
    """The hazard that blocks the way from p to q [m], and the share of the way to it; -1: none."""
    tile, tiles = tables.parameters[0].tile, ground.tiles[world]
    rows, columns = tiles.shape
    first, end = tile_index(min(p[1], q[1]), tile, rows), tile_index(max(p[1], q[1]), tile, rows)
    left = tile_index(min(p[0], q[0]), tile, columns)
    right = tile_index(max(p[0], q[0]), tile, columns)
    for row in range(first, end + 1):
        for column in range(left, right + 1):
            if tiles[row, column] == BLOCK:
                start, stop = (p[0], p[1]), (q[0], q[1])
                return crosses_hazard(ground.hazards[world], tables.corners, BLOCK, start, stop)
    return -1, math.inf


@inlined
def drive_on(
    tables: GroundConstants,
    ground: GroundState,
    world: int,
    position: FloatArray,
    velocity: FloatArray,
) -> None:
    """Touches of hazards by the UGVs on their way from `before` to where they are.

    Args:
        tables, ground: The ground of all worlds.
        world: The world.
        position, velocity: Of its vehicles [m], [m/s]; one that is stuck stops. Shape (vehicles, 2).
    """
    parameters = tables.parameters[0]
    for n in range(tables.ugvs.shape[0]):
        v, start = tables.ugvs[n], ground.before[world, n]
        if ground.pace[world, v] == 0.0:
            continue
        hit, share = _meets_block(tables, ground, world, start, position[v])
        if hit >= 0:
            ground.hits[world, n, hit] = 1
            if parameters.stuck:
                ground.pace[world, v] = 0.0
                for i in range(2):
                    position[v, i] = start[i] + share * (position[v, i] - start[i])
                    velocity[v, i] = 0.0
                continue
        x, y = position[v, 0], position[v, 1]
        ground.pace[world, v] = 1.0
        if state_at(ground.tiles[world], parameters.tile, x, y) in (ROUGH, BLOCK):
            ground.pace[world, v] = rough_share(ground.hazards[world], tables.corners, x, y)


@inlined
def keep_before(
    tables: GroundConstants, ground: GroundState, world: int, position: FloatArray
) -> None:
    """Note where the UGVs are before they move."""
    for n in range(tables.ugvs.shape[0]):
        ground.before[world, n, 0], ground.before[world, n, 1] = (
            position[tables.ugvs[n], 0],
            position[tables.ugvs[n], 1],
        )


@inlined
def perceive_ground(
    parameters: RecordArray,
    tables: GroundConstants,
    ground: GroundState,
    world: int,
    tick: int,
    position: FloatArray,
    escorts: IntArray,
    keys: WordArray,
) -> None:
    """Every vehicle's sensor tells of what it has seen of the ground since the tick before.

    Args:
        parameters: `WorldParameters`. Shape (1,).
        tables, ground: The ground of all worlds; `ground` is changed.
        world: The world.
        tick: Now.
        position: Where the vehicles truly are [m]. Shape (vehicles, 2).
        escorts: Rows (UAV, UGV). Shape (UAVs, 2).
        keys: Of the world's random numbers.
    """
    ground.told[world] = 0
    if tick > 0 and tick % tables.parameters[0].period == 0:
        for u in range(escorts.shape[0]):
            v = escorts[u, 0]
            _look(parameters, tables, ground, world, u, v, keys, position[v, 0], position[v, 1])
    for n in range(tables.ugvs.shape[0]):
        v = tables.ugvs[n]
        _feel(tables, ground, world, v, position[v, 0], position[v, 1])
