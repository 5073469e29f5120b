"""The state of worlds, and the tables that they share: the arrays that the compiled tick works on.

Arrays have an axis for vehicles, or for UAVs with the UGVs they escort, in name order.
"""

import math
from typing import Literal, NamedTuple, cast, get_args

import numpy as np

from bus.registry import SENSORS
from sim.engine.ground_state import GroundConstants, GroundState, MissionConstants, MissionState
from sim.kernels.compile import FloatArray, IntArray
from sim.kernels.records import RecordArray, columns, record_type, records
from sim.models.field import cover, empty_coverage
from sim.models.inner_loop import TrackingRecord
from sim.models.randomness import WordArray
from sim.models.wind import DisturbanceRow
from sim.scenario.risk import carries_motions, ugv_carries
from sim.scenario.types import Scenario, Uav


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
    """Return 1 for each vehicle whose receiver flies motions. Shape (vehicles,).

    These are the UAVs where an outage is declared, and the UGVs that navigate.
    """
    carries = carries_motions(scenario)
    return np.array(
        [carries if isinstance(v, Uav) else ugv_carries(scenario, v) for v in scenario.vehicles],
        dtype=np.int64,
    )


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


class BatchTables(NamedTuple):
    """The constants of all worlds."""

    world: RecordArray
    """`WorldParameters`. Shape (1,)."""
    bounds: FloatArray
    """v_max [m/s] and u_max [m/s²]. Shape (vehicles, 2)."""
    escorts: IntArray
    """Rows (UAV, UGV). Shape (UAVs, 2)."""
    traces: IntArray
    """Planned blackouts and recorded links of all links. Shape (any, 2)."""
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
    sent: FloatArray
    """The commands that set out in the coming tick, in the columns `COMMAND`. Shape (worlds, vehicles, columns)."""
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
    links: RecordArray
    """`Link`: of the detections of each UAV, then of the commands of each vehicle, then of other kinds.

    Shape (worlds, links).
    """
    packets: RecordArray
    """`Packet`: those that fly, wait, and have arrived at this tick. Shape (worlds, links, 3, room)."""
    ground: GroundState
    mission: MissionState
