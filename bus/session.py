"""Session of a process on the bus; with `bus.queues` and `bus.joining` the only module that uses Zenoh."""

import logging
import threading
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from bus.errors import AccessDenied
from bus.keys import (
    MAX_SESSIONS,
    Delivery,
    Key,
    Party,
    Role,
    check_reads,
    check_writes,
    token,
    token_owner,
    vehicle_token,
)
from bus.queues import WAKE_PERIOD, Envelope, Inbox, Outbox

__all__ = ["Envelope", "Inbox", "Outbox", "Session"]

_LOG = logging.getLogger("outrider.bus")
_CAPACITY = 256
"""Capacity of an inbox [messages]; writers block when it is full."""
_QUERY_TIMEOUT = 2.0
"""Time limit for finding the free session numbers of a party [s]."""


class Session:
    """Session of one process in one run.

    Open it with `bus.joining.open_session`.
    """

    def __init__(
        self, zenoh_session: zenoh.Session, party: Party, run: str, *, hosts: bool
    ) -> None:
        self._zenoh = zenoh_session
        self._hosts = hosts
        self._inboxes: list[Inbox] = []
        self._outboxes: list[Outbox] = []
        self._kept: list[object] = []
        self._closing = threading.Event()
        self._gate = threading.Lock()
        self.party = party
        self.run = run
        self.id = str(zenoh_session.zid())
        """Unique identity of the session."""
        self.number = 0
        """Number of the session among the present sessions of its party."""
        self._alarm = threading.Thread(target=self._nudge_all, name="outrider-alarm", daemon=True)
        self._alarm.start()

    def _nudge_all(self) -> None:
        while not self._closing.wait(WAKE_PERIOD):
            for inbox in tuple(self._inboxes):
                inbox.nudge()

    def close(self) -> None:
        """Stop the timer and all readers; the Zenoh session closes with its `with`."""
        self._closing.set()
        for inbox in self._inboxes:
            inbox.close()  # which empties it: a wake-up that waits for room ends
        self._alarm.join()
        with self._gate:
            pass  # the last wake-up by `poke` has ended

    @property
    def below(self) -> zenoh.Session:
        """Return the Zenoh session itself, for bridges with keys outside the table."""
        return self._zenoh

    @property
    def routers(self) -> frozenset[str]:
        """Return the ids of its routers: a router's own id, and none for a disconnected client."""
        return frozenset({self.id} if self._hosts else map(str, self._zenoh.info.routers_zid()))

    @property
    def connected(self) -> bool:
        """True if it is connected to a router now."""
        return bool(self.routers)

    def outbox(self, key: Key, vehicle: str = "") -> Outbox:
        """Return a writer of one key.

        Raises:
            AccessDenied: If the table does not grant the key to this party.
        """
        check_writes(key, self.party, vehicle)
        every = key.delivery is Delivery.EVERY
        publisher = self._zenoh.declare_publisher(
            key.expression(self.run, vehicle),
            encoding=zenoh.Encoding.APPLICATION_JSON.with_schema(key.message.__name__),
            congestion_control=zenoh.CongestionControl.BLOCK
            if every
            else zenoh.CongestionControl.DROP,
        )
        outbox = Outbox(publisher, key)
        outbox.set_number(self.number)
        self._outboxes.append(outbox)
        return outbox

    def inbox(self, key: Key, vehicle: str = "", *, newest: int = 0) -> Inbox:
        """Return a reader of one key.

        Args:
            key: Row of the table.
            vehicle: Name of the vehicle.
            newest: Capacity of the inbox; the oldest message makes room for the newest. 0: the writer blocks when the
                inbox is full, or only the newest message is kept if the table says so.

        Raises:
            AccessDenied: If the table does not grant the key to this party.
        """
        check_reads(key, self.party, vehicle)
        expression = key.expression(self.run, vehicle)
        kept = newest or (1 if key.delivery is Delivery.NEWEST else 0)
        return self._subscribe(expression, expression, {expression: (vehicle, key)}, kept=kept)

    def inbox_of_all(self, keys: Mapping[str, Key]) -> Inbox:
        """Return one reader for the same topic of several vehicles, in the order of arrival.

        Args:
            keys: Key of each vehicle; all have the same topic.

        Raises:
            AccessDenied: If the table does not grant one of them to this party.
        """
        for vehicle, key in keys.items():
            check_reads(key, self.party, vehicle)
        known = {key.expression(self.run, vehicle): (vehicle, key) for vehicle, key in keys.items()}
        one = next(iter(keys.values()))
        every, unused = one.expression(self.run, "*"), one.expression(self.run, "-")
        return self._subscribe(every, unused, known, kept=0)

    def _subscribe(
        self,
        expression: str,
        wake_expression: str,
        known: Mapping[str, tuple[str, Key]],
        *,
        kept: int,
    ) -> Inbox:
        def wake() -> None:
            with self._gate:  # Zenoh's session must not be used while another thread closes it
                if not self._closing.is_set():
                    self._zenoh.put(
                        wake_expression, b"", allowed_destination=zenoh.Locality.SESSION_LOCAL
                    )

        handler: Any = (
            zenoh.handlers.RingChannel(kept) if kept else zenoh.handlers.FifoChannel(_CAPACITY)
        )
        inbox = Inbox(self._zenoh.declare_subscriber(expression, handler), wake, known)
        self._inboxes.append(inbox)
        return inbox

    def forget(self, inbox: Inbox) -> None:
        """Close an inbox: a writer without other readers is notified."""
        self._inboxes.remove(inbox)
        inbox.close()

    def report_unknown_certificates(self, known: frozenset[str]) -> None:
        """Log each client whose certificate names no party of the run: the router grants it nothing."""

        def see(event: zenoh.LinkEvent) -> None:
            name = event.link.auth_identifier
            if event.kind == zenoh.SampleKind.PUT and name is not None and name not in known:
                _LOG.warning(
                    "%r has a certificate of this run's authority, but is not a party of the run: access denied",
                    name[:64],
                )

        self._kept.append(self._zenoh.info.declare_link_events_listener(see, history=True))

    def announce(self) -> None:
        """Declare this session present until it leaves or dies, with the first free number of its party.

        Raises:
            AccessDenied: If all numbers are in use.
        """
        liveliness = self._zenoh.liveliness()
        there = liveliness.get(token(self.run, self.party.name, "*"), timeout=_QUERY_TIMEOUT)
        taken = {token_owner(str(reply.ok.key_expr))[1] for reply in there if reply.ok is not None}
        free = [number for number in range(MAX_SESSIONS) if number not in taken]
        if not free:
            raise AccessDenied(
                f"{self.party.name} already has {MAX_SESSIONS} sessions in the run {self.run}; "
                f"allowed: at most {MAX_SESSIONS}"
            )
        self.number = free[0]
        for outbox in self._outboxes:
            outbox.set_number(self.number)
        self._kept.append(liveliness.declare_token(token(self.run, self.party.name, self.number)))
        for _ in liveliness.get(
            token(self.run, self.party.name, self.number), timeout=_QUERY_TIMEOUT
        ):
            pass  # once this is answered, the router knows the token, and later sessions see it

    def offer(self, vehicle: str, role: Role) -> None:
        """Declare that this simulator's scenario has a vehicle."""
        offered = vehicle_token(self.run, vehicle, role)
        self._kept.append(self._zenoh.liveliness().declare_token(offered))

    def is_offered(self) -> bool:
        """Return whether a simulator's scenario has this party's vehicle."""
        offered = vehicle_token(self.run, self.party.name, self.party.role)
        replies = self._zenoh.liveliness().get(offered, timeout=_QUERY_TIMEOUT)
        return any(reply.ok is not None for reply in list(replies))

    def watch(self, party_name: str, on_change: Callable[[str, int, bool], None]) -> None:
        """Report when a session of a party joins or leaves, including sessions already present.

        Args:
            party_name: Name of the party; `*` for all.
            on_change: Called with the party's name, the number of the session within the party, and whether it is
                present. Runs in a thread of Zenoh, so it must be short.
        """

        def see(sample: zenoh.Sample) -> None:
            name, number = token_owner(str(sample.key_expr))
            if number >= 0:
                on_change(name, number, sample.kind == zenoh.SampleKind.PUT)

        expression = token(self.run, party_name, "*")
        self._kept.append(
            self._zenoh.liveliness().declare_subscriber(expression, see, history=True)
        )
