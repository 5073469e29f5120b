"""Robots that fly UAVs: the simulator checks the states that their processes report, and passes them to the bodies."""

import math
from collections import Counter
from collections.abc import Callable

from bus.messages.robot import MAX_OVERSPEED, MAX_STATE_AGE, RobotState
from bus.messages.vehicle import UavCommand
from bus.numbers import above, exact
from bus.ticks import ticks_within
from sim.models.body import Motion
from sim.scenario.types import Scenario
from sim.world import World

NO_ROBOT = "reports a robot, but its body is a model"
NOT_FINITE = "reports a robot's state that is not finite"
TOO_FAR = "reports a robot too far from its reference"
TOO_FAST = "reports a robot that is too fast"


class Robots:
    """Reported states of all robots, with counts of missing and rejected ones.

    Args:
        scenario: Scenario of the run.
        world: World of the run.
        on_notice: Called with one line for the user.
    """

    def __init__(self, scenario: Scenario, world: World, on_notice: Callable[[str], None]) -> None:
        self._world, self._on_notice = world, on_notice
        self._uavs = {uav.name: uav for uav in world.uavs}
        self._limit = scenario.visibility.radius
        self._patience = ticks_within(MAX_STATE_AGE, scenario.dt)
        self._since: dict[str, int | None] = {
            name: None if name in world.robots else 0 for name in self._uavs
        }
        self._gap: dict[str, int] = dict.fromkeys(world.robots, 0)  # ticks without a valid state
        self.unreported: dict[str, int] = dict.fromkeys(world.names, 0)
        """Ticks without a valid state of each vehicle's robot."""
        self.rejected: dict[str, Counter[str]] = {name: Counter() for name in world.names}
        """Rejected states of each vehicle's robot, by cause."""
        self.faults: dict[str, str] = dict.fromkeys(world.names, "")
        """Latest rejection of each vehicle."""
        self.notices: dict[str, str] = {}
        """Warning for each UAV whose robot has not been reported for a second."""

    def receive(self, name: str, command: UavCommand) -> None:
        """Pass the state in a UAV's command to its body, which shows it at the next tick; reject a wrong one."""
        state = command.robot
        if state is None:
            return
        fault = self._fault(name, state)
        if fault is not None:
            self._reject(name, *fault)
            return
        altitude = 0.0 if state.altitude is None else state.altitude
        motion = Motion((*state.position, altitude), (*state.velocity, 0.0))
        self._world.robots[name].receive(motion, state.age)

    def _fault(self, name: str, state: RobotState) -> tuple[str, str] | None:
        """Return the cause and the details of a wrong state; None: it is right."""
        if name not in self._world.robots:
            return NO_ROBOT, f"uav.body = {self._uavs[name].body!r}; allowed: 'reported'"
        vehicle = self._world.vehicles[self._world.names.index(name)]
        (x, y), high = vehicle["reference_position"].tolist(), vehicle["vertical"]["altitude"]
        up = 0.0 if state.altitude is None else state.altitude - float(high)
        off = math.hypot(state.position[0] - x, state.position[1] - y, up)
        speed, bound = math.hypot(*state.velocity), self._uavs[name].max_speed + MAX_OVERSPEED
        if not all(map(math.isfinite, (off, speed, state.age))):
            return NOT_FINITE, f"position {state.position}, velocity {state.velocity}"
        if off > self._limit:
            return TOO_FAR, f"{above(off, self._limit)} m; allowed: up to {exact(self._limit)} m"
        if speed > bound:
            return TOO_FAST, f"{above(speed, bound)} m/s; allowed: up to {exact(bound)} m/s"
        return None

    def _reject(self, name: str, cause: str, fault: str) -> None:
        """Count a rejected state, and report the first of each cause."""
        self.rejected[name][cause] += 1
        self.faults[name] = f"{cause}: {fault}"
        if self.rejected[name][cause] == 1:
            self._on_notice(f"{name}: {cause}: {fault}; rejected, further ones are only counted")

    def update(self) -> None:
        """Count the robots without a valid state at this tick, before the world advances."""
        for name, body in self._world.robots.items():
            if body.current:
                if self._since[name] is None:
                    self._since[name] = self._world.tick
                self._gap[name] = 0
                if self.notices.pop(name, None):
                    self._on_notice(f"{name}: its robot's state is reported again")
                continue
            self._since[name] = None
            self._gap[name] += 1
            self.unreported[name] += 1
            if self._gap[name] == self._patience:
                self.notices[name] = notice = (
                    f"{name}: its process has reported no valid state of its robot for {MAX_STATE_AGE:g} s: the true "
                    "position stays at the last one, and nothing is certified"
                )
                self._on_notice(notice)

    def is_known(self, name: str) -> bool:
        """Return whether the true state of a UAV is known at the world's tick."""
        body = self._world.robots.get(name)
        return body is None or body.current

    def since(self) -> tuple[int | None, ...]:
        """Return the tick from which on the state of each UAV has been known; None: it is unknown."""
        return tuple(self._since.values())
