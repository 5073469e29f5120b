"""ROS 2 node on a session of the bus: publishers, subscriptions and services, with their tokens in the ROS graph.

Only this module and the session of the bus use Zenoh.
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
from outrider_ros2.interfaces import gid_of
from outrider_ros2.wire import RELIABLE, Attachment, Endpoint, Node, Qos, WireTopic

_LOG = logging.getLogger("outrider.ros2")
log_refused = partial(_LOG.warning, "rejected %s (%d so far)")
_REMOTE = zenoh.Locality.REMOTE

Receive = Callable[[str, bytes, bytes], None]
"""Callback for a message: key, payload and identity of the sender. It runs in a Zenoh thread: return quickly."""
Serve = Callable[[str, bytes], bytes | None]
"""Callback for a request on a key, as CDR; returns the response as CDR, or None. It runs in a Zenoh thread."""


class RosPublisher:
    """Publisher of one topic."""

    def __init__(self, session: zenoh.Session, key: str, qos: Qos, token: str) -> None:
        self.wanted = False
        """True if the topic has a subscriber."""
        self.matches = 0
        """Number of times that the topic gained its first subscriber."""
        self.sent = 0
        """Number of messages sent."""
        self._gid = gid_of(token)
        reliability = zenoh.Reliability.RELIABLE if qos.reliable else zenoh.Reliability.BEST_EFFORT
        plain = session.declare_publisher(
            key,
            reliability=reliability,
            congestion_control=zenoh.CongestionControl.DROP,
            allowed_destination=_REMOTE,
        )
        self._listener = plain.declare_matching_listener(
            self._update_matching
        )  # undeclared with its publisher
        self._declared: list[Any] = [plain]
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
            self._declared.insert(0, late)
            self._put = late.put
        self._declared.insert(0, session.liveliness().declare_token(token))

    def _update_matching(self, status: Any) -> None:  # noqa: ANN401 - MatchingStatus, but a bool in Zenoh's stub
        wanted = bool(status.matching)
        self.matches += wanted and not self.wanted
        self.wanted = wanted

    def send(self, payload: bytes) -> None:
        """Send a message.

        Raises:
            BusError: If the session is closed.
        """
        attachment = Attachment(sequence=self.sent + 1, time=time.time_ns(), gid=self._gid)
        try:
            self._put(payload, attachment=attachment.encoded())
        except zenoh.ZError as error:
            raise BusError(f"cannot send to ROS 2: {error}") from error
        self.sent += 1

    def close(self) -> None:
        """Remove the publisher or node from the ROS graph."""
        for one in self._declared:
            one.undeclare()


class RosNode:
    """ROS 2 node.

    Args:
        session: Session of the bus.
        domain: ROS 2 domain id.
        name: Name of the node.
        namespace: Namespace of the node, such as `/fleet`; empty: none.
    """

    def __init__(self, session: Session, *, domain: int, name: str, namespace: str = "") -> None:
        self._zenoh = session.below
        self.domain = domain
        self._identity = Node(domain=domain, zid=session.id, name=name, namespace=namespace or "/")
        self._numbers = itertools.count(1)
        self._declared: list[Any] = []
        self._show(self._identity.token())

    def _show(self, token: str) -> None:
        self._declared.append(self._zenoh.liveliness().declare_token(token))

    def _token(self, kind: Endpoint, topic: WireTopic, qos: Qos) -> str:
        return self._identity.endpoint_token(kind, next(self._numbers), topic, qos)

    def publisher(self, topic: WireTopic, qos: Qos) -> RosPublisher:
        """Return a publisher of a topic."""
        token = self._token(Endpoint.PUBLISHER, topic, qos)
        return RosPublisher(self._zenoh, topic.key(self.domain), qos, token)

    def show_subscription(self, topic: WireTopic, qos: Qos) -> None:
        """Announce a subscription in the ROS graph."""
        self._show(self._token(Endpoint.SUBSCRIPTION, topic, qos))

    def receive(self, expression: str, receive: Receive) -> None:
        """Subscribe to all keys that match an expression."""

        def handle(sample: zenoh.Sample) -> None:
            raw = None if sample.attachment is None else sample.attachment.to_bytes()
            attachment = None if raw is None else Attachment.decoded(raw)
            gid = attachment.gid if attachment else b""
            receive(str(sample.key_expr), sample.payload.to_bytes(), gid)

        self._declared.append(
            self._zenoh.declare_subscriber(expression, handle, allowed_origin=_REMOTE)
        )

    def serve(self, expression: str, serve: Serve) -> None:
        """Answer calls on all keys that match an expression."""

        def answer(query: zenoh.Query) -> None:
            with query:
                key = str(query.key_expr)
                attachment = None if query.attachment is None else query.attachment.to_bytes()
                payload = b"" if query.payload is None else query.payload.to_bytes()
                try:
                    reply = serve(key, payload)
                    if reply is not None:
                        query.reply(key, reply, attachment=attachment)
                except (BusError, zenoh.ZError) as error:
                    _LOG.warning("rejected a call of %s: %s", key, error)

        self._declared.append(self._zenoh.declare_queryable(expression, answer, complete=True))

    def show_service(self, topic: WireTopic) -> None:
        """Announce a service in the ROS graph."""
        self._show(self._token(Endpoint.SERVICE, topic, RELIABLE))

    def close(self) -> None:
        """Remove the publisher or node from the ROS graph."""
        for one in reversed(self._declared):
            one.undeclare()
        self._declared.clear()
