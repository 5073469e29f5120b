"""Inboxes and outboxes of a session: each has one key, a message type, checks and counters."""

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec
import zenoh

from bus.errors import BusError
from bus.keys import Key
from bus.messages.base import LONGEST_TEXT, Message, fitted

_LOG = logging.getLogger("outrider.bus")
WAKE_PERIOD = 0.1
"""Interval at which a waiting reader wakes to check deadlines and peers [s]."""


class Envelope(NamedTuple):
    """Received message."""

    sender: str
    """Name of the vehicle in its key; empty if the key has none."""
    message: Message
    source: zenoh.SourceInfo | None
    """Sending session, as stated by the sender; None: not stated."""

    @property
    def session(self) -> zenoh.ZenohId | None:
        """Unique identity of the session."""
        return None if self.source is None else self.source.source_id.zid

    @property
    def number(self) -> int | None:
        """Number of the session within its party."""
        return None if self.source is None else self.source.source_sn


class Outbox:
    """Writer of one key."""

    def __init__(self, publisher: zenoh.Publisher, key: Key) -> None:
        self._publisher = publisher
        self._encoder = msgspec.json.Encoder()
        self._decoder = msgspec.json.Decoder(key.message)
        self._topic = key.topic
        self.set_number(0)
        self.wanted = False
        """True if the key has a reader now."""
        self._listener = publisher.declare_matching_listener(self._see)

    def set_number(self, number: int) -> None:
        """Send the number of this session within its party with all further messages.

        It travels in the sequence number of Zenoh's source info, which is free: the transport keeps the order.
        """
        self._source = zenoh.SourceInfo(self._publisher.id, number)

    def _see(self, status: Any) -> None:  # noqa: ANN401 - Zenoh's stub says bool, its library gives a MatchingStatus
        self.wanted = bool(status.matching)

    def send(self, message: Message) -> None:
        """Send a message.

        Raises:
            ValueError: If it breaks its own type's bounds (as NaN and infinity do); nothing was sent.
            BusError: If the session is closed.
        """
        payload = self._encoder.encode(message)
        try:
            # Decode as the reader will: NaN has become null, 1e308 is out of bounds.
            self._decoder.decode(payload)
        except msgspec.ValidationError as error:
            raise ValueError(f"{self._topic}: {error}") from error
        try:
            self._publisher.put(payload, source_info=self._source)
        except zenoh.ZError as error:
            raise BusError(f"cannot send {self._topic}: {error}") from error


class Inbox:
    """Reader of one topic, in order. Messages that do not decode are counted, logged and dropped."""

    def __init__(
        self,
        subscriber: "zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]",
        wake: Callable[[], None],
        known: Mapping[str, tuple[str, Key]],
    ) -> None:
        self._subscriber: zenoh.Subscriber[zenoh.Handler[zenoh.Sample]] | None = subscriber
        self._wake = wake
        self._decoders = {  # sender, decoder and largest payload by key
            zenoh.KeyExpr(expression): (sender, msgspec.json.Decoder(key.message), key.largest)
            for expression, (sender, key) in known.items()
        }
        self._since: float | None = None
        self._poked = False
        self._peeked: Envelope | None = None
        self.refused: dict[str, int] = {sender: 0 for sender, _ in known.values()}
        """Number of messages of each sender that did not decode."""
        self.fault: dict[str, str] = {sender: "" for sender, _ in known.values()}
        """Reason why the last of them did not decode, by sender."""

    def _open_subscriber(self) -> "zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]":
        if self._subscriber is None:
            raise BusError("the inbox is closed")
        return self._subscriber

    def receive(self, timeout: float) -> Envelope | None:
        """Return the next message; None after `timeout` [s] without one, or after a call of `poke`."""
        if self._peeked is not None:
            return self.next_waiting()
        subscriber = self._open_subscriber()
        started = self._since = time.monotonic()
        try:
            while not self._poked:
                envelope = self._open(subscriber.recv())
                if envelope is not None:
                    return envelope
                if time.monotonic() - started >= timeout:
                    break
            self._poked = False
            return None
        except zenoh.ZError as error:
            raise BusError(f"the session is closed: {error}") from error
        finally:
            self._since = None

    def next_waiting(self) -> Envelope | None:
        """Return the next message if one has arrived; else None, without waiting."""
        if self._peeked is not None:
            peeked, self._peeked = self._peeked, None
            return peeked
        subscriber = self._open_subscriber()
        try:
            while (sample := subscriber.try_recv()) is not None:
                envelope = self._open(sample)
                if envelope is not None:
                    return envelope
        except zenoh.ZError as error:
            raise BusError(f"the session is closed: {error}") from error
        return None

    def holds_any(self) -> bool:
        """True if a message has arrived; it stays in the inbox."""
        self._peeked = self.next_waiting()
        return self._peeked is not None

    def close(self) -> None:
        """Stop reading; drop messages that arrive until the subscriber is closed.

        A full inbox would block closing.
        """
        subscriber, self._subscriber = self._subscriber, None
        if subscriber is None:
            return
        handler = subscriber.handler
        leaving = threading.Thread(target=subscriber.undeclare)
        leaving.start()
        while leaving.is_alive():
            try:
                while handler.try_recv() is not None:
                    pass
            except zenoh.ZError:
                break
            leaving.join(0.001)
        leaving.join()

    def poke(self) -> None:
        """Make `receive` return, now or at its next call; thread-safe."""
        self._poked = True
        if self._since is not None:
            self._wake()

    def nudge(self) -> None:
        """Wake a reader that has waited for a while, so that it checks the clock."""
        if self._since is not None and time.monotonic() - self._since >= WAKE_PERIOD:
            self._wake()

    def _open(self, sample: zenoh.Sample) -> Envelope | None:
        payload, key = sample.payload.to_bytes(), sample.key_expr
        known = self._decoders.get(key)
        if not payload or known is None:
            return None  # a wake-up, an unknown sender, or a pattern, which no honest sender writes
        sender, decoder, largest = known
        if len(payload) > largest:
            self._refuse(sender, key, f"{len(payload)} bytes; allowed: at most {largest}")
            return None
        try:
            return Envelope(sender, decoder.decode(payload), sample.source_info)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            self._refuse(sender, key, str(error))
            return None

    def _refuse(self, sender: str, key: zenoh.KeyExpr, reason: str) -> None:
        text = reason[:LONGEST_TEXT]  # a flood of long ones must not cost time
        reason = fitted("".join(one if one.isprintable() else ascii(one)[1:-1] for one in text))
        self.fault[sender] = reason
        self.refused[sender] = count = self.refused[sender] + 1
        if count & (count - 1) == 0:  # the 1st, 2nd, 4th, 8th ...: a flood must not fill the log
            _LOG.warning("rejected a message on %s: %s (%d so far)", key, reason, count)
