"""One tick of a world, compiled: the same functions serve a single world and each of many.

Arrays have an axis for vehicles, or for UAVs with the UGVs they escort, in name order.
"""

from typing import NamedTuple

import numpy as np

from bus.registry import SENSORS
from sim.kernels.compile import FloatArray, IntArray, borrowing
from sim.models.detection import detect
from sim.models.field import (
    accumulate,
    accumulate_with_gain,
    cover,
    coverage_error,
    empty_coverage,
)
from sim.models.randomness import DETECTION_CHANCE, DETECTION_NOISE, WordArray, key_of
from sim.models.vehicles import norm, step_vehicle, within_walls
from sim.scenario.types import Scenario


class WorldParameters(NamedTuple):
    """What the step needs of a scenario, as plain numbers in SI units."""

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
    gains: bool
    """Whether the fall of e(t) by each look is counted."""


class WorldState(NamedTuple):
    """What is true. With an axis for worlds in front it is the truth of each of many."""

    position: FloatArray
    """Positions [m]. Shape (vehicles, 2)."""
    velocity: FloatArray
    """Velocities [m/s]. Shape (vehicles, 2)."""
    acceleration: FloatArray
    """What was applied in the last tick, after its bound [m/s²]. Shape (vehicles, 2)."""
    commands: FloatArray
    """What each vehicle acted on in the last tick, before the bound [m/s²]. Shape (vehicles, 2)."""
    coverage: FloatArray
    """C of (3) on the grid, all UAVs together. Shape (rows, columns)."""
    detections: FloatArray
    """The relative position that each UAV has detected at this tick [m]; NaN where none. Shape (UAVs, 2)."""
    gains: FloatArray
    """How far the last look of each UAV made e(t) fall [m²]. Shape (UAVs,)."""
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


def bounds_of(scenario: Scenario) -> FloatArray:
    """v_max [m/s] and u_max [m/s²] of each vehicle. Shape (vehicles, 2)."""
    return np.array(
        [(v.max_speed, v.max_acceleration) for v in scenario.vehicles], dtype=np.float64
    )


def escorts_of(scenario: Scenario) -> IntArray:
    """Rows (UAV, UGV), one for each UAV, in name order. Shape (UAVs, 2)."""
    index = {vehicle.name: k for k, vehicle in enumerate(scenario.vehicles)}
    escorts = {uav.name: uav.escorts for uav in scenario.uav}
    return np.array(
        [(index[name], index[escorts[name]]) for name in index if name in escorts], dtype=np.int64
    )


@borrowing
def _move(
    w: WorldParameters,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    bounds: FloatArray,
    commands: FloatArray,
) -> None:
    for k in range(position.shape[0]):
        p_x, p_y, v_x, v_y, u_x, u_y = step_vehicle(
            position[k, 0],
            position[k, 1],
            velocity[k, 0],
            velocity[k, 1],
            commands[k, 0],
            commands[k, 1],
            bounds[k, 0],
            bounds[k, 1],
            w.dt,
        )
        position[k, 0], velocity[k, 0] = within_walls(p_x, v_x, w.width)
        position[k, 1], velocity[k, 1] = within_walls(p_y, v_y, w.height)
        acceleration[k, 0], acceleration[k, 1] = u_x, u_y


@borrowing
def _see(
    w: WorldParameters,
    position: FloatArray,
    escorts: IntArray,
    coverage: FloatArray,
    gains: FloatArray,
) -> None:
    for k in range(escorts.shape[0]):
        a, g = escorts[k, 0], escorts[k, 1]
        if w.gains:
            gains[k] = accumulate_with_gain(
                coverage,
                position[a, 0],
                position[a, 1],
                position[g, 0],
                position[g, 1],
                w.r_o,
                w.desired,
                w.sensor,
                w.peak,
                w.reach,
                w.cell,
                w.dt,
            )
        else:
            accumulate(
                coverage, position[a, 0], position[a, 1], w.sensor, w.peak, w.reach, w.cell, w.dt
            )


@borrowing
def detect_all(
    w: WorldParameters,
    keys: WordArray,
    tick: int,
    position: FloatArray,
    escorts: IntArray,
    detections: FloatArray,
) -> None:
    """Every UAV's detector looks for its UGV, where it is due at this tick."""
    for k in range(escorts.shape[0]):
        a, g = escorts[k, 0], escorts[k, 1]
        detections[k, 0], detections[k, 1] = np.nan, np.nan
        if tick % w.period == 0:
            _, detections[k, 0], detections[k, 1] = detect(
                position[a, 0] - position[g, 0],
                position[a, 1] - position[g, 1],
                w.r_v,
                w.reach,
                w.dropout,
                w.sigma,
                w.cut,
                key_of(keys, DETECTION_NOISE, a),
                key_of(keys, DETECTION_CHANCE, a),
                tick,
            )


@borrowing
def measure(
    w: WorldParameters,
    position: FloatArray,
    escorts: IntArray,
    coverage: FloatArray,
    measures: FloatArray,
) -> None:
    """Distance [m] and e(t) (4) with the true p_g [m²] of each UAV, into `measures`."""
    for k in range(escorts.shape[0]):
        a, g = escorts[k, 0], escorts[k, 1]
        measures[k, 0] = norm(position[a, 0] - position[g, 0], position[a, 1] - position[g, 1])
        measures[k, 1] = coverage_error(
            coverage, position[g, 0], position[g, 1], w.r_o, w.desired, w.cell
        )


@borrowing
def advance(
    w: WorldParameters,
    s: WorldState,
    keys: WordArray,
    tick: int,
    bounds: FloatArray,
    escorts: IntArray,
    commands: FloatArray,
) -> None:
    """From the tick before to this one: everybody moves (1), the UAVs look at the ground (3) and at their UGVs.

    Args:
        w: The scenario's numbers.
        s: Is changed.
        keys: Of the run's random numbers. Shape (RUN_PURPOSES, vehicles, 2).
        tick: The new one.
        bounds: v_max [m/s] and u_max [m/s²]. Shape (vehicles, 2).
        escorts: Rows (UAV, UGV). Shape (UAVs, 2).
        commands: What acts [m/s²]. Shape (vehicles, 2).
    """
    _move(w, s.position, s.velocity, s.acceleration, bounds, commands)
    _see(w, s.position, escorts, s.coverage, s.gains)
    detect_all(w, keys, tick, s.position, escorts, s.detections)
