"""Pilot of a vehicle controlled by a ROS 2 node: publishes its observations and receives its commands.

The process joins as the vehicle, with the vehicle's credentials, and receives only the vehicle's information.
"""

import math
import threading
import time
from collections.abc import Callable

import msgspec

from bus.errors import PeerLost
from bus.keys import Party, Role
from bus.messages.base import Message
from bus.messages.buildings import Building
from bus.messages.vehicle import (
    Briefing,
    Command,
    Observation,
    UavCommand,
    UavObservation,
    UgvCommand,
    UgvObservation,
)
from outrider.running.refused import Refusals, Refused
from outrider_ros2.conversion import MAP, base_link, detection, odometry, stamp
from outrider_ros2.headings import TurnRate, in_map
from outrider_ros2.interfaces import RosMessage, decode_checked, encode, make
from outrider_ros2.pictures import buildings
from outrider_ros2.roles import NO_HASH
from outrider_ros2.ros_node import RosNode, RosPublisher, log_refused
from outrider_ros2.topics import (
    BRIEFING,
    OBSERVATION,
    OWN_BUILDINGS,
    OWN_DETECTION,
    OWN_ODOMETRY,
    PILOT_COMMANDS,
    PILOT_TOPICS,
    TopicRow,
    wire_topic,
)

_POLL = 0.01
"""Interval of the checks for a timeout while the pilot waits for an answer [s]."""
_TEXT, _ACCEL = PILOT_COMMANDS
_COMMAND = {Role.UAV: UavCommand, Role.UGV: UgvCommand}


