"""The state of worlds, and the tables that they share: the arrays that the compiled tick works on.

Arrays have an axis for vehicles, or for UAVs with the UGVs they escort, in name order.
"""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple, cast, get_args

import numpy as np
import numpy.typing as npt

from bus.registry import SENSORS
from bus.ticks import Look
from sim.channel.link import LinkNumbers, LinkState
from sim.kernels.compile import FloatArray, IntArray
from sim.kernels.records import RecordArray, columns, record_type, records
from sim.models.field import cover, empty_coverage
from sim.models.ground import TileArray
from sim.models.inner_loop import TrackingRecord
from sim.models.randomness import WordArray
from sim.models.wind import DisturbanceRow
from sim.scenario.ground_tables import ground_tables
from sim.scenario.risk import carries_motions
from sim.scenario.types import Scenario, Uav, Ugv

LOOK = columns(Look)
"""Columns of `BatchState.received`."""


class CommandRow(NamedTuple):
    """A command as a row of numbers."""

    answered: float
    """The tick that it answers, -1 where there is none."""
    u_x: float
    u_y: float
    """The acceleration [m/s²]."""
    last: float
    """Of one that carries motions, the tick in which the last of them begins, else -1."""
    carried: float
    """Number of motions that it carries, which begin in that tick and those before it."""


COMMAND = columns(CommandRow)
"""Columns of `BatchState.sent`."""

MESSAGE_SIZE = max(len(LOOK), len(COMMAND))
"""Numbers in a message on a link of detections or commands."""


Precision = Literal["double", "single"]
"""Precision of a coverage grid: 8 or 4 bytes a cell. What is computed from it is in double precision."""


class WorldParameters(NamedTuple):
    """The numbers of a scenario that the tick reads, in SI units."""

    dt: float
    width: float
    height: float
    cell: float
    r_v: float
    r_o: float
    sensor: int
    peak: float
    reach: float
    desired: float
    sigma: float
    cut: float
    dropout: float
    period: int
    hold_ticks: int
    """For how long a vehicle goes on with its last command when none comes."""
    gains: bool
    """True if the fall of e(t) by each look is counted."""


class WorldState(NamedTuple):
    """The truth of one world; with an axis for worlds in front, of each of many."""

    position: FloatArray
    """Positions [m]. Shape (vehicles, 2)."""
    velocity: FloatArray
    """Velocities [m/s]. Shape (vehicles, 2)."""
    acceleration: FloatArray
    """Accelerations applied in the last tick, after their bounds [m/s²]. Shape (vehicles, 2)."""
    commands: FloatArray
    """The commands that acted in the last tick, before the bounds [m/s²]. Shape (vehicles, 2)."""
    coverage: FloatArray
    """C of (3) on the grid, all UAVs together. Shape (rows, columns)."""
    detections: FloatArray
    """The relative position that each UAV has detected at this tick [m]; NaN where none. Shape (UAVs, 2)."""
    gains: FloatArray
    """Decrease of e(t) by the last look of each UAV [m²]. Shape (UAVs,)."""
    measures: FloatArray
    """Distance [m] and e(t) (4) with the true p_g [m²] of each UAV, when they were last measured. Shape (UAVs, 2)."""


def world_parameters(scenario: Scenario, *, gains: bool = False) -> WorldParameters:
    """The numbers of a scenario."""
    return WorldParameters(
        dt=float(scenario.dt),
        width=float(scenario.area.width),
        height=float(scenario.area.height),
        cell=float(scenario.area.cell),
        r_v=float(scenario.visibility.radius),
        r_o=float(scenario.visibility.radius + scenario.sensor.range),
        sensor=SENSORS[scenario.sensor.model].code,
        peak=float(scenario.sensor.peak),
        reach=float(scenario.sensor.range),
        desired=float(scenario.coverage.desired),
        sigma=float(scenario.detections.noise),
        cut=float(scenario.noise_cut),
        dropout=float(scenario.detections.dropout),
        period=scenario.detection_period,
        hold_ticks=round(scenario.hold / scenario.dt),
        gains=gains,
    )


def first_state(scenario: Scenario) -> WorldState:
    """The state that every run of a scenario begins with, before the first look."""
    vehicles, uavs = scenario.vehicles, len(scenario.uav)
    coverage = empty_coverage(scenario.area.width, scenario.area.height, scenario.area.cell)
    for region in scenario.coverage.covered:
        cover(coverage, region.lower, region.upper, scenario.area.cell, scenario.coverage.desired)
    return WorldState(
        position=np.array([v.position for v in vehicles], dtype=np.float64),
        velocity=np.array([v.velocity for v in vehicles], dtype=np.float64),
        acceleration=np.zeros((len(vehicles), 2)),
        commands=np.zeros((len(vehicles), 2)),
        coverage=coverage,
        detections=np.full((uavs, 2), np.nan),
        gains=np.zeros(uavs),
        measures=np.zeros((uavs, 2)),
    )


def grid_in(coverage: FloatArray, precision: Precision) -> FloatArray:
    """A copy of a coverage grid in a precision; no cell has less than before, so that what was covered is.

    Raises:
        ValueError: If there is no such precision.
    """
    if precision not in get_args(Precision):
        allowed = ", ".join(map(repr, get_args(Precision)))
        raise ValueError(f"precision = {precision!r}; allowed: {allowed}")
    if precision == "double":
        return coverage.copy()
    grid = coverage.astype(np.float32)
    less = grid < coverage
    grid[less] = np.nextafter(grid[less], np.float32(np.inf))
    return cast("FloatArray", grid)  # kernels take either


