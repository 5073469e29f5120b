"""The world: the true state of all vehicles and of the ground, and the one place where time advances.

Arrays have an axis for vehicles, in name order. One seed, one secret and the same commands give the same bits.
"""

import math
from typing import NamedTuple

from bus.messages import LinkKind
from sim.engine.links import Links, hold_ticks
from sim.engine.run_keys import derive_keys
from sim.engine.world_tick import (
    advance,
    bounds_of,
    detect_all,
    escorts_of,
    first_state,
    measure,
    world_parameters,
)
from sim.kernels.compile import FloatArray
from sim.models.vehicles import brake
from sim.scenario.types import Scenario, Uav


class Look(NamedTuple):
    """A detection that has reached the UAV's computer."""

    tick: int
    """When it was taken."""
    x: float
    y: float
    """p_a - p_g with noise [m]."""


class World:
    """The true state of one run.

    Args:
        scenario: What is flown.
        seed: Of all random numbers, with the secret.
        secret: Of the run, as `sim.engine.run_keys.check_secret` returns it; empty: none.
        gains: Whether the fall of e(t) by each look is counted, in `state.gains`.
    """

    def __init__(
        self, scenario: Scenario, seed: int, *, secret: str = "", gains: bool = False
    ) -> None:
        vehicles = scenario.vehicles
        self.scenario = scenario
        self.seed = seed
        self.keys = derive_keys((seed,), len(vehicles), secret)[0]
        """Of all random numbers. Shape (RUN_PURPOSES, vehicles, 2)."""
        self.names: tuple[str, ...] = tuple(vehicle.name for vehicle in vehicles)
        """Vehicles in the order of every array."""
        self.uavs: tuple[Uav, ...] = tuple(
            vehicle for vehicle in vehicles if isinstance(vehicle, Uav)
        )
        self.escorts = escorts_of(scenario)
        """Rows (UAV, UGV), one for each UAV, in name order."""
        self.bounds = bounds_of(scenario)
        """v_max [m/s] and u_max [m/s²] of each vehicle."""
        self.parameters = world_parameters(scenario, gains=gains)
        self.tick = 0
        self.state = first_state(scenario)
        """Everything that is true but for the links; its arrays stay the same ones."""
        self.position = self.state.position
        """Positions [m], shape (vehicles, 2)."""
        self.velocity = self.state.velocity
        """Velocities [m/s], shape (vehicles, 2)."""
        self.acceleration = self.state.acceleration
        """Accelerations that were applied in the last tick, after their bounds [m/s²], shape (vehicles, 2)."""
        self.coverage = self.state.coverage
        """C of (3) on the grid, all UAVs together. Shape (rows, columns)."""
        self.detections = self.state.detections
        """The relative position each UAV has detected at this tick [m]; NaN where none. Shape (UAVs, 2)."""
        self.links = Links(scenario, self.keys)
        """What messages cross."""
        self.received: list[list[Look]] = [[] for _ in self.uavs]
        """The detections that have reached each UAV's computer at this tick, in the order of arrival."""
        self.commands = self.state.commands
        """What each vehicle acted on in the last tick, before the bounds [m/s²], shape (vehicles, 2)."""
        self._ways_in = [self.links.of(LinkKind.DETECTIONS)[uav.name] for uav in self.uavs]
        self._ways_out = [self.links.of(LinkKind.COMMANDS)[name] for name in self.names]
        self._answered = [-1] * len(
            vehicles
        )  # the tick that the newest command of each, as it has arrived, answers
        self._hold_ticks = hold_ticks(scenario)
        detect_all(self.parameters, self.keys, 0, self.position, self.escorts, self.detections)
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

        Where none comes, the last one is held for a while; then the vehicle brakes. Shape (vehicles, 2); changed
        next time.
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
        advance(
            self.parameters, self.state, self.keys, self.tick, self.bounds, self.escorts, commands
        )
        self._hear()

    def measure(self) -> FloatArray:
        """Distance [m] and e(t) (4) with the true p_g [m²] of each escort at this tick.

        Shape (UAVs, 2); a view, overwritten next time.

        Apart from `step`, because nobody needs it before the vehicles have answered.
        """
        measure(self.parameters, self.position, self.escorts, self.coverage, self.state.measures)
        return self.state.measures
