"""The world: the true state of all vehicles and of the ground, and the one place where time advances.

Arrays have an axis for vehicles, in name order. One seed and the same commands give the same bits.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.messages import LinkKind
from sim.compile import FloatArray, compiled
from sim.detection import detect
from sim.field import SENSORS, accumulate, cover, coverage_error, empty_coverage
from sim.links import Links
from sim.scenario import Scenario, Uav
from sim.vehicles import brake, norm, step_vehicle


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
    seed: int


class Look(NamedTuple):
    """A detection that has reached the UAV's computer."""

    tick: int
    """When it was taken."""
    x: float
    y: float
    """p_a - p_g with noise [m]."""


@compiled
def _inside(p: float, v: float, size: float) -> tuple[float, float]:
    """Q has walls: a vehicle that runs into one stops there, on that axis."""
    if p < 0.0:
        return 0.0, max(v, 0.0)
    if p > size:
        return size, min(v, 0.0)
    return p, v


@compiled
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
        position[k, 0], velocity[k, 0] = _inside(p_x, v_x, w.width)
        position[k, 1], velocity[k, 1] = _inside(p_y, v_y, w.height)
        acceleration[k, 0], acceleration[k, 1] = u_x, u_y


@compiled
def _see(w: WorldParameters, position: FloatArray, escorts: npt.NDArray[np.int64], coverage: FloatArray) -> None:
    for k in range(escorts.shape[0]):
        a = escorts[k, 0]
        accumulate(coverage, position[a, 0], position[a, 1], w.sensor, w.peak, w.reach, w.cell, w.dt)


@compiled
def _detect(w: WorldParameters, position: FloatArray, escorts: npt.NDArray[np.int64], tick: int, detections: FloatArray) -> None:
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
                w.seed,
                a,
                tick,
            )


@compiled
def _measure(
    w: WorldParameters, position: FloatArray, escorts: npt.NDArray[np.int64], coverage: FloatArray, measures: FloatArray
) -> None:
    for k in range(escorts.shape[0]):
        a, g = escorts[k, 0], escorts[k, 1]
        measures[k, 0] = norm(position[a, 0] - position[g, 0], position[a, 1] - position[g, 1])
        measures[k, 1] = coverage_error(coverage, position[g, 0], position[g, 1], w.r_o, w.desired, w.cell)


@compiled
def _advance(
    w: WorldParameters,
    tick: int,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    bounds: FloatArray,
    escorts: npt.NDArray[np.int64],
    coverage: FloatArray,
    detections: FloatArray,
    commands: FloatArray,
) -> None:
    """From the tick before to this one: everybody moves (1), the UAVs look at the ground (3) and at their UGVs."""
    _move(w, position, velocity, acceleration, bounds, commands)
    _see(w, position, escorts, coverage)
    _detect(w, position, escorts, tick, detections)


