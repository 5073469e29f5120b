"""State of worlds, and their common constants: the arrays of the compiled tick.

Arrays have an axis for vehicles, or for UAVs with their UGVs, in name order.
"""

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np

from bus.registry import BODIES
from bus.ticks import MOST_TICKS
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import Pair, RecordArray, fill, record_type, records
from sim.engine.briefing import monitored_bounds, ugv_carries
from sim.engine.space_state import TownState, TownTables, cameras_of
from sim.models.altitude import VerticalState, vertical_state
from sim.models.field import cover, empty_coverage
from sim.models.inner_loop import Disturbance
from sim.models.kinematics import Kinematics, kinematics_of
from sim.models.randomness import RUN_PURPOSES, WordArray
from sim.models.sensor import SensorParameters, sensor_parameters
from sim.models.wind import DisturbanceParameters
from sim.scenario.kinematics import initial_heading
from sim.scenario.types import Scenario, altitude_limits
from sim.scenario.vehicle_types import Uav, Ugv


class WorldParameters(NamedTuple):
    """Scenario parameters used by the tick, in SI units."""

    dt: float
    width: float
    height: float
    cell: float
    r_v: float
    r_o: float
    sensor: SensorParameters
    desired: float
    sigma: float
    cut: float
    dropout: float
    period: int
    timeout_ticks: int
    """Ticks for which the last command stays in effect when no new one arrives."""
    gains: bool
    """True to compute the decrease of e(t) by each sensor update."""
    discovers: bool
    """True if UAVs discover buildings; False: they are briefed on all."""


class Rows(NamedTuple):
    """Rows of one UAV."""

    world: int
    """Index of its world."""
    uav: int
    vehicle: int
    """Row among the UAVs, and among all vehicles."""


def world_parameters(scenario: Scenario, *, gains: bool = False) -> WorldParameters:
    """Return the world parameters of a scenario."""
    return WorldParameters(
        dt=float(scenario.dt),
        width=float(scenario.area.width),
        height=float(scenario.area.height),
        cell=float(scenario.area.cell),
        r_v=float(scenario.visibility.radius),
        r_o=float(scenario.visibility.radius + scenario.sensor.range),
        sensor=sensor_parameters(scenario.sensor),
        desired=float(scenario.coverage.desired),
        sigma=float(scenario.detections.noise),
        cut=float(scenario.detections.truncation),
        dropout=float(scenario.detections.dropout),
        period=scenario.detection_period,
        timeout_ticks=round(scenario.command_timeout / scenario.dt),
        gains=gains,
        discovers=bool(
            scenario.building_field or (scenario.building and not scenario.buildings.known)
        ),
    )


class Vehicle:
    """Limits, state and commands of one vehicle in one world; metres, seconds, ticks.

    The reference state follows the commands by eq. (1). Wind, position errors and its body displace the true state of a
    UAV.
    """

    max_speed: float
    max_acceleration: float
    follows_trajectories: bool
    """True if its receiver executes the backup trajectories of commands."""
    delay_ticks: int
    interval_ticks: int
    """Declared delay of its commands, and longest time from the start of one trajectory to the start of the next
    [ticks].

    After a longer interval, a trajectory that arrives late acts as a bare acceleration.
    """
    position: Pair
    velocity: Pair
    """True state [m], [m/s]."""
    reference_position: Pair
    reference_velocity: Pair
    """Reference state [m], [m/s]."""
    kinematics: Kinematics
    heading: float
    """Kinematics of a UGV, and its heading [rad]; 0 for a point."""
    acceleration: Pair
    """Acceleration applied in the last tick, after the bounds [m/s²]."""
    command: Pair
    """Command executed in the last tick, before the bounds [m/s²]."""
    command_tick: int
    """Tick that the newest received command answers; -1: none."""
    outgoing: Pair
    """Command sent in the next tick [m/s²]."""
    outgoing_tick: int
    """Tick that it answers; -1: none."""
    outgoing_trajectory: int
    outgoing_trajectories: int
    """First tick of the last trajectory in the command, -1: none; number of trajectories."""
    detection: Pair
    """Relative position that a UAV has detected at this tick [m]; NaN: none."""
    gain: float
    """Decrease of e(t) by the last sensor update of a UAV [m²]."""
    sight_radius: float
    """Distance within which a UAV sees its UGV [m]: r_v at its altitude, or 0 while a building hides the UGV."""
    distance: float
    coverage_error: float
    """Distance of a UAV from its UGV [m], and e(t) (4) with the true p_g [m²], at their last measurement."""
    disturbance: Disturbance
    """Tracking error of a UAV and its causes."""
    vertical: VerticalState
    """Altitude of a UAV, and its climb."""
    keys: Annotated[WordArray, (RUN_PURPOSES, 2)]
    """Keys of its random numbers."""


class BatchTables(NamedTuple):
    """Constants of all worlds, or of each world: compiled code reads the row `row_of(rows, world)`."""

    world: RecordArray
    """`WorldParameters`. Shape (1,), or (worlds,) if worlds differ."""
    escorts: IntArray
    """Rows (UAV, UGV). Shape (UAVs, 2)."""
    ugvs: IntArray
    """Row of each UGV among the vehicles. Shape (UGVs,)."""
    traces: IntArray
    """Scheduled blackouts and traces of all links. Shape (rows, 2)."""
    disturbances: RecordArray
    """`DisturbanceParameters` of each UAV. Shape (1 or worlds, UAVs); no UAVs without disturbances."""
    goals: FloatArray
    """Goals of all UGVs [m]. Shape (goals, 2)."""
    goal_rows: IntArray
    """Index of each UGV's first goal, and the end. Shape (UGVs + 1,)."""
    tolerances: FloatArray
    """Goal tolerance of each UGV [m]. Shape (UGVs,)."""
    cameras: RecordArray | None
    """`CameraParameters` of each UAV; None: the UAVs fly in the plane. Shape (UAVs,)."""


