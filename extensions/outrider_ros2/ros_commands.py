"""Operator commands from ROS 2: velocities and service calls, forwarded after a check or counted as rejected.

A UGV that is a point has no heading: `linear.x` is its velocity east and `linear.y` north, both in `map` and in its
base_link. For a UGV that steers, a twist is in its base_link: `linear.x` is its speed and `angular.z` its turn rate.
"""

import math
import threading
import time
from collections.abc import Collection, Mapping
from typing import NamedTuple

import msgspec

from bus.messages.control import Action, Control
from bus.messages.scenario import Limits
from bus.messages.telemetry import Status
from bus.messages.vehicle import Teleoperation
from bus.numbers import above, exact
from bus.registry import TELEOP
from outrider.running.refused import Refusals, Refused
from outrider.view.operator import Helm, RunClient
from outrider_ros2.conversion import MAP, base_link
from outrider_ros2.interfaces import (
    RosMessage,
    check_type,
    decode,
    decode_checked,
    encode,
    make,
    request_of,
    response_of,
)
from outrider_ros2.roles import CALLS, CMD_VEL, REQUESTS, RUN_SERVICES, SERVICES, VELOCITIES
from outrider_ros2.ros_node import RosNode
from outrider_ros2.topics import wire_topic
from outrider_ros2.wire import NEWEST

TWISTS = ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist")
_SERVICES = {
    service: "std_srvs/srv/SetBool" if service == "pause" else "std_srvs/srv/Trigger"
    for service in SERVICES
}
"""Type of each service."""
_CONTROL_TIMEOUT = 1.0
"""Time without a message after which a node loses control of a UGV [s]."""
_SPEED_TOLERANCE = 1e-9
"""Relative tolerance of a speed limit, for rounding."""
_DRIVER = "ROS 2"


class VelocityCommand(NamedTuple):
    """Velocity commanded to a UGV."""

    vehicle: str
    drive: Teleoperation
    """Velocity in `map`, or speed and turn rate of a UGV that steers."""


def velocity_command(
    key: str,
    payload: bytes,
    *,
    domain: int,
    namespace: str,
    ugvs: Mapping[str, Limits],
    steering: Collection[str] = (),
) -> VelocityCommand:
    """Return the velocity command in a message on `cmd_vel`.

    Args:
        key: Key of the message.
        payload: Payload of the message.
        domain: ROS 2 domain id of the bridge.
        namespace: Prefix of the bridge's topic names; empty: none.
        ugvs: UGVs of the run and their bounds.
        steering: UGVs that steer.

    Raises:
        Refused: If the message is invalid, with the cause.
    """
    name, interface, hashed = _parts_of(key, domain)
    vehicle = name[-2] if len(name) > 1 else ""
    if name[:-2] != _space(namespace) or vehicle not in ugvs:
        raise Refused("no such UGV", f"{'/'.join(name[:-1])}; available: {', '.join(ugvs)}")
    message = decode_checked(interface, hashed, payload, *TWISTS)
    steers, limits = vehicle in steering, ugvs[vehicle]
    return VelocityCommand(vehicle, _drive_of(message, vehicle, limits, steers=steers))


def service_of(
    key: str, *, domain: int, namespace: str, uavs: Collection[str] = ()
) -> tuple[str, str]:
    """Return the UAV and the name of the called service; the UAV is empty for a service of the run.

    Args:
        key: Key of the call.
        domain: ROS 2 domain id of the bridge.
        namespace: Prefix of the bridge's service names; empty: none.
        uavs: UAVs in teams.

    Raises:
        Refused: If the bridge has no such service, or its type or hash differs.
    """
    (*space, service), interface, hashed = _parts_of(key, domain)
    uav = space.pop() if service in REQUESTS and space else ""
    known = uav in uavs if service in REQUESTS else service in RUN_SERVICES
    if space != _space(namespace) or not known:
        offered = [*RUN_SERVICES, *(f"{name}/{one}" for name in sorted(uavs) for one in REQUESTS)]
        raise Refused("no such service", f"{service}; available: {', '.join(offered)}")
    check_type(interface, hashed, _SERVICES[service])
    return uav, service


def _parts_of(key: str, domain: int) -> tuple[list[str], str, str]:
    """Return the parts of the name in a key, its type and its hash."""
    found, *name, interface, hashed = key.split("/")
    if found != str(domain):
        raise Refused("another domain", f"{found}; allowed: {domain}")
    return name, interface, hashed


def _space(namespace: str) -> list[str]:
    return [part for part in namespace.split("/") if part]


def _drive_of(message: RosMessage, vehicle: str, limits: Limits, *, steers: bool) -> Teleoperation:
    """Return the operator's input in a twist.

    Raises:
        Refused: If the UGV cannot execute it, with the cause. A turn rate beyond its limit is none: it turns as fast
            as it can.
    """
    stamped = hasattr(message, "header")
    twist = message.twist if stamped else message
    frames = (base_link(vehicle),) if steers else (MAP, base_link(vehicle))
    if stamped and message.header.frame_id not in ("", *frames):
        raise Refused("another frame", f"{message.header.frame_id}; allowed: {', '.join(frames)}")
    moves, turns = twist.linear, twist.angular
    values = (moves.x, moves.y, moves.z, turns.x, turns.y, turns.z)
    if not all(map(math.isfinite, values)):
        raise Refused("not finite", f"{values}")
    if steers and any(values[1:5]):
        raise Refused(
            "not along the heading",
            f"{values}; allowed: linear.x (forward) and angular.z (to the left), all others 0",
        )
    if not steers and any(values[2:]):
        raise Refused("climbs or turns", f"{values}; allowed: x (east) and y (north), all others 0")
    speed, most = math.hypot(moves.x, moves.y), limits.max_speed
    if most is not None and speed > most * (1.0 + _SPEED_TOLERANCE):
        raise Refused(
            "beyond the limits", f"{above(speed, most)} m/s; allowed: up to {exact(most)}"
        )
    wanted: dict[str, object] = {"velocity": (float(moves.x), float(moves.y))}
    if steers:
        wanted = {"speed": float(moves.x), "turn_rate": float(turns.z)}
    try:
        return msgspec.convert({"operator": _DRIVER} | wanted, Teleoperation)
    except msgspec.ValidationError as error:
        raise Refused("beyond the limits", str(error)) from error


