"""One ROS 2 node on a session of the bus: its publishers, subscriptions and services, each with its token in the graph.

Beside the bus' own session the only place that speaks Zenoh.
"""

import itertools
import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import zenoh
import zenoh.ext

from bus.errors import BusError
from bus.session import Session
from outrider_ros2.wire import RELIABLE, Attachment, Endpoint, Node, Qos, WireTopic, gid_of

_LOG = logging.getLogger("outrider.ros2")
log_refused = partial(_LOG.warning, "refused %s (%d so far)")
_REMOTE = zenoh.Locality.REMOTE

Receive = Callable[[str, bytes, bytes], None]
"""Takes a message: its key, its payload and the identity of who sent it; called by a thread of Zenoh's, keep it short.
"""
Serve = Callable[[str, bytes], bytes | None]
"""Answers the request on a key, both as CDR, or not at all: None. Called by a thread of Zenoh's."""


class RosPublisher:
    """Publishes one topic."""

    def __init__(self, session: zenoh.Session, key: str, qos: Qos, token: str) -> None:
        self.wanted = False
        """True if anybody reads it now."""
        self.found = 0
        """Number of times that somebody has begun to read it where nobody had."""
        self.sent = 0
        self._gid = gid_of(token)
        reliability = zenoh.Reliability.RELIABLE if qos.reliable else zenoh.Reliability.BEST_EFFORT
        plain = session.declare_publisher(
            key,
            reliability=reliability,
            congestion_control=zenoh.CongestionControl.DROP,
            allowed_destination=_REMOTE,
        )
        self._listener = plain.declare_matching_listener(self._see)  # goes with its publisher
        self._kept: list[Any] = [plain]
        self._put: Callable[..., Any] = plain.put
        if qos.transient_local:
            late = zenoh.ext.declare_advanced_publisher(
                session,
                key,
                reliability=reliability,
                congestion_control=zenoh.CongestionControl.DROP,
                cache=zenoh.ext.CacheConfig(qos.depth),
                sample_miss_detection=zenoh.ext.MissDetectionConfig(
                    heartbeat=None, sporadic_heartbeat=None
                ),
                publisher_detection=True,
            )
            self._kept.insert(0, late)
            self._put = late.put
        self._kept.insert(0, session.liveliness().declare_token(token))

    def _see(self, status: Any) -> None:  # noqa: ANN401 - Zenoh's stub says bool, its library gives a MatchingStatus
        wanted = bool(status.matching)
        self.found += wanted and not self.wanted
        self.wanted = wanted

    def send(self, payload: bytes) -> None:
        """Send a message.

        Raises:
            BusError: If the session is gone.
        """
        beside = Attachment(sequence=self.sent + 1, time=time.time_ns(), gid=self._gid)
        try:
            self._put(payload, attachment=beside.encoded())
        except zenoh.ZError as error:
            raise BusError(f"cannot send to ROS 2: {error}") from error
        self.sent += 1

    def close(self) -> None:
        """Leave the graph."""
        for one in self._kept:
            one.undeclare()


class RosNode:
    """A node of ROS 2.

    Args:
        session: Of the bus.
        domain: ROS 2's domain id.
        name: Of the node.
        namespace: Of the node, such as `/fleet`; empty: none.
    """

    def __init__(self, session: Session, *, domain: int, name: str, namespace: str = "") -> None:
        self._zenoh = session.below
        self.domain = domain
        self._identity = Node(domain=domain, zid=session.id, name=name, namespace=namespace or "/")
        self._numbers = itertools.count(1)
        self._kept: list[Any] = []
        self._show(self._identity.token())

    def _show(self, token: str) -> None:
        self._kept.append(self._zenoh.liveliness().declare_token(token))

    def _token(self, kind: Endpoint, topic: WireTopic, qos: Qos) -> str:
        return self._identity.endpoint_token(kind, next(self._numbers), topic, qos)

    def publisher(self, topic: WireTopic, qos: Qos) -> RosPublisher:
        """A publisher of a topic."""
        token = self._token(Endpoint.PUBLISHER, topic, qos)
        return RosPublisher(self._zenoh, topic.key(self.domain), qos, token)

    def show_subscription(self, topic: WireTopic, qos: Qos) -> None:
        """Show in the graph that a topic is read here."""
        self._show(self._token(Endpoint.SUBSCRIPTION, topic, qos))

    def receive(self, expression: str, receive: Receive) -> None:
        """Read all keys that an expression matches."""

        def take(sample: zenoh.Sample) -> None:
            beside = None if sample.attachment is None else sample.attachment.to_bytes()
            told = None if beside is None else Attachment.decoded(beside)
            receive(str(sample.key_expr), sample.payload.to_bytes(), told.gid if told else b"")

        self._kept.append(self._zenoh.declare_subscriber(expression, take, allowed_origin=_REMOTE))

    def serve(self, expression: str, serve: Serve) -> None:
        """Answer the calls on all keys that an expression matches."""

        def answer(query: zenoh.Query) -> None:
            with query:
                key = str(query.key_expr)
                beside = None if query.attachment is None else query.attachment.to_bytes()
                payload = b"" if query.payload is None else query.payload.to_bytes()
                try:
                    reply = serve(key, payload)
                    if reply is not None:
                        query.reply(key, reply, attachment=beside)
                except (BusError, zenoh.ZError) as error:
                    _LOG.warning("a call of %s is refused: %s", key, error)

        self._kept.append(self._zenoh.declare_queryable(expression, answer, complete=True))

    def show_service(self, topic: WireTopic) -> None:
        """Show in the graph that a service is offered here."""
        self._show(self._token(Endpoint.SERVICE, topic, RELIABLE))

    def close(self) -> None:
        """Leave the graph."""
        for one in reversed(self._kept):
            one.undeclare()
        self._kept.clear()