class BatchState(NamedTuple):
    """State of each world. All arrays have a leading axis for worlds."""

    ticks: IntArray
    """Current tick of each world. Shape (worlds,)."""
    vehicles: RecordArray
    """`Vehicle`. Shape (worlds, vehicles)."""
    coverage: FloatArray
    """C of (3) on the grid, summed over all UAVs. Shape (worlds, rows, columns)."""
    trajectories: RecordArray
    """`CheckedTrajectory` of each trajectory in commands; the one that starts in tick k is in row k % rows.

    Shape (worlds, vehicles, rows).
    """
    flown: RecordArray
    """`CheckedTrajectory` that each vehicle executes. Shape (worlds, vehicles, 1)."""
    links: RecordArray
    """`Link`: detections of each UAV, then commands of each vehicle, then other kinds.

    Shape (worlds, links).
    """
    buildings: TownTables | None
    """Buildings; None: there are none."""
    town: TownState | None
    """Knowledge of the buildings; None: there are none."""
    packets: RecordArray
    """`Packet`: in transit, queued, and arrived at this tick. Shape (worlds, links, 3, room)."""


def first_coverage(scenario: Scenario) -> FloatArray:
    """Return the initial coverage grid of every run. Shape (rows, columns)."""
    coverage = empty_coverage(scenario.area.width, scenario.area.height, scenario.area.cell)
    for region in scenario.coverage.covered:
        cover(coverage, region.lower, region.upper, scenario.area.cell, scenario.coverage.desired)
    return coverage


def first_vehicles(scenario: Scenario) -> RecordArray:
    """Return the initial state of every run, before the first sensor update. Shape (vehicles,)."""
    vehicles = np.zeros(len(scenario.vehicles), record_type(Vehicle))
    for row, one in zip(vehicles, scenario.vehicles, strict=True):
        row["max_speed"], row["max_acceleration"] = one.max_speed, one.max_acceleration
        row["interval_ticks"] = MOST_TICKS  # the stop of a UGV's trajectory is safe for any time
        row["follows_trajectories"] = isinstance(one, Uav) or ugv_carries(scenario, one)
        if isinstance(one, Uav):
            bounds = monitored_bounds(scenario, one.name)
            row["delay_ticks"], row["interval_ticks"] = bounds.delay_ticks, bounds.interval_ticks
            row["vertical"] = vertical_state(altitude_limits(scenario, one))[0]
        row["position"] = row["reference_position"] = one.position
        row["velocity"] = row["reference_velocity"] = one.velocity
        if isinstance(one, Ugv):
            fill(row["kinematics"], kinematics_of(one))
            row["heading"] = initial_heading(one)
    vehicles["command_tick"] = vehicles["outgoing_tick"] = vehicles["outgoing_trajectory"] = -1
    vehicles["detection"] = math.nan
    return vehicles


def escorts_of(scenario: Scenario) -> IntArray:
    """Return the rows (UAV, UGV) of each UAV, in name order. Shape (UAVs, 2)."""
    index = {vehicle.name: k for k, vehicle in enumerate(scenario.vehicles)}
    escorts = {uav.name: uav.escorts for uav in scenario.uav}
    rows = [(index[name], index[escorts[name]]) for name in index if name in escorts]
    return np.array(rows, dtype=np.int64).reshape(-1, 2)


def disturbances_of(scenario: Scenario) -> RecordArray:
    """Return the `DisturbanceParameters` of each UAV. Shape (UAVs,); (0,) without disturbances."""
    wind, dt = scenario.wind, scenario.dt
    uavs = [one for one in scenario.vehicles if isinstance(one, Uav)] if scenario.disturbed else []
    rows = [
        DisturbanceParameters(
            loop=uav.tracking,
            mean=wind.mean,
            gust=wind.gust,
            gust_kept=math.exp(-dt / wind.gust_time),
            limit=wind.largest,
            position_error=uav.position_error,
            own_kept=math.exp(-dt / uav.position_error_time),
            outside=bool(BODIES[uav.body].make),
        )
        for uav in uavs
    ]
    return records(DisturbanceParameters, rows)


def batch_tables(
    scenario: Scenario, parameters: WorldParameters, traces: IntArray, rows: int = 1
) -> BatchTables:
    """Return the constants of a scenario; `rows`: 1, or the number of worlds if they differ."""
    ugvs = [(k, one) for k, one in enumerate(scenario.vehicles) if isinstance(one, Ugv)]
    goals, goal_rows = joined([np.array(one.goals, float).reshape(-1, 2) for _, one in ugvs], 2)
    return BatchTables(
        world=records(WorldParameters, [parameters] * rows),
        escorts=escorts_of(scenario),
        ugvs=np.array([k for k, _ in ugvs], dtype=np.int64),
        traces=traces,
        disturbances=np.repeat(disturbances_of(scenario)[None], rows, axis=0),
        goals=goals,
        goal_rows=goal_rows,
        tolerances=np.array([one.goal_tolerance for _, one in ugvs], dtype=np.float64),
        cameras=cameras_of(scenario),
    )


def joined(arrays: Sequence[FloatArray], width: int) -> tuple[FloatArray, IntArray]:
    """Concatenate arrays; return the result and the start of each."""
    edges = np.cumsum([0, *(len(array) for array in arrays)]).astype(np.int64)
    return np.concatenate([np.zeros((0, width)), *arrays]), edges
