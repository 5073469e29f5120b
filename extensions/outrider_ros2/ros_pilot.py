"""A vehicle that a ROS 2 node flies: its observation goes out as topics, the node's answer comes back as its command.

The process joins as that vehicle, with that vehicle's credentials, and knows what that vehicle may know.
"""

import math
import threading
import time
from collections.abc import Callable

import msgspec

from bus.errors import PeerLost
from bus.keys import Party, Role
from bus.messages.base import Message
from bus.messages.vehicle import (
    Briefing,
    Command,
    Observation,
    UavCommand,
    UavObservation,
    UgvCommand,
)
from outrider.running.refused import Refusals, Refused
from outrider_ros2.conversion import MAP, base_link, detection, odometry, stamp
from outrider_ros2.interfaces import RosMessage, decode_checked, encode, make
from outrider_ros2.roles import NO_HASH
from outrider_ros2.ros_node import RosNode, RosPublisher, log_refused
from outrider_ros2.topics import (
    BRIEFING,
    OBSERVATION,
    OWN_DETECTION,
    OWN_ODOMETRY,
    PILOT_COMMANDS,
    PILOT_TOPICS,
    TopicRow,
    wire_topic,
)

_LOOK = 0.01
"""While it waits for an answer, it looks this often whether it need not wait any longer [s]."""
_TEXT, _ACCEL = PILOT_COMMANDS
_COMMAND = {Role.UAV: UavCommand, Role.UGV: UgvCommand}


class RosPilot:
    """A vehicle's pilot that passes on what a ROS 2 node answers: what it is told goes out, the answer comes in.

    Args:
        node: On a session with the vehicle's credentials.
        party: The vehicle.
        patience: The time for which no node may be there while an answer is awaited [s].
    """

    def __init__(self, node: RosNode, party: Party, *, patience: float = 1.0) -> None:
        self._node, self._party, self._patience = node, party, patience
        self._decoder: msgspec.json.Decoder[Command] = msgspec.json.Decoder(_COMMAND[party.role])
        self._news = threading.Condition()
        self._awaited: Observation | None = None
        self._answer: Command | None = None
        self._waits: Callable[[], bool] | None = None
        self.refusals = Refusals(log_refused)
        self.answered = 0
        """Commands that were passed on."""
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
    def there(self) -> bool:
        """True if a node reads the observation, in one form or another."""
        return any(self._publishers[row.name].wanted for row in (OBSERVATION, OWN_ODOMETRY))

    def _send(self, row: TopicRow, message: object) -> None:
        publisher = self._publishers[row.name]
        if publisher.wanted or row is BRIEFING:
            publisher.send(encode(row.interface, message))

    def make(self, briefing: Briefing) -> "RosPilot":
        """Join: the node is told what the vehicle was told."""
        self._waits = None
        self._send(BRIEFING, _text(briefing))
        return self

    def attend(self, waits: Callable[[], bool]) -> None:
        """From here on answers are awaited; before, what is acted on is past.

        Args:
            waits: Tells whether the answer to the newest observation is still awaited.
        """
        self._waits = waits

    def act(self, observation: Observation) -> Command | None:
        """The node's command; None: it had none in time."""
        self.perceive(observation)
        return None if self._waits is None else self.answer(self._waits)

    def perceive(self, seen: Observation) -> None:
        """Tell the node what the vehicle sees; the lossless form comes last, when all else is there."""
        with self._news:
            self._awaited, self._answer = seen, None
        name = self._party.name
        if isinstance(seen, UavObservation):
            for look in seen.detections:
                self._send(OWN_DETECTION, detection(look.time, name, look.relative_position))
        self._send(OWN_ODOMETRY, odometry(seen.time, name, seen.position, seen.velocity))
        self._send(OBSERVATION, _text(seen))

    def answer(self, waits: Callable[[], bool]) -> Command | None:
        """The node's answer to what it was told last.

        Args:
            waits: Asked now and then; False: nobody waits for the answer any longer.

        Raises:
            PeerLost: If the node has gone: who has joined for it must leave, so that the vehicle brakes.
        """
        found = sum(one.found for one in self._publishers.values())
        there = time.monotonic()
        while True:
            with self._news:
                if self._answer is None:
                    self._news.wait(_LOOK)
                answer, awaited = self._answer, self._awaited
            if answer is not None:
                self.answered += 1
                return answer
            if not waits():
                return None
            if self.there:
                there = time.monotonic()
            elif time.monotonic() - there > self._patience:
                raise PeerLost(f"the ROS 2 node that flew {self._party.name} has gone")
            now = sum(one.found for one in self._publishers.values())
            if now != found and awaited is not None:  # a node that has come meanwhile
                found = now
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
            raise Refused("another domain", f"{domain}; this is {self._node.domain}")
        row = _TEXT if "/".join(topic) == _TEXT.name else _ACCEL
        told = decode_checked(interface, hashed, payload, row.interface)
        awaited = self._awaited
        command = self._read(told.data) if row is _TEXT else self._accelerate(told, awaited)
        if awaited is None or command.tick != awaited.tick:
            raise Refused(
                "answers another tick",
                f"{command.tick}; awaited is {None if awaited is None else awaited.tick}",
            )
        return command

    def _read(self, text: str) -> Command:
        try:
            return self._decoder.decode(text)
        except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
            raise Refused("no command", str(error)) from error

    def _accelerate(self, told: RosMessage, awaited: Observation | None) -> Command:
        frame, value = told.header.frame_id, told.accel.linear
        allowed = ("", MAP, base_link(self._party.name))
        if frame not in allowed:
            raise Refused("another frame", f"{frame}; allowed are {' and '.join(allowed[1:])}")
        if not (math.isfinite(value.x) and math.isfinite(value.y)):
            raise Refused("no finite number", f"{value.x}, {value.y}")
        then = told.header.stamp
        if awaited is None or then != stamp(awaited.time):
            raise Refused(
                "answers another tick",
                f"its stamp is {then.sec}.{then.nanosec:09d}, not the observation's",
            )
        plain = {"tick": awaited.tick, "acceleration": (float(value.x), float(value.y))}
        try:
            command: Command = msgspec.convert(plain, _COMMAND[self._party.role])
            return command
        except msgspec.ValidationError as error:
            raise Refused("no command", str(error)) from error

    def close(self) -> None:
        """Leave the graph."""
        for publisher in self._publishers.values():
            publisher.close()


def _text(message: Message) -> RosMessage:
    return make("std_msgs/msg/String", data=msgspec.json.encode(message).decode())