def bounds_of(scenario: Scenario) -> FloatArray:
    """v_max [m/s] and u_max [m/s²] of each vehicle. Shape (vehicles, 2)."""
    return np.array(
        [(v.max_speed, v.max_acceleration) for v in scenario.vehicles], dtype=np.float64
    )


def escorts_of(scenario: Scenario) -> IntArray:
    """Rows (UAV, UGV), one for each UAV, in name order. Shape (UAVs, 2)."""
    index = {vehicle.name: k for k, vehicle in enumerate(scenario.vehicles)}
    escorts = {uav.name: uav.escorts for uav in scenario.uav}
    rows = [(index[name], index[escorts[name]]) for name in index if name in escorts]
    return np.array(rows, dtype=np.int64).reshape(-1, 2)


def receivers_of(scenario: Scenario) -> IntArray:
    """1 for each vehicle whose receiver flies motions: the UAVs, where an outage is declared. Shape (vehicles,)."""
    carries = carries_motions(scenario)
    return np.array([carries and isinstance(v, Uav) for v in scenario.vehicles], dtype=np.int64)


class Told(NamedTuple):
    """Positions and velocities that the vehicles are told to have: where their commands lead, by (1).

    Without wind and errors of the own position that is the truth, and these are its own arrays.
    """

    position: FloatArray
    """[m]. Shape (vehicles, 2); with an axis for worlds in front, of each of many."""
    velocity: FloatArray
    """[m/s]. Likewise."""


def told_of(scenario: Scenario, truth: WorldState) -> Told:
    """Arrays for where the vehicles are told that they are, at the start the truth."""
    if not scenario.disturbed:
        return Told(truth.position, truth.velocity)
    return Told(truth.position.copy(), truth.velocity.copy())


def disturbances_of(scenario: Scenario) -> RecordArray:
    """Disturbance of each UAV beside its commands: rows of `DisturbanceRow`, shape (UAVs,), or none if nothing acts."""
    wind, dt = scenario.wind, scenario.dt
    uavs = [one for one in scenario.vehicles if isinstance(one, Uav)] if scenario.disturbed else []
    rows = [
        DisturbanceRow(
            *uav.tracking.loop,
            mean_x=wind.mean[0],
            mean_y=wind.mean[1],
            gust=wind.gust,
            gust_kept=math.exp(-dt / wind.gust_time),
            limit=wind.largest,
            own_error=uav.own_error,
            own_kept=math.exp(-dt / uav.own_error_time),
        )
        for uav in uavs
    ]
    return records(DisturbanceRow, rows)


def no_tracking_errors(*shape: int) -> RecordArray:
    """Rows of `TrackingRecord` of UAVs that are where they are told to be."""
    return np.zeros(shape, dtype=record_type(TrackingRecord))


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


class BatchTables(NamedTuple):
    """The constants of all worlds."""

    world: RecordArray
    """`WorldParameters`. Shape (1,)."""
    bounds: FloatArray
    """v_max [m/s] and u_max [m/s²]. Shape (vehicles, 2)."""
    escorts: IntArray
    """Rows (UAV, UGV). Shape (UAVs, 2)."""
    links: LinkNumbers
    """Of the detections, a row for each UAV, then of the commands, a row for each vehicle."""
    receivers: IntArray
    """1 for each vehicle whose receiver flies the motions that its commands carry. Shape (vehicles,)."""
    disturbances: RecordArray
    """`DisturbanceRow` of each UAV. Shape (UAVs,); (0,) where nobody is disturbed."""
    ground: GroundConstants
    mission: MissionConstants


class BatchState(NamedTuple):
    """The state of each world. All arrays have an axis for worlds in front."""

    keys: WordArray
    """Of each world's random numbers. Shape (worlds, RUN_PURPOSES, vehicles, 2)."""
    ticks: IntArray
    """Shape (worlds,)."""
    truth: WorldState
    told: Told
    tracking: RecordArray
    """`TrackingRecord`: how each UAV is off what it is told. Shape (worlds, UAVs); (worlds, 0) where nobody is
    disturbed.
    """
    received: FloatArray
    """The detections that reach each UAV at this tick, in the order of arrival. Shape (worlds, UAVs, room,
    MESSAGE_SIZE).
    """
    arrived: IntArray
    """Their number. Shape (worlds, UAVs)."""
    sent: FloatArray
    """The commands that set out in the coming tick. Shape (worlds, vehicles, MESSAGE_SIZE)."""
    motions: RecordArray
    """`MotionRecord` of those that commands carry: of the one that begins in tick k in row k % rows.

    Shape (worlds, vehicles, rows).
    """
    flown: RecordArray
    """`MotionRecord` of the motion that each vehicle flies. Shape (worlds, vehicles, 1)."""
    answered: IntArray
    """The tick that the newest command of each vehicle, as it has arrived, answers; -1: none.

    Shape (worlds, vehicles).
    """
    inbox: FloatArray
    """Room for what arrives by one link. Shape (worlds, room, MESSAGE_SIZE)."""
    links: LinkState
    ground: GroundState
    mission: MissionState