class RosPilot:
    """Pilot of a vehicle that publishes observations and returns the answers of a ROS 2 node.

    Args:
        node: Node on a session with the vehicle's credentials.
        party: Party of the vehicle.
        patience: Longest time without a connected node while an answer is awaited [s].
    """

    def __init__(self, node: RosNode, party: Party, *, patience: float = 1.0) -> None:
        self._node, self._party, self._patience = node, party, patience
        self._decoder: msgspec.json.Decoder[Command] = msgspec.json.Decoder(_COMMAND[party.role])
        self._news = threading.Condition()
        self._awaited: Observation | None = None
        self._answer: Command | None = None
        self._waits: Callable[[], bool] | None = None
        self._buildings: tuple[Building, ...] = ()
        self._turning = TurnRate()
        self.refusals = Refusals(log_refused)
        self.answered = 0
        """Number of forwarded commands."""
        self._publishers: dict[str, RosPublisher] = {}
        for row in PILOT_TOPICS:
            if row is not OWN_DETECTION or party.role is Role.UAV:
                topic = wire_topic(row.interface, f"/{party.name}/{row.name}")
                self._publishers[row.name] = node.publisher(topic, row.qos)
        for row in PILOT_COMMANDS:
            topic = wire_topic(row.interface, f"/{party.name}/{row.name}")
            node.show_subscription(topic, row.qos)
            for hashed in ("RIHS01_$*", NO_HASH):
                node.receive(f"*/{party.name}/{row.name}/*/{hashed}", self._receive)

    @property
    def connected(self) -> bool:
        """True if a node subscribes to the observation or the odometry."""
        return any(self._publishers[row.name].wanted for row in (OBSERVATION, OWN_ODOMETRY))

    def _send(self, row: TopicRow, message: object) -> None:
        publisher = self._publishers[row.name]
        if publisher.wanted or row in (BRIEFING, OWN_BUILDINGS):  # for late subscribers
            publisher.send(encode(row.interface, message))

    def make(self, briefing: Briefing) -> "RosPilot":
        """Join the run, and publish the briefing."""
        self._waits, self._turning = None, TurnRate()
        self._send(BRIEFING, _text(briefing))
        self._buildings = ()
        self._add_buildings(briefing.buildings)
        return self

    def _add_buildings(self, known: tuple[Building, ...]) -> None:
        """Publish all known buildings if some of these are new."""
        new = tuple(one for one in known if one not in self._buildings)
        if new:
            self._buildings += new
            self._send(OWN_BUILDINGS, buildings(self._buildings))

    def attend(self, waits: Callable[[], bool]) -> None:
        """Wait for the node's answers from now on; earlier observations are in the past.

        Args:
            waits: Returns True while the simulator waits for the answer to the newest observation.
        """
        self._waits = waits

    def act(self, observation: Observation) -> Command | None:
        """Return the node's command; None if it did not answer in time."""
        self.perceive(observation)
        return None if self._waits is None else self.answer(self._waits)

    def perceive(self, observation: Observation) -> None:
        """Publish an observation; the complete JSON form follows all other topics."""
        with self._news:
            self._awaited, self._answer = observation, None
        name = self._party.name
        height, climb = 0.0, 0.0
        if isinstance(observation, UavObservation):
            self._add_buildings(observation.buildings)
            height, climb = observation.altitude or 0.0, observation.climb_rate
            for one in observation.detections:
                self._send(
                    OWN_DETECTION,
                    detection(one.time, name, one.relative_position, observation.altitude),
                )
        position, velocity = (*observation.position, height), (*observation.velocity, climb)
        heading = _heading_of(observation)
        turn_rate = self._turning.update(observation.time, heading)
        own = odometry(observation.time, name, position, velocity, heading, turn_rate)
        self._send(OWN_ODOMETRY, own)
        self._send(OBSERVATION, _text(observation))

    def answer(self, waits: Callable[[], bool]) -> Command | None:
        """Return the node's answer to the last observation; None if it comes too late.

        Args:
            waits: Returns True while the simulator waits for the answer.

        Raises:
            PeerLost: If the node disconnected; the process must then leave the run, so that the vehicle brakes.
        """
        matches = sum(one.matches for one in self._publishers.values())
        last_connected = time.monotonic()
        while True:
            with self._news:
                if self._answer is None:
                    self._news.wait(_POLL)
                answer, awaited = self._answer, self._awaited
            if answer is not None:
                self.answered += 1
                return answer
            if not waits():
                return None
            if self.connected:
                last_connected = time.monotonic()
            elif time.monotonic() - last_connected > self._patience:
                raise PeerLost(f"the ROS 2 node of {self._party.name} disconnected")
            now = sum(one.matches for one in self._publishers.values())
            if now != matches and awaited is not None:  # a node connected meanwhile
                matches = now
                self.perceive(awaited)

    def _receive(self, key: str, payload: bytes, _sender: bytes) -> None:
        try:
            command = self._command_of(key, payload)
        except Refused as refused:
            self.refusals.add(refused)
            return
        with self._news:
            if self._answer is None:
                self._answer = command
                self._news.notify()
                return
        self.refusals.add(Refused("answers a tick twice", f"{command.tick}"))

    def _command_of(self, key: str, payload: bytes) -> Command:
        domain, _vehicle, *topic, interface, hashed = key.split("/")
        if domain != str(self._node.domain):
            raise Refused("another domain", f"{domain}; allowed: {self._node.domain}")
        row = _TEXT if "/".join(topic) == _TEXT.name else _ACCEL
        message = decode_checked(interface, hashed, payload, row.interface)
        awaited = self._awaited
        command = self._read(message.data) if row is _TEXT else self._accelerate(message, awaited)
        if awaited is None or command.tick != awaited.tick:
            raise Refused(
                "answers another tick",
                f"{command.tick}; allowed: {None if awaited is None else awaited.tick}",
            )
        return command

    def _read(self, text: str) -> Command:
        try:
            return self._decoder.decode(text)
        except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
            raise Refused("invalid command", str(error)) from error

    def _accelerate(self, message: RosMessage, awaited: Observation | None) -> Command:
        frame, value = message.header.frame_id, message.accel.linear
        allowed = ("", MAP, base_link(self._party.name))
        if frame not in allowed:
            raise Refused("another frame", f"{frame}; allowed: {', '.join(allowed[1:])}")
        if not all(map(math.isfinite, (value.x, value.y, value.z))):
            raise Refused("not finite", f"{value.x}, {value.y}, {value.z}")
        then = message.header.stamp
        if awaited is None or then != stamp(awaited.time):
            raise Refused(
                "answers another tick",
                f"stamp {then.sec}.{then.nanosec:09d}; allowed: the stamp of the observation",
            )
        wanted = float(value.x), float(value.y)
        if frame == base_link(self._party.name):
            wanted = in_map(wanted, _heading_of(awaited))
        plain: dict[str, object] = {"tick": awaited.tick, "acceleration": wanted}
        if isinstance(awaited, UavObservation) and awaited.altitude is not None:
            plain["vertical_acceleration"] = float(value.z)
        try:
            command: Command = msgspec.convert(plain, _COMMAND[self._party.role])
            return command
        except msgspec.ValidationError as error:
            raise Refused("invalid command", str(error)) from error

    def close(self) -> None:
        """Remove the publishers from the ROS graph."""
        for publisher in self._publishers.values():
            publisher.close()


def _heading_of(observation: Observation) -> float | None:
    """Return the heading of a UGV that steers [rad]; None: the vehicle is a point."""
    return observation.heading if isinstance(observation, UgvObservation) else None


def _text(message: Message) -> RosMessage:
    return make("std_msgs/msg/String", data=msgspec.json.encode(message).decode())
