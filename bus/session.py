"""Opening, closing, publishing, awaiting, joining and leaving: the only file that speaks Zenoh."""

import json
import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import msgspec
import zenoh

from bus.errors import BusError
from bus.keys import (
    Delivery,
    Key,
    Party,
    Role,
    any_vehicle,
    check_reads,
    check_run_name,
    check_writes,
    token,
    token_owner,
    vehicle_of,
)
from bus.messages import Message

_LOG = logging.getLogger("outrider.bus")
_ROOM = 256
"""Messages that wait in an inbox before their writers must."""
_WAKE_PERIOD = 0.1
"""A waiting reader looks up this often [s], for deadlines and for peers that come and go."""
_LARGEST = 1 << 20
"""Larger payloads [bytes] are refused unread."""

_COMMON: dict[str, Any] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "scouting/delay": 0,
    "transport/shared_memory/enabled": False,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
}
_CLIENT: dict[str, Any] = {
    "mode": "client",
    "connect/timeout_ms": 10_000,
    "connect/exit_on_failure": True,
    "connect/retry": {"period_init_ms": 50, "period_max_ms": 200, "period_increase_factor": 2},
    "transport/link/tx/lease": 1000,
}
_ROUTER: dict[str, Any] = {"mode": "router", "listen/exit_on_failure": True}