class World:
    """The true state of one run.

    Args:
        scenario: What is flown.
        seed: Of all random numbers.
    """

    def __init__(self, scenario: Scenario, seed: int) -> None:
        vehicles = scenario.vehicles
        self.scenario = scenario
        self.names: tuple[str, ...] = tuple(vehicle.name for vehicle in vehicles)
        """Vehicles in the order of every array."""
        self.uavs: tuple[Uav, ...] = tuple(vehicle for vehicle in vehicles if isinstance(vehicle, Uav))
        index = {name: k for k, name in enumerate(self.names)}
        self.escorts: npt.NDArray[np.int64] = np.array(
            [(index[uav.name], index[uav.escorts]) for uav in self.uavs], dtype=np.int64
        )
        """Rows (UAV, UGV), one for each UAV, in name order."""
        self.bounds: FloatArray = np.array([(v.max_speed, v.max_acceleration) for v in vehicles], dtype=np.float64)
        """v_max [m/s] and u_max [m/s²] of each vehicle."""
        self.parameters = WorldParameters(
            dt=float(scenario.dt),
            width=float(scenario.area.width),
            height=float(scenario.area.height),
            cell=float(scenario.area.cell),
            r_v=float(scenario.visibility.radius),
            r_o=float(scenario.visibility.radius + scenario.sensor.range),
            sensor=SENSORS[scenario.sensor.model],
            peak=float(scenario.sensor.peak),
            reach=float(scenario.sensor.range),
            desired=float(scenario.coverage.desired),
            sigma=float(scenario.detections.noise),
            cut=float(scenario.noise_cut),
            dropout=float(scenario.detections.dropout),
            period=scenario.detection_period,
            seed=seed,
        )
        self.tick = 0
        self.position: FloatArray = np.array([v.position for v in vehicles], dtype=np.float64)
        """Positions [m], shape (vehicles, 2)."""
        self.velocity: FloatArray = np.array([v.velocity for v in vehicles], dtype=np.float64)
        """Velocities [m/s], shape (vehicles, 2)."""
        self.acceleration: FloatArray = np.zeros((len(vehicles), 2))
        """Accelerations that were applied in the last tick, after their bounds [m/s²], shape (vehicles, 2)."""
        self.coverage: FloatArray = empty_coverage(scenario.area.width, scenario.area.height, scenario.area.cell)
        """C of (3) on the grid, all UAVs together. Shape (rows, columns)."""
        for region in scenario.coverage.covered:
            cover(self.coverage, region.lower, region.upper, scenario.area.cell, scenario.coverage.desired)
        self.detections: FloatArray = np.full((len(self.uavs), 2), np.nan)
        """The relative position each UAV has detected at this tick [m]; NaN where none. Shape (UAVs, 2)."""
        self.links = Links(scenario, seed)
        """What messages cross."""
        self.received: list[list[Look]] = [[] for _ in self.uavs]
        """The detections that have reached each UAV's computer at this tick, in the order of arrival."""
        self.commands: FloatArray = np.zeros((len(vehicles), 2))
        """What each vehicle acted on in the last tick, before the bounds [m/s²], shape (vehicles, 2)."""
        self._ways_in = [self.links.of(LinkKind.DETECTIONS)[uav.name] for uav in self.uavs]
        self._ways_out = [self.links.of(LinkKind.COMMANDS)[name] for name in self.names]
        self._answered = [-1] * len(vehicles)  # the tick that the newest command of each, as it has arrived, answers
        self._hold_ticks = round(scenario.hold / scenario.dt)
        self._measures: FloatArray = np.zeros((len(self.uavs), 2))
        _detect(self.parameters, self.position, self.escorts, 0, self.detections)
        self._hear()

    @property
    def time(self) -> float:
        """Simulated time [s]: tick times dt, never a sum."""
        return self.tick * self.parameters.dt

    def _hear(self) -> None:
        """What the detectors found at this tick sets out, and what has arrived is there."""
        tick = self.tick
        for k, (x, y) in enumerate(self.detections.tolist()):
            link = self._ways_in[k]
            if not math.isnan(x):
                link.send(tick, Look(tick, x, y), tick)
            self.received[k] = link.arrivals(tick)

    def send(self, k: int, answered: int, acceleration: tuple[float, float]) -> None:
        """A vehicle's command sets out to its actuators.

        Args:
            k: The vehicle's row.
            answered: The tick whose observation it answers.
            acceleration: [m/s²]
        """
        self._ways_out[k].send(self.tick, (answered, acceleration), answered)

    def heed(self) -> FloatArray:
        """What each vehicle acts on in this tick, once all have sent: its newest command that has arrived.

        Where none comes, the last one is held for a while; then the vehicle brakes. Shape (vehicles, 2); changed next time.
        """
        tick = self.tick
        for k, link in enumerate(self._ways_out):
            for answered, acceleration in link.arrivals(tick):
                if answered > self._answered[k]:
                    self._answered[k], self.commands[k] = answered, acceleration
            if tick - self._answered[k] > self._hold_ticks:
                v_x, v_y = self.velocity[k].tolist()
                self.commands[k] = brake(v_x, v_y, float(self.bounds[k, 1]), self.parameters.dt)
        return self.commands

    def step(self, commands: FloatArray) -> None:
        """Advance by one tick under these commands.

        Args:
            commands: Accelerations [m/s²], shape (vehicles, 2), float64, finite; the bounds of (1) are applied here.
        """
        self.tick += 1
        _advance(
            self.parameters,
            self.tick,
            self.position,
            self.velocity,
            self.acceleration,
            self.bounds,
            self.escorts,
            self.coverage,
            self.detections,
            commands,
        )
        self._hear()

    def measure(self) -> FloatArray:
        """Distance [m] and e(t) (4) with the true p_g [m²] of each escort at this tick.

        Shape (UAVs, 2); a view, overwritten next time.

        Apart from `step`, because nobody needs it before the vehicles have answered.
        """
        _measure(self.parameters, self.position, self.escorts, self.coverage, self._measures)
        return self._measures
