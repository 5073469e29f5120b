"""Gateway of a run: an observer's telemetry, and teleoperation of UGVs with the operator's credentials."""

import math
import time
from collections.abc import Iterator, Mapping

from bus.messages.base import Message
from bus.messages.control import Action, Control
from bus.messages.scenario import Law, Limits
from bus.messages.telemetry import Status, TeamStatus, Truth
from bus.messages.vehicle import Teleoperation
from bus.numbers import above, exact
from bus.registry import LAWS, TELEOP
from outrider.view.operator import Helm, RunClient
from outrider_mavlink.dialect import MavMessage
from outrider_mavlink.gateway import (
    ACCEPTED,
    BEYOND_BOUNDS,
    DENIED,
    NOT_ALLOWED,
    UNSUPPORTED,
    Gateway,
    Numbers,
)
from outrider_mavlink.identity import MANUAL, MISSION, Moving, TeamState, VehicleSystem
from outrider_mavlink.udp import Network, Peer
from sim.scene.altitude import HIDDEN, decisive, sight_of

_RETRY = 1.0
"""Time between two requests for control of the same UGV [s]."""
_CONFIRMATION_TIME = 2.0
"""Time for which a changed parameter is reported before the simulator confirms it [s]."""
_FULL = 1000
"""Joystick value at full deflection."""
_NO_AXIS = 32_767
"""Joystick value of a missing axis."""
_UNBOUNDED = 1.0
"""Speed of a UGV without a bound at full deflection [m/s]."""
_LAWS = tuple(LAWS)