def _config(settings: Mapping[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return config


@dataclass(frozen=True, slots=True, kw_only=True)
class Letter:
    """A message that has arrived."""

    sender: str
    """The vehicle in its key; empty where there is none."""
    message: Message


class Outbox:
    """Writes one key."""

    def __init__(self, publisher: zenoh.Publisher, key: Key) -> None:
        self._publisher = publisher
        self._encoder = msgspec.json.Encoder()
        self._decoder = msgspec.json.Decoder(key.message)
        self._topic = key.topic
        self.wanted = False
        """Whether anybody reads it now."""
        self._listener = publisher.declare_matching_listener(self._see)

    def _see(self, status: Any) -> None:  # noqa: ANN401 - Zenoh's stub says bool, its library gives a MatchingStatus
        self.wanted = bool(status.matching)

    def send(self, message: Message) -> None:
        """Send a message.

        Raises:
            ValueError: If it breaks its own type's bounds (NaN and infinity do); nothing was sent.
            BusError: If the session is gone.
        """
        payload = self._encoder.encode(message)
        try:
            self._decoder.decode(payload)  # what the reader will do: NaN has become null, 1e308 is out of bounds
        except msgspec.ValidationError as error:
            raise ValueError(f"{self._topic}: {error}") from error
        try:
            self._publisher.put(payload)
        except zenoh.ZError as error:
            raise BusError(f"cannot send {self._topic}: {error}") from error


class Inbox:
    """Reads one topic, in order. What does not decode is counted, logged and dropped."""

    def __init__(self, wake: Callable[[], None], decoders: Mapping[str, msgspec.json.Decoder[Any]]) -> None:
        self._wake = wake
        self._decoders = decoders
        self._subscriber: zenoh.Subscriber[zenoh.Handler[zenoh.Sample]] | None = None
        self._since: float | None = None
        self._poked = False
        self.refused: dict[str, int] = dict.fromkeys(decoders, 0)
        """How many messages of each sender did not decode."""
        self.fault: dict[str, str] = dict.fromkeys(decoders, "")
        """Why the last of them did not."""

    def attach(self, subscriber: "zenoh.Subscriber[zenoh.Handler[zenoh.Sample]]") -> None:
        """Read from this subscriber."""
        self._subscriber = subscriber

    def receive(self, patience: float) -> Letter | None:
        """The next message, or None after `patience` [s] without one, or once somebody has called `poke`."""
        if self._subscriber is None:
            raise BusError("the inbox is closed")
        started = self._since = time.monotonic()
        try:
            while True:
                letter = self._open(self._subscriber.recv())
                if letter is not None:
                    return letter
                if self._poked or time.monotonic() - started >= patience:
                    self._poked = False
                    return None
        except zenoh.ZError as error:
            raise BusError(f"the session is gone: {error}") from error
        finally:
            self._since = None

    def poke(self) -> None:
        """Make `receive` return; may be called from any thread."""
        self._poked = True
        self._wake()

    def nudge(self) -> None:
        """Let a reader that has waited for a while look at the clock."""
        if self._since is not None and time.monotonic() - self._since >= _WAKE_PERIOD:
            self._wake()

    def _open(self, sample: zenoh.Sample) -> Letter | None:
        payload = sample.payload.to_bytes()
        expression = str(sample.key_expr)
        sender = vehicle_of(expression)
        decoder = self._decoders.get(sender)
        if not payload or decoder is None:
            return None  # a wake-up, or nobody of this run
        if len(payload) > _LARGEST:
            self._refuse(sender, expression, f"{len(payload)} bytes; allowed up to {_LARGEST}")
            return None
        try:
            return Letter(sender=sender, message=decoder.decode(payload))
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            self._refuse(sender, expression, str(error))
            return None

    def _refuse(self, sender: str, expression: str, reason: str) -> None:
        self.refused[sender] += 1
        self.fault[sender] = reason[:500]
        _LOG.warning("refused a message on %s: %s", expression, reason)


class Session:
    """One process on the bus, in one run.

    Use `open_session`.
    """

    def __init__(self, zenoh_session: zenoh.Session, party: Party, run: str) -> None:
        self._zenoh = zenoh_session
        self._inboxes: list[Inbox] = []
        self._kept: list[object] = []
        self._closing = threading.Event()
        self.party = party
        self.run = run
        self._alarm = threading.Thread(target=self._nudge_all, name="outrider-alarm", daemon=True)
        self._alarm.start()

    def _nudge_all(self) -> None:
        while not self._closing.wait(_WAKE_PERIOD):
            for inbox in tuple(self._inboxes):
                inbox.nudge()

    def close(self) -> None:
        """Stop the reminders; the Zenoh session closes with its `with`."""
        self._closing.set()
        self._alarm.join()

    def outbox(self, key: Key, vehicle: str = "") -> Outbox:
        """A writer of one key.

        Raises:
            AccessDenied: If the table does not give it to this party.
        """
        check_writes(key, self.party, vehicle)
        every = key.delivery is Delivery.EVERY
        publisher = self._zenoh.declare_publisher(
            key.expression(self.run, vehicle),
            encoding=zenoh.Encoding.APPLICATION_JSON.with_schema(key.message.__name__),
            congestion_control=zenoh.CongestionControl.BLOCK if every else zenoh.CongestionControl.DROP,
        )
        self._kept.append(publisher)
        return Outbox(publisher, key)

    def inbox(self, key: Key, vehicle: str = "") -> Inbox:
        """A reader of one key.

        Raises:
            AccessDenied: If the table does not give it to this party.
        """
        check_reads(key, self.party, vehicle)
        expression = key.expression(self.run, vehicle)
        newest = key.delivery is Delivery.NEWEST
        return self._subscribe(expression, expression, {vehicle_of(expression): key}, newest=newest)

    def inbox_of_all(self, keys: Mapping[str, Key]) -> Inbox:
        """One reader for the same topic of several vehicles, in the order of arrival.

        Args:
            keys: The key for each vehicle; all of one topic.

        Raises:
            AccessDenied: If the table does not give one of them to this party.
        """
        for vehicle, key in keys.items():
            check_reads(key, self.party, vehicle)
        topic = next(iter(keys.values())).topic
        return self._subscribe(any_vehicle(self.run, topic), f"outrider/{self.run}/-/{topic}", keys, newest=False)

    def _subscribe(self, expression: str, wake_expression: str, keys: Mapping[str, Key], *, newest: bool) -> Inbox:
        def wake() -> None:
            if not self._closing.is_set():
                self._zenoh.put(wake_expression, b"", allowed_destination=zenoh.Locality.SESSION_LOCAL)

        decoders = {vehicle: msgspec.json.Decoder(key.message) for vehicle, key in keys.items()}
        inbox = Inbox(wake, decoders)
        handler: Any = zenoh.handlers.RingChannel(1) if newest else zenoh.handlers.FifoChannel(_ROOM)
        subscriber = self._zenoh.declare_subscriber(expression, handler)
        inbox.attach(subscriber)
        self._kept.append(subscriber)
        self._inboxes.append(inbox)
        return inbox

    def announce(self) -> None:
        """Declare this process present, until it leaves or dies."""
        self._kept.append(self._zenoh.liveliness().declare_token(token(self.run, self.party)))

    def watch(self, party_name: str, on_change: Callable[[str, bool], None]) -> None:
        """Tell when a party comes or goes, those that are there already included.

        Args:
            party_name: Whom to watch; `*` is everybody.
            on_change: Called with a name and whether it is present, from a thread of Zenoh's: keep it short.
        """

        def see(sample: zenoh.Sample) -> None:
            on_change(token_owner(str(sample.key_expr)), sample.kind == zenoh.SampleKind.PUT)

        expression = token(self.run, Party(role=Role.OBSERVER, name=party_name))
        self._kept.append(self._zenoh.liveliness().declare_subscriber(expression, see, history=True))


@contextmanager
def open_session(party: Party, run: str, *, connect: str = "", listen: tuple[str, ...] = ()) -> Iterator[Session]:
    """Join the bus.

    Args:
        party: Who this process is.
        run: Name of the run.
        connect: Endpoint of the router, such as `tcp/127.0.0.1:7447`; then this process is its client.
        listen: Endpoints to listen on; then this process is the router.

    Raises:
        ValueError: If the run's name cannot be part of a key.
        BusError: If the router cannot be reached, or an endpoint is not free.
    """
    check_run_name(run)
    if listen:
        settings = _COMMON | _ROUTER | {"listen/endpoints": list(listen)}
        what = f"cannot listen on {', '.join(listen)}: is it in use?"
    else:
        settings = _COMMON | _CLIENT | {"connect/endpoints": [connect]}
        what = f"no router at {connect}: is the simulator running there?"
    try:
        opened = zenoh.open(_config(settings))
    except zenoh.ZError as error:
        raise BusError(f"{what} ({str(error).splitlines()[0]})") from error
    with opened as zenoh_session:
        session = Session(zenoh_session, party, run)
        try:
            yield session
        finally:
            session.close()