def _control_of(uav: str, service: str, *, resumes: bool) -> Control:
    """Return the control that a service sends; `uav`: its UAV, empty for a service of the run."""
    if service in REQUESTS:
        return Control(action=Action.REQUEST, vehicle=uav, request=REQUESTS[service])
    return Control(action=Action.RESUME if resumes else Action(service))


class RosCommands:
    """Receiver of velocity commands and service calls from ROS 2 nodes.

    Args:
        node: Node of the bridge.
        client: Client that sends the commands to the run.
        namespace: Prefix of all topic names; empty: none.
        refusals: Counter of rejected messages.
    """

    def __init__(
        self, node: RosNode, client: RunClient, *, namespace: str, refusals: Refusals
    ) -> None:
        self._node, self._client, self._namespace = node, client, namespace
        self._refusals = refusals
        self._helm = Helm(client.control, client.drive)
        # Node that controls each UGV, and the time of its last message [s].
        self._controllers: dict[str, tuple[bytes, float]] = {}
        self._lock = threading.Lock()
        self._status: Status | None = None
        self._shown: set[str] = set()
        self.accepted = 0
        """Number of forwarded commands and calls."""
        # For every domain, vehicle and type: messages to others are counted without decoding.
        for expression in VELOCITIES.keys:
            node.receive(expression, self._receive)
        for expression in CALLS.keys:
            node.serve(expression, self._serve)
        for service in RUN_SERVICES:
            node.show_service(wire_topic(_SERVICES[service], f"/{service}", namespace))

    def follow(self, status: Status | None) -> None:
        """Update the drivers from a status, and announce the topics of new UGVs and the services of new UAVs."""
        self._status = status
        for uav in self._uavs() - self._shown:
            self._shown.add(uav)
            for service in REQUESTS:
                name = f"/{uav}/{service}"
                self._node.show_service(wire_topic(_SERVICES[service], name, self._namespace))
        for vehicle in self._ugvs():
            if vehicle not in self._shown:
                self._shown.add(vehicle)
                for interface in TWISTS:
                    topic = wire_topic(interface, f"/{vehicle}/{CMD_VEL}", self._namespace)
                    self._node.show_subscription(topic, NEWEST)

    def _ugvs(self) -> dict[str, Limits]:
        if self._status is None or self._status.geometry is None:
            return {}
        geometry = self._status.geometry
        return {name: own for name, own in geometry.limits.items() if name not in geometry.uavs}

    def _steering(self) -> Collection[str]:
        """Return the UGVs that steer."""
        geometry = None if self._status is None else self._status.geometry
        return () if geometry is None else geometry.max_turn_rates

    def _uavs(self) -> set[str]:
        """Return the UAVs in teams."""
        team = None if self._status is None else self._status.team
        return set() if team is None else set(team.numbers)

    def _receive(self, key: str, payload: bytes, sender: bytes) -> None:
        with self._lock:
            try:
                command = velocity_command(
                    key,
                    payload,
                    domain=self._node.domain,
                    namespace=self._namespace,
                    ugvs=self._ugvs(),
                    steering=self._steering(),
                )
                self._forward(command, sender)
            except Refused as refused:
                self._refusals.add(refused)

    def _forward(self, command: VelocityCommand, sender: bytes) -> None:
        node, received = self._controllers.get(command.vehicle, (b"", -math.inf))
        now = time.monotonic()
        takes_control = now - received > _CONTROL_TIMEOUT
        if not takes_control and sender != node:
            raise Refused("another node has control", command.vehicle)
        self._controllers[command.vehicle] = sender, now
        driver = self._status.drivers.get(command.vehicle, "") if self._status is not None else ""
        if takes_control and (
            driver != TELEOP or self._helm.displaced(self._status, command.vehicle)
        ):
            self._helm.take(command.vehicle, driver)
        if not self._helm.steer(command.vehicle, command.drive):
            raise Refused("send queue full", command.vehicle)
        self.accepted += 1

    def _serve(self, key: str, raw: bytes) -> bytes | None:
        """Return the response to a call; None if the service is unknown or the hash of its type is missing."""
        try:
            uav, service = service_of(
                key, domain=self._node.domain, namespace=self._namespace, uavs=self._uavs()
            )
        except Refused as refused:
            with self._lock:
                self._refusals.add(refused)
            return None
        interface = _SERVICES[service]
        answer = response_of(interface)
        try:
            request = decode(request_of(interface), raw)
        except Refused as refused:
            with self._lock:
                self._refusals.add(refused)
            return encode(answer, make(answer, success=False, message=refused.what[:300]))
        control = _control_of(uav, service, resumes=service == "pause" and not request.data)
        sent = self._client.control(control)
        with self._lock:
            self.accepted += sent
        text = f"{control.in_words()} at the next tick" if sent else "send queue full"
        return encode(answer, make(answer, success=sent, message=text))

    def hand_back(self) -> None:
        """Return control of all UGVs to their previous drivers."""
        if self._status is not None and not self._status.over:
            for vehicle in self._helm.waiting(self._status):
                self._helm.hand_back(vehicle)
