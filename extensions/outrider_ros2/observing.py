"""The bridge as an observer: it publishes what the simulator tells observers, and asks only for what somebody reads."""

import time
from collections import Counter
from dataclasses import dataclass

from bus.keys import COVERAGE, GROUND, SAMPLED_TRUTH, STATUS, TRUTH, Key
from bus.messages.base import Message
from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.queues import Inbox
from bus.session import Session
from outrider.running.refused import Refusals
from outrider_ros2.diagnostics import OK, WARN, diagnostic
from outrider_ros2.ros_commands import RosCommands
from outrider_ros2.ros_node import RosNode, RosPublisher, log_refused
from outrider_ros2.run_view import RunView, view_of
from outrider_ros2.topics import TOPICS, TopicRow, messages_of, wire_topic

_ROOM = 4096
"""Truths that wait where every tick is wanted, before the oldest are lost."""
_AT_ONCE = 256
"""Messages that are taken before it is looked who reads what, and who wants the end."""


@dataclass(slots=True)
class _Topic:
    """A topic that is published."""

    row: TopicRow
    publisher: RosPublisher
    due: float = 0.0
    """Earliest time of the next message, of our clock [s]."""
    found: int = 0
    """The readers that were told when it was published last, as `RosPublisher.found` counts them."""


class RosObserver:
    """Publishes a run's telemetry to ROS 2.

    Args:
        session: The bridge's, or an operator's.
        node: The bridge's node.
        namespace: Before the names of all topics, such as `/fleet`; empty: none.
        every_tick: Whether the truth of every tick is asked for, instead of some 40 a second.
    """

    def __init__(
        self, session: Session, node: RosNode, *, namespace: str = "", every_tick: bool = False
    ) -> None:
        self._session, self._node, self._namespace = session, node, namespace
        self._keys: dict[type[Message], Key] = {
            Truth: TRUTH if every_tick else SAMPLED_TRUTH,
            CoverageMap: COVERAGE,
            GroundMap: GROUND,
        }
        self._statuses = session.inbox(STATUS)
        self._inboxes: dict[type[Message], Inbox] = {}
        self._topics: dict[str, _Topic] = {}
        self._sent: Counter[str] = Counter()
        self._tick = -1
        self._every_tick = every_tick
        self.missing_ticks = 0
        """Ticks that never came, where every one was asked for."""
        self._view: RunView | None = None
        self.status: Status | None = None
        self.commands: RosCommands | None = None
        """The commands that it takes as an operator; None: it looks on."""
        self.refusals = Refusals(log_refused)

    @property
    def topics(self) -> dict[str, int]:
        """Messages sent, by topic."""
        now = {
            f"{self._namespace}{name}": topic.publisher.sent for name, topic in self._topics.items()
        }
        return {name: self._sent[name] + now.get(name, 0) for name in self._sent | now}

    def step(self, patience: float) -> None:
        """Publish what has come, and wait for up to `patience` [s] where nothing has."""
        self._ask_for_what_is_read()
        first = self._inboxes.get(Truth, self._statuses)
        received, taken = first.receive(patience), 0
        while received is not None:
            self._take(received.message)
            taken += 1  # a fast run never lets it come to an end
            received = first.next_waiting() if taken < _AT_ONCE else None
        for inbox in (self._statuses, *self._inboxes.values()):
            if inbox is not first and (received := inbox.next_waiting()) is not None:
                self._take(received.message)

    def _ask_for_what_is_read(self) -> None:
        """Subscribe to the telemetry whose topics are read, and to no other: nobody makes what nobody reads."""
        read = {topic.row.source for topic in self._topics.values() if topic.publisher.wanted}
        for kind, key in self._keys.items():
            if kind in read and kind not in self._inboxes:
                room = _ROOM if key is TRUTH else 1
                self._inboxes[kind] = self._session.inbox(key, newest=room)
            elif kind not in read and kind in self._inboxes:
                self._session.forget(self._inboxes.pop(kind))
                self._tick = -1 if kind is Truth else self._tick

    def _take(self, message: Message) -> None:
        if isinstance(message, Status):
            self.status = message
            self._look_at(message)
            if self.commands is not None:
                self.commands.follow(message)
        if self._view is None:
            return
        if isinstance(message, Status):
            self._view.own = (self._own_diagnostic(),)
        wanted = self._wanted(message)
        for name, payload in messages_of(self._view, message, wanted=wanted):
            self._topics[name].publisher.send(payload)

    def _wanted(self, message: Message) -> set[str]:
        """Topics that are read, and due; of a tick that is told again those alone that are read since then."""
        again = isinstance(message, Truth) and message.tick == self._tick
        if isinstance(message, Truth):
            if self._every_tick and message.tick > self._tick >= 0:
                self.missing_ticks += message.tick - self._tick - 1
            self._tick = message.tick
        now, wanted = time.monotonic(), set()
        for name, topic in self._topics.items():
            publisher = topic.publisher
            if topic.row.source is not type(message) or not publisher.wanted:
                continue
            new = publisher.found != topic.found
            if new or (not again and now >= topic.due):
                wanted.add(name)
                topic.found, topic.due = publisher.found, now + topic.row.period
        return wanted

    def _look_at(self, status: Status) -> None:
        """Set the topics up once it is known whose there are, and anew where another run has begun."""
        if status.geometry is None:
            return
        view = view_of(status.scenario, status.geometry)
        if self._view is not None and self._view.scene == view.scene:
            return
        self.close()  # what was told of another run
        self._view = view
        for row in TOPICS:
            for _, name in row.names(view.scene):
                topic = wire_topic(row.interface, name, self._namespace)
                self._topics[name] = _Topic(row, self._node.publisher(topic, row.qos))
        for name, payload in messages_of(view, None):
            self._topics[name].publisher.send(payload)

    def _own_diagnostic(self) -> object:
        sent = sum(topic.publisher.sent for topic in self._topics.values())
        refused = self.refusals.counts
        told = {"messages": sent, "commands": self.commands.taken if self.commands else 0}
        return diagnostic(
            "ros2 bridge",
            told | {f"refused: {cause}": count for cause, count in refused.copy().items()},
            level=WARN if refused else OK,
            message=f"refused {self.refusals.newest}" if refused else "ok",
        )

    def close(self) -> None:
        """Leave the graph."""
        self._sent = Counter(self.topics)
        for topic in self._topics.values():
            topic.publisher.close()
        self._topics.clear()
