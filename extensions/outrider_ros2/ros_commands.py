"""The bridge as an operator: velocities and calls of services from ROS 2, checked, and passed on or counted by cause.

A UGV has no heading: `linear.x` is its velocity east and `linear.y` north, in `map` as in its base_link.
"""

import math
import threading
import time
from collections.abc import Mapping
from typing import NamedTuple

from bus.messages.base import Vector
from bus.messages.control import Action, Control
from bus.messages.scenario import Limits
from bus.messages.telemetry import Status
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
from outrider_ros2.roles import CALLS, CMD_VEL, SERVICES, VELOCITIES
from outrider_ros2.ros_node import RosNode
from outrider_ros2.topics import wire_topic
from outrider_ros2.wire import NEWEST

TWISTS = ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist")
_SERVICES = {
    service: "std_srvs/srv/SetBool" if service == "pause" else "std_srvs/srv/Trigger"
    for service in SERVICES
}
"""Types of the services."""
_RELEASE = 1.0
"""Silence after which a wheel is free for another node, and is taken anew [s]."""
_SLACK = 1e-9
"""Of a speed, as a share: what rounding alone may add."""
_DRIVER = "ROS 2"


class Wish(NamedTuple):
    """A velocity that a node wants a UGV to drive."""

    vehicle: str
    velocity: Vector
    """[m/s]"""


def wish_of(
    key: str, payload: bytes, *, domain: int, namespace: str, ugvs: Mapping[str, Limits]
) -> Wish:
    """The velocity that a message on a `cmd_vel` asks for.

    Args:
        key: Of the message.
        payload: As it came.
        domain: ROS 2's domain id here.
        namespace: Before the names of our topics; empty: none.
        ugvs: The run's UGVs and their bounds.

    Raises:
        Refused: If it is not passed on, whatever the reason.
    """
    name, interface, hashed = _parts_of(key, domain)
    vehicle = name[-2] if len(name) > 1 else ""
    if name[:-2] != _space(namespace) or vehicle not in ugvs:
        raise Refused("no such UGV", f"{'/'.join(name[:-1])}; there are {', '.join(ugvs)}")
    told = decode_checked(interface, hashed, payload, *TWISTS)
    return Wish(vehicle, _velocity(told, vehicle, ugvs[vehicle]))


def service_of(key: str, *, domain: int, namespace: str) -> str:
    """Return the name of the service that a call on a key asks for.

    Args:
        key: Of the call.
        domain: ROS 2's domain id here.
        namespace: Before the names of our services; empty: none.

    Raises:
        Refused: If it is not for a service here, or has another type or hash.
    """
    (*space, service), interface, hashed = _parts_of(key, domain)
    if space != _space(namespace) or service not in _SERVICES:
        raise Refused("no such service", f"{service}; there are {', '.join(_SERVICES)}")
    check_type(interface, hashed, _SERVICES[service])
    return service


def _parts_of(key: str, domain: int) -> tuple[list[str], str, str]:
    """Return the parts of the name in a key, its type and its hash."""
    there, *name, interface, hashed = key.split("/")
    if there != str(domain):
        raise Refused("another domain", f"{there}; this is {domain}")
    return name, interface, hashed


def _space(namespace: str) -> list[str]:
    return [part for part in namespace.split("/") if part]


def _velocity(told: RosMessage, vehicle: str, limits: Limits) -> Vector:
    stamped = hasattr(told, "header")
    twist = told.twist if stamped else told
    if stamped and told.header.frame_id not in ("", MAP, base_link(vehicle)):
        raise Refused(
            "another frame", f"{told.header.frame_id}; allowed are {MAP} and {base_link(vehicle)}"
        )
    moves, turns = twist.linear, twist.angular
    values = (moves.x, moves.y, moves.z, turns.x, turns.y, turns.z)
    if not all(map(math.isfinite, values)):
        raise Refused("no finite number", f"{values}")
    if any(values[2:]):
        raise Refused(
            "climbs or turns", f"{values}; a UGV has no heading: x is east, y north, the rest 0"
        )
    speed, most = math.hypot(moves.x, moves.y), limits.max_speed
    if most is not None and speed > most * (1.0 + _SLACK):
        raise Refused("beyond the limits", f"{speed:.6g} m/s; allowed up to {most:.6g}")
    return float(moves.x), float(moves.y)


class RosCommands:
    """Takes velocities and calls from ROS 2's nodes.

    Args:
        node: The bridge's.
        client: Says what is wanted.
        namespace: Before the names of all topics; empty: none.
        refusals: Where what is refused is counted.
    """

    def __init__(
        self, node: RosNode, client: RunClient, *, namespace: str, refusals: Refusals
    ) -> None:
        self._node, self._client, self._namespace = node, client, namespace
        self._refusals = refusals
        self._helm = Helm(client.control, client.drive)
        # For each UGV the node that drives it, and when that was received last [s].
        self._wheels: dict[str, tuple[bytes, float]] = {}
        self._lock = threading.Lock()
        self._status: Status | None = None
        self._shown: set[str] = set()
        self.taken = 0
        """Commands and calls that were passed on."""
        # Of every domain, vehicle and type: what is not for us is counted and not decoded.
        for expression in VELOCITIES.keys:
            node.receive(expression, self._receive)
        for expression in CALLS.keys:
            node.serve(expression, self._serve)
        for service, interface in _SERVICES.items():
            node.show_service(wire_topic(interface, f"/{service}", namespace))

    def follow(self, status: Status | None) -> None:
        """Take in what the simulator tells: whose wheels there are."""
        self._status = status
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

    def _receive(self, key: str, payload: bytes, sender: bytes) -> None:
        with self._lock:
            try:
                wish = wish_of(
                    key,
                    payload,
                    domain=self._node.domain,
                    namespace=self._namespace,
                    ugvs=self._ugvs(),
                )
                self._pass_on(wish, sender)
            except Refused as refused:
                self._refusals.add(refused)

    def _pass_on(self, wish: Wish, sender: bytes) -> None:
        node, received = self._wheels.get(wish.vehicle, (b"", -math.inf))
        now = time.monotonic()
        begins = now - received > _RELEASE
        if not begins and sender != node:
            raise Refused("another node is at the wheel", wish.vehicle)
        self._wheels[wish.vehicle] = sender, now
        driver = self._status.drivers.get(wish.vehicle, "") if self._status is not None else ""
        if begins and (driver != TELEOP or self._helm.displaced(self._status, wish.vehicle)):
            self._helm.take(wish.vehicle, driver)
        if not self._helm.steer(wish.vehicle, _DRIVER, wish.velocity):
            raise Refused("the bus takes no more", wish.vehicle)
        self.taken += 1

    def _serve(self, key: str, raw: bytes) -> bytes | None:
        """Answer a call; None: it is not for a service here, or without the hash of its type."""
        try:
            service = service_of(key, domain=self._node.domain, namespace=self._namespace)
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
        resumes = service == "pause" and not request.data
        action = Action.RESUME if resumes else Action(service)
        said = self._client.control(Control(action=action))
        with self._lock:
            self.taken += said
        told = f"{action.value} at the next tick" if said else "the bus takes no more messages"
        return encode(answer, make(answer, success=said, message=told))

    def hand_back(self) -> None:
        """Let the drivers from before drive on."""
        if self._status is not None and not self._status.over:
            for vehicle in self._helm.waiting(self._status):
                self._helm.hand_back(vehicle)
