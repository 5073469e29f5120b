"""A run for ground stations: the truth that observers are given, and with an operator's rights a UGV's wheel."""

import math
import time
from collections.abc import Iterator, Mapping

from bus.messages.base import Message, Vector
from bus.messages.control import Action, Control
from bus.messages.scenario import Law, Limits
from bus.messages.telemetry import Status, Truth
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
from outrider_mavlink.identity import MANUAL, MISSION, Moving, VehicleSystem
from outrider_mavlink.udp import Network, Peer

_ASK_AGAIN = 1.0
"""Time after which a wheel that was asked for in vain is asked for again [s]."""
_BELIEVED = 2.0
"""For so long a parameter is told as it was set before the simulator has confirmed it [s]."""
_FULL = 1000
"""A stick at its stop."""
_NO_AXIS = 32_767
"""An axis that there is not."""
_UNBOUNDED = 1.0
"""Speed at the stop for a UGV without a bound [m/s]."""
_LAWS = tuple(LAWS)


class RunGateway(Gateway):
    """Tells all vehicles of a run to ground stations.

    Args:
        client: Reads the run, and speaks to it if its session is an operator's.
        network: Where it is told.
        status: The first one, with the run's geometry.
        first: Number of the first vehicle's system; the others follow in name order.
        height: At which UAVs are told to fly [m].
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
        self._refusals = status.refusals
        self._asked: dict[str, float] = {}
        # What parameters were set to, and until when.
        self._set: dict[str, tuple[float, float]] = {}

    def take(self, message: Message) -> None:
        """Take in what the run tells."""
        match message:
            case Truth():
                self._take_truth(message)
            case Status():
                self._take_status(message)

    def _take_truth(self, truth: Truth) -> None:
        for name, vehicle in truth.vehicles.items():
            system = self._named.get(name)
            if system is not None:
                moving = Moving(
                    truth.time, vehicle.position, vehicle.velocity, vehicle.acceleration
                )
                system.move(moving)
                system.followed = None if system.flies else moving
        geometry = self._status.geometry
        radius = math.inf if geometry is None else geometry.visibility_radius
        for escort in truth.escorts:
            ugv = escort.ugv
            self._judge(
                escort.uav,
                "sight",
                wrong=escort.distance >= radius,
                worse=f"{ugv} is out of sight: {escort.distance:.2f} m, r_v is {radius:g} m",
                better=f"{ugv} is in sight again",
            )

    def _take_status(self, status: Status) -> None:
        if status.over and not self._status.over:
            self._say_to_all("the run is over")
        self._status = status
        for name, vehicle in status.vehicles.items():
            if vehicle.present:
                self._joined.add(name)
            gone = name in self._joined and not vehicle.present and not status.over
            worse = f"{name} is lost: its process has gone"
            self._judge(name, "process", wrong=gone, worse=worse, better=f"{name} is back")
        for name, certified in status.certified.items():
            reason = status.uncertified.get(name)
            worse = f"sight is not certified: {reason.text if reason else ''}"
            self._judge(
                name, "filter", wrong=not certified, worse=worse, better="sight is certified again"
            )
        for name, driver in status.drivers.items():
            if name in self._named:
                self._named[name].mode = MANUAL if driver == TELEOP else MISSION
        for line in [one for one in status.refusals if one not in self._refusals]:
            self._say_to_all(line)
        self._refusals = status.refusals

    def _judge(self, name: str, kind: str, *, wrong: bool, worse: str, better: str) -> None:
        system = self._named.get(name)
        if system is not None:
            self.judge(system, kind, wrong=wrong, worse=worse, better=better)

    def _say_to_all(self, text: str) -> None:
        for system in self.systems.values():
            self.say(system, text, warns=True)

    def parameters(self, system: VehicleSystem) -> Mapping[str, float]:
        """The run's settings; the last three an operator's ground station may set."""
        now = time.monotonic()
        told = dict(self._settings(system))
        set_lately = {name: value for name, (value, until) in self._set.items() if now < until}
        return told | set_lately

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
        """Ask the simulator for another setting."""
        control: Control | None = None
        if not self._may_steer(f"parameter {name}"):
            return
        match name:
            case "LAW" if value in range(len(_LAWS)):
                control = Control(action=Action.LAW, law=Law(name=_LAWS[int(value)]))
            case "PAUSED" if value in (0.0, 1.0):
                control = Control(action=Action.PAUSE if value else Action.RESUME)
            case "RT_FACTOR" if value == 0.0 or 1e-3 <= value <= 1e4:
                control = Control(action=Action.SPEED, factor=value or None)
            case "LAW" | "PAUSED" | "RT_FACTOR":
                self.refuse(BEYOND_BOUNDS, f"parameter {name} = {value:g}")
            case _:
                super().set_parameter(peer, system, name, value)
        if control is not None and self._client.control(control):
            self._set[name] = (value, time.monotonic() + _BELIEVED)

    def _may_steer(self, what: str) -> bool:
        if not self._client.may_steer:
            self.refuse(NOT_ALLOWED, f"{what}: needs the operator's credentials, and")
        return self._client.may_steer

    def change_mode(self, peer: Peer, system: VehicleSystem, mode: Numbers) -> int:
        """A UGV's wheel is taken in MANUAL and handed back in AUTO."""
        if mode == (system.mode.main, system.mode.sub):
            return ACCEPTED
        if system.flies:
            self.refuse(
                NOT_ALLOWED, f"a mode: {system.name} is flown by its own process, and another"
            )
            return DENIED
        if mode not in ((MANUAL.main, MANUAL.sub), (MISSION.main, MISSION.sub)):
            return UNSUPPORTED
        if not self._may_steer("a mode") or not self.holds(peer):
            return DENIED
        if mode == (MANUAL.main, MANUAL.sub):
            return ACCEPTED if self._take_wheel(system) else DENIED
        return ACCEPTED if self._helm.hand_back(system.name) else DENIED

    def manual(self, peer: Peer, system: VehicleSystem, message: MavMessage) -> None:
        """Drive a UGV: stick forward is north, to the right is east; the first deflection takes the wheel."""
        if system.flies:
            self.refuse(NOT_ALLOWED, f"MANUAL_CONTROL: {system.name} is a UAV, and that")
            return
        if not self._may_steer("MANUAL_CONTROL"):
            return
        north, east = (0 if axis == _NO_AXIS else axis for axis in (message.x, message.y))
        if max(abs(north), abs(east)) > _FULL:
            self.refuse(BEYOND_BOUNDS, f"MANUAL_CONTROL x = {north}, y = {east}")
            return
        displaced = self._helm.displaced(self._status, system.name)
        driven = self._status.drivers.get(system.name) == TELEOP and not displaced
        if not driven and not (north or east):
            return  # a ground station that is only there
        if self.holds(peer) and (driven or self._take_wheel(system)):
            wanted = self._velocity(system, east / _FULL, north / _FULL)
            self._helm.steer(system.name, f"MAVLink {peer.system}", wanted)

    def _velocity(self, system: VehicleSystem, east: float, north: float) -> Vector:
        geometry = self._status.geometry
        limits = None if geometry is None else geometry.limits.get(system.name)
        full = _UNBOUNDED if limits is None or limits.max_speed is None else limits.max_speed
        longer = max(1.0, math.hypot(east, north))  # in a corner both are at their stops
        return full * east / longer, full * north / longer

    def _take_wheel(self, system: VehicleSystem) -> bool:
        now = time.monotonic()
        if now - self._asked.get(system.name, -math.inf) < _ASK_AGAIN:
            return True
        self._asked[system.name] = now
        return self._helm.take(system.name, self._status.drivers.get(system.name, ""))

    def close(self) -> None:
        """Hand all wheels back."""
        for name in self._helm.waiting(self._status):
            self._helm.hand_back(name)
        self._client.close()
