"""Publication of an observer's telemetry to ROS 2, requested only for topics with subscribers."""

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

_QUEUE_SIZE = 4096
"""Length of the queue of truths if every tick is published; beyond it, the oldest are lost."""
_MAX_BATCH = 256
"""Maximum number of messages between two checks for new subscribers and for a stop signal."""


@dataclass(slots=True)
class _Topic:
    """Published topic."""

    row: TopicRow
    publisher: RosPublisher
    due: float = 0.0
    """Earliest time of the next message, on the monotonic clock [s]."""
    matches: int = 0
    """`RosPublisher.matches` when a message was published last."""


class RosObserver:
    """Publisher of a run's telemetry to ROS 2.

    Args:
        session: Session of the bridge, or of an operator.
        node: Node of the bridge.
        namespace: Prefix of all topic names, such as `/fleet`; empty: none.
        every_tick: True to publish the truth of every tick instead of about 40 per second.
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
        """Number of missing ticks, if every tick was requested."""
        self._view: RunView | None = None
        self.status: Status | None = None
        self.commands: RosCommands | None = None
        """Receiver of an operator's commands; None for an observer."""
        self.refusals = Refusals(log_refused)

    @property
    def topics(self) -> dict[str, int]:
        """Number of messages sent, by topic."""
        now = {
            f"{self._namespace}{name}": topic.publisher.sent for name, topic in self._topics.items()
        }
        return {name: self._sent[name] + now.get(name, 0) for name in self._sent | now}

    def step(self, patience: float) -> None:
        """Publish the received messages; wait up to `patience` [s] for the first one."""
        self._update_subscriptions()
        first = self._inboxes.get(Truth, self._statuses)
        received, count = first.receive(patience), 0
        while received is not None:
            self._process(received.message)
            count += 1  # bounded: in a fast run the queue is never empty
            received = first.next_waiting() if count < _MAX_BATCH else None
        for inbox in (self._statuses, *self._inboxes.values()):
            if inbox is not first and (received := inbox.next_waiting()) is not None:
                self._process(received.message)

    def _update_subscriptions(self) -> None:
        """Subscribe to the telemetry of topics with subscribers, and unsubscribe from the rest."""
        read = {topic.row.source for topic in self._topics.values() if topic.publisher.wanted}
        for kind, key in self._keys.items():
            if kind in read and kind not in self._inboxes:
                size = _QUEUE_SIZE if key is TRUTH else 1
                self._inboxes[kind] = self._session.inbox(key, newest=size)
            elif kind not in read and kind in self._inboxes:
                self._session.forget(self._inboxes.pop(kind))
                self._tick = -1 if kind is Truth else self._tick

    def _process(self, message: Message) -> None:
        if isinstance(message, Status):
            self.status = message
            self._set_up_topics(message)
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
        """Return the subscribed topics that are due; for a repeated tick, only those with new subscribers."""
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
            new = publisher.matches != topic.matches
            if new or (not again and now >= topic.due):
                wanted.add(name)
                topic.matches, topic.due = publisher.matches, now + topic.row.period
        return wanted

    def _set_up_topics(self, status: Status) -> None:
        """Create the topics once the vehicles are known, and again when another run starts."""
        if status.geometry is None:
            return
        view = view_of(status.scenario, status.geometry)
        if self._view is not None and self._view.scene == view.scene:
            return
        self.close()  # remove the topics of the previous run
        self._view = view
        for row in TOPICS:
            for _, name in row.names(view.scene):
                topic = wire_topic(row.interface, name, self._namespace)
                self._topics[name] = _Topic(row, self._node.publisher(topic, row.qos))
        for name, payload in messages_of(view, None):
            self._topics[name].publisher.send(payload)

    def _own_diagnostic(self) -> object:
        sent = sum(topic.publisher.sent for topic in self._topics.values())
        rejected = self.refusals.counts
        values = {"messages": sent, "commands": self.commands.accepted if self.commands else 0}
        return diagnostic(
            "ros2 bridge",
            values | {f"rejected: {cause}": count for cause, count in rejected.copy().items()},
            level=WARN if rejected else OK,
            message=f"rejected {self.refusals.newest}" if rejected else "ok",
        )

    def close(self) -> None:
        """Remove the topics from the ROS graph."""
        self._sent = Counter(self.topics)
        for topic in self._topics.values():
            topic.publisher.close()
        self._topics.clear()