class RunGateway(Gateway):
    """Gateway for all vehicles of a run.

    Args:
        client: Client that reads the run, and sends commands if its session is an operator's.
        network: UDP sockets.
        status: First status, with the run's geometry.
        first: System number of the first vehicle; the others follow in order of their names.
        height: Height in the telemetry of UAVs without an altitude [m].
    """

    def __init__(
        self, client: RunClient, network: Network, status: Status, *, first: int, height: float
    ) -> None:
        geometry, systems = status.geometry, list[VehicleSystem]()
        if geometry is not None:
            origin, uavs = geometry.origin, geometry.uavs
            systems = [
                VehicleSystem(name, number, flies=name in uavs, origin=origin, height=height)
                for number, name in enumerate(sorted(status.vehicles), first)
            ]
        super().__init__(network, systems)
        self._client, self._status = client, status
        self._helm = Helm(client.control, client.drive)
        self._named = {system.name: system for system in self.systems.values()}
        self._joined: set[str] = set()
        self._rejections = status.rejections
        self._requested: dict[str, float] = {}
        # Values of changed parameters, and the times until which they are reported.
        self._set: dict[str, tuple[float, float]] = {}

    def take(self, message: Message) -> None:
        """Process a message of the run."""
        match message:
            case Truth():
                self._update_truth(message)
            case Status():
                self._update_status(message)

    def _update_truth(self, truth: Truth) -> None:
        for name, vehicle in truth.vehicles.items():
            system = self._named.get(name)
            if system is not None:
                moving = Moving(
                    truth.time,
                    vehicle.position,
                    vehicle.velocity,
                    vehicle.acceleration,
                    altitude=vehicle.altitude,
                    climb_rate=vehicle.climb_rate,
                    heading=vehicle.heading,
                )
                system.move(moving)
                system.followed = None if system.flies else moving
        geometry = self._status.geometry
        radius = math.inf if geometry is None else geometry.visibility_radius
        deciding = {escort.uav for escort in decisive(truth.escorts)}
        for escort in truth.escorts:
            ugv, sight = escort.ugv, sight_of(escort, radius)
            why = (
                HIDDEN
                if sight.hidden
                else f"out of sight: distance {above(sight.distance, sight.radius)} m, r_v {exact(sight.radius)} m"
            )
            self._report_problem(
                escort.uav,
                "visibility",
                wrong=sight.lost and escort.uav in deciding,
                worse=f"{ugv} is {why}",
                better=f"{ugv} is in sight again",
            )

    def _update_status(self, status: Status) -> None:
        if status.over and not self._status.over:
            self._say_to_all("the run is over")
        self._status = status
        for name, vehicle in status.vehicles.items():
            if vehicle.present:
                self._joined.add(name)
            disconnected = name in self._joined and not vehicle.present and not status.over
            worse = f"{name}: process disconnected"
            better = f"{name}: process reconnected"
            self._report_problem(name, "process", wrong=disconnected, worse=worse, better=better)
        for name, certified in status.certified.items():
            reason = status.uncertified.get(name)
            worse = f"not certified: {reason.text if reason else ''}"
            self._report_problem(
                name, "filter", wrong=not certified, worse=worse, better="certified again"
            )
        if status.team is not None:
            self._update_team(status, status.team)
        for name, driver in status.drivers.items():
            if name in self._named:
                self._named[name].mode = MANUAL if driver == TELEOP else MISSION
        for one in [one for one in status.rejections if one not in self._rejections]:
            self._say_to_all(one.text)
        self._rejections = status.rejections

    def _update_team(self, status: Status, team: TeamStatus) -> None:
        """Update the UAVs of teams: send role and number, and a text for each change of role."""
        endurances = {} if status.geometry is None else status.geometry.endurances
        for name, number in team.numbers.items():
            system = self._named.get(name)
            if system is None:
                continue
            role, before = status.roles.get(name), system.team
            system.team = TeamState(role, number, team.charges.get(name), endurances.get(name))
            if role is not None and before is not None and before.role not in (None, role):
                self.say(system, f"{name}: {role.lower()}")
            for message in system.values():
                self.send(system, message)

    def _report_problem(
        self, name: str, kind: str, *, wrong: bool, worse: str, better: str
    ) -> None:
        system = self._named.get(name)
        if system is not None:
            self.report_problem(system, kind, wrong=wrong, worse=worse, better=better)

    def _say_to_all(self, text: str) -> None:
        for system in self.systems.values():
            self.say(system, text, warns=True)

    def parameters(self, system: VehicleSystem) -> Mapping[str, float]:
        """Return the settings of the run; an operator can set the last three."""
        now = time.monotonic()
        current = dict(self._settings(system))
        changed = {name: value for name, (value, until) in self._set.items() if now < until}
        return current | changed

    def _settings(self, system: VehicleSystem) -> Iterator[tuple[str, float]]:
        status, geometry = self._status, self._status.geometry
        if geometry is not None:
            limits = geometry.limits.get(system.name, Limits(max_speed=None, max_acceleration=None))
            yield "AREA_HEIGHT", geometry.area.height
            yield "AREA_WIDTH", geometry.area.width
            yield "DT", geometry.dt
            yield "DURATION", status.ticks * geometry.dt
            v, u = limits.max_speed, limits.max_acceleration
            yield "MAX_ACCEL", math.inf if u is None else u
            yield "MAX_SPEED", math.inf if v is None else v
            yield "SENSOR_RANGE", geometry.sensor_range
            yield "VIS_RADIUS", geometry.visibility_radius
        yield "LAW", float(_LAWS.index(status.law)) if status.law in _LAWS else -1.0
        yield "PAUSED", float(status.paused)
        yield "RT_FACTOR", 0.0 if status.target_factor is None else status.target_factor

    def set_parameter(self, peer: Peer, system: VehicleSystem, name: str, value: float) -> None:
        """Request a changed setting from the simulator."""
        control: Control | None = None
        if not self._may_control(f"parameter {name}"):
            return
        match name:
            case "LAW" if value in range(len(_LAWS)):
                control = Control(action=Action.LAW, law=Law(name=_LAWS[int(value)]))
            case "PAUSED" if value in (0.0, 1.0):
                control = Control(action=Action.PAUSE if value else Action.RESUME)
            case "RT_FACTOR" if value == 0.0 or 1e-3 <= value <= 1e4:
                control = Control(action=Action.SPEED, factor=value or None)
            case "LAW" | "PAUSED" | "RT_FACTOR":
                self.reject(BEYOND_BOUNDS, f"parameter {name} = {value:g}")
            case _:
                super().set_parameter(peer, system, name, value)
        if control is not None and self._client.control(control):
            self._set[name] = (value, time.monotonic() + _CONFIRMATION_TIME)

    def _may_control(self, what: str) -> bool:
        if not self._client.may_steer:
            self.reject(NOT_ALLOWED, f"{what} without the operator's credentials")
        return self._client.may_steer

    def change_mode(self, peer: Peer, system: VehicleSystem, mode: Numbers) -> int:
        """Take control of a UGV (MANUAL), or return it to its driver (MISSION)."""
        if mode == (system.mode.main, system.mode.sub):
            return ACCEPTED
        if system.flies:
            self.reject(
                NOT_ALLOWED, f"changing the mode of {system.name}, controlled by its own process,"
            )
            return DENIED
        if mode not in ((MANUAL.main, MANUAL.sub), (MISSION.main, MISSION.sub)):
            return UNSUPPORTED
        if not self._may_control("changing the mode") or not self.holds(peer):
            return DENIED
        if mode == (MANUAL.main, MANUAL.sub):
            return ACCEPTED if self._take_control(system) else DENIED
        return ACCEPTED if self._helm.hand_back(system.name) else DENIED

    def manual(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        """Drive a UGV; the first deflection of the joystick takes control.

        Forward is north and right is east. A UGV that steers drives forward and turns to the right.
        """
        if system.flies:
            self.reject(NOT_ALLOWED, f"MANUAL_CONTROL of the UAV {system.name}")
            return
        if not self._may_control("MANUAL_CONTROL"):
            return
        north, east = (0 if axis == _NO_AXIS else axis for axis in (message.x, message.y))
        if max(abs(north), abs(east)) > _FULL:
            self.reject(BEYOND_BOUNDS, f"MANUAL_CONTROL x = {north}, y = {east}")
            return
        displaced = self._helm.displaced(self._status, system.name)
        driven = self._status.drivers.get(system.name) == TELEOP and not displaced
        if not driven and not (north or east):
            return  # a centered joystick takes no control
        if self.holds(peer) and (driven or self._take_control(system)):
            name = f"MAVLink {peer.system}"
            self._helm.steer(system.name, self._drive_of(system, name, north / _FULL, east / _FULL))

    def _drive_of(
        self, system: VehicleSystem, operator: str, forward: float, right: float
    ) -> Teleoperation:
        """Return the input of an operator for a deflection of the joystick, as shares of the full one."""
        geometry = self._status.geometry
        limits = None if geometry is None else geometry.limits.get(system.name)
        full = _UNBOUNDED if limits is None or limits.max_speed is None else limits.max_speed
        turn_rate = None if geometry is None else geometry.max_turn_rates.get(system.name)
        if turn_rate is not None:
            return Teleoperation(
                operator=operator, speed=full * forward, turn_rate=-turn_rate * right
            )
        longer = max(1.0, math.hypot(right, forward))  # both axes are full in a corner
        velocity = full * right / longer, full * forward / longer
        return Teleoperation(operator=operator, velocity=velocity)

    def _take_control(self, system: VehicleSystem) -> bool:
        now = time.monotonic()
        if now - self._requested.get(system.name, -math.inf) < _RETRY:
            return True
        self._requested[system.name] = now
        return self._helm.take(system.name, self._status.drivers.get(system.name, ""))

    def close(self) -> None:
        """Return control of all UGVs to their drivers."""
        for name in self._helm.waiting(self._status):
            self._helm.hand_back(name)
        self._client.close()
