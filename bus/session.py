"""One process on the bus: with its queues and its joining the only place that speaks Zenoh."""

import logging
import threading
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from bus.errors import AccessDenied
from bus.keys import (
    PLACES,
    Delivery,
    Key,
    Party,
    Role,
    check_reads,
    check_writes,
    slot_token,
    token,
    token_owner,
)
from bus.queues import WAKE_PERIOD, Envelope, Inbox, Outbox

__all__ = ["Envelope", "Inbox", "Outbox", "Session"]

_LOG = logging.getLogger("outrider.bus")
_ROOM = 256
"""Messages that wait in an inbox before their writers must."""
_LOOK = 2.0
"""The longest time for which a session looks which places of its party are taken [s]."""


class Session:
    """One process on the bus, in one run.

    Use `bus.joining.open_session`.
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
        """The session's identity; no other has the same."""
        self.place = 0
        """Its number among the sessions of its party that are there."""
        self._alarm = threading.Thread(target=self._nudge_all, name="outrider-alarm", daemon=True)
        self._alarm.start()

    def _nudge_all(self) -> None:
        while not self._closing.wait(WAKE_PERIOD):
            for inbox in tuple(self._inboxes):
                inbox.nudge()

    def close(self) -> None:
        """Stop the reminders and the reading; the Zenoh session closes with its `with`."""
        with self._gate:
            self._closing.set()
        self._alarm.join()
        for inbox in self._inboxes:
            inbox.close()

    @property
    def below(self) -> zenoh.Session:
        """The Zenoh session itself, for bridges: they use keys that are not the table's."""
        return self._zenoh

    @property
    def routers(self) -> frozenset[str]:
        """Its routers now, by session: a router has itself, and a client none while its own is away."""
        return frozenset({self.id} if self._hosts else map(str, self._zenoh.info.routers_zid()))

    @property
    def connected(self) -> bool:
        """True if it has a router now."""
        return bool(self.routers)

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
            congestion_control=zenoh.CongestionControl.BLOCK
            if every
            else zenoh.CongestionControl.DROP,
        )
        outbox = Outbox(publisher, key)
        outbox.take_place(self.place)
        self._outboxes.append(outbox)
        return outbox

    def inbox(self, key: Key, vehicle: str = "", *, newest: int = 0) -> Inbox:
        """A reader of one key.

        Args:
            key: The row.
            vehicle: Whose.
            newest: How many messages wait at most, the oldest making room for the newest; 0: the writer waits when
                the inbox is full, or the newest one alone is kept where the table says so.

        Raises:
            AccessDenied: If the table does not give it to this party.
        """
        check_reads(key, self.party, vehicle)
        expression = key.expression(self.run, vehicle)
        kept = newest or (1 if key.delivery is Delivery.NEWEST else 0)
        return self._subscribe(expression, expression, {expression: (vehicle, key)}, kept=kept)

    def inbox_of_all(self, keys: Mapping[str, Key]) -> Inbox:
        """One reader for the same topic of several vehicles, in the order of arrival.

        Args:
            keys: The key for each vehicle; all of one topic.

        Raises:
            AccessDenied: If the table does not give one of them to this party.
        """
        for vehicle, key in keys.items():
            check_reads(key, self.party, vehicle)
        known = {key.expression(self.run, vehicle): (vehicle, key) for vehicle, key in keys.items()}
        one = next(iter(keys.values()))
        every, nobody = one.expression(self.run, "*"), one.expression(self.run, "-")
        return self._subscribe(every, nobody, known, kept=0)

    def _subscribe(
        self,
        expression: str,
        wake_expression: str,
        known: Mapping[str, tuple[str, Key]],
        *,
        kept: int,
    ) -> Inbox:
        def wake() -> None:
            with self._gate:  # Zenoh's session cannot be used while another thread closes it
                if not self._closing.is_set():
                    self._zenoh.put(
                        wake_expression, b"", allowed_destination=zenoh.Locality.SESSION_LOCAL
                    )

        handler: Any = (
            zenoh.handlers.RingChannel(kept) if kept else zenoh.handlers.FifoChannel(_ROOM)
        )
        inbox = Inbox(self._zenoh.declare_subscriber(expression, handler), wake, known)
        self._inboxes.append(inbox)
        return inbox

    def forget(self, inbox: Inbox) -> None:
        """Read an inbox no more: who writes it is told where nobody else does."""
        self._inboxes.remove(inbox)
        inbox.close()

    def report_unknown_certificates(self, known: frozenset[str]) -> None:
        """Log each client whose certificate names no party of the run: the router lets it do nothing."""

        def see(event: zenoh.LinkEvent) -> None:
            name = event.link.auth_identifier
            if event.kind == zenoh.SampleKind.PUT and name is not None and name not in known:
                _LOG.warning(
                    "%r has a certificate of this run's authority, but is no party of it: it gets nothing",
                    name[:64],
                )

        self._kept.append(self._zenoh.info.declare_link_events_listener(see, history=True))

    def announce(self) -> None:
        """Declare this session present, until it leaves or dies, at the first free place of its party.

        Raises:
            AccessDenied: If all places are taken.
        """
        liveliness = self._zenoh.liveliness()
        there = liveliness.get(token(self.run, self.party.name, "*"), timeout=_LOOK)
        taken = {token_owner(str(reply.ok.key_expr))[1] for reply in there if reply.ok is not None}
        free = [place for place in range(PLACES) if place not in taken]
        if not free:
            raise AccessDenied(
                f"{self.party.name} has {PLACES} sessions in the run {self.run} already; no more are let in"
            )
        self.place = free[0]
        for outbox in self._outboxes:
            outbox.take_place(self.place)
        self._kept.append(liveliness.declare_token(token(self.run, self.party.name, self.place)))
        for _ in liveliness.get(token(self.run, self.party.name, self.place), timeout=_LOOK):
            pass  # once this is answered the router knows of the token, and who comes next sees it

    def offer(self, vehicle: str, role: Role) -> None:
        """Declare that this simulator's scenario has a vehicle."""
        offered = slot_token(self.run, vehicle, role)
        self._kept.append(self._zenoh.liveliness().declare_token(offered))

    def is_offered(self) -> bool:
        """True if a simulator's scenario has the vehicle that this party is."""
        offered = slot_token(self.run, self.party.name, self.party.role)
        replies = self._zenoh.liveliness().get(offered, timeout=_LOOK)
        return any(reply.ok is not None for reply in list(replies))

    def watch(self, party_name: str, on_change: Callable[[str, int, bool], None]) -> None:
        """Tell when a session of a party comes or goes, those that are there already included.

        Args:
            party_name: Whom to watch; `*` is everybody.
            on_change: Called with a name, the number of a session among that party's and whether it is present, from a
                thread of Zenoh's: keep it short.
        """

        def see(sample: zenoh.Sample) -> None:
            name, place = token_owner(str(sample.key_expr))
            if place >= 0:
                on_change(name, place, sample.kind == zenoh.SampleKind.PUT)

        expression = token(self.run, party_name, "*")
        self._kept.append(
            self._zenoh.liveliness().declare_subscriber(expression, see, history=True)
        )
