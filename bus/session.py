"""Opening, closing, joining and leaving: with its queues the only place that speaks Zenoh."""

import json
import logging
import os
import resource
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import zenoh

from bus.access import ROUTER_FILE, Credential, CredentialSet, client_settings, router_settings
from bus.certificates import Identity, check_identity, expiry_warning, find_fault
from bus.errors import AccessDenied, BusError
from bus.keys import (
    KEYS,
    PLACES,
    Delivery,
    Key,
    Party,
    Role,
    check_reads,
    check_run_name,
    check_writes,
    largest_payloads,
    read_by,
    slot_token,
    token,
    token_owner,
    written_by,
)
from bus.locator import UNIX, Locator, check_endpoint
from bus.queues import WAKE_PERIOD, Envelope, Inbox, Outbox

__all__ = ["Envelope", "Inbox", "Outbox", "Session", "open_session"]

_LOG = logging.getLogger("outrider.bus")
_ROOM = 256
"""Messages that wait in an inbox before their writers must."""
_LARGE = 1 << 20
"""Payloads [bytes] that router and clients let through at least: keys of extensions may carry so much."""
_LOOK = 2.0
"""The longest time for which a session looks which places of its party are taken [s]."""
_OPENED_IN: set[int] = set()
"""Process ids of this process and of those that it was forked from, if they have opened a session."""
_PROBED = ("tcp", "tls", "ws", UNIX)
"""Protocols of which a plain connection shows whether a router listens."""
_PROBE = 0.05
"""Interval at which a client looks whether its router listens [s]."""
_HEADER = 4096
"""Room for a message's frame beside its payload [bytes]."""

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
    "transport/unicast/open_timeout": 3000,
}
_ROUTER: dict[str, Any] = {
    "mode": "router",
    "listen/exit_on_failure": True,
    # Who connects and says nothing must not keep others out: by default 100 of these do so for 10 s.
    "transport/unicast/accept_pending": 2000,
    "transport/unicast/accept_timeout": 2000,
    "transport/unicast/max_sessions": 1000,
}


def _config(settings: Mapping[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return config


class Session:
    """One process on the bus, in one run.

    Use `open_session`.
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


def _reason(error: zenoh.ZError) -> str:
    """Zenoh's reason without the place in its source."""
    return str(error).splitlines()[0].rpartition(" at /")[0] or str(error)


def _received(largest: int) -> dict[str, Any]:
    """Drops larger messages before their fragments are put together."""
    return {"transport/link/rx/max_message_size": largest + _HEADER}


def _dropped(run: str) -> dict[str, Any]:
    """Drops payloads that are larger than their key allows before anybody's inbox keeps them."""
    return {
        "low_pass_filter": [
            {
                "id": f"largest-{size}",
                "flows": ["ingress"],
                "messages": ["put", "delete", "query", "reply"],
                "key_exprs": list(expressions),
                "size_limit": size,
            }
            for size, expressions in largest_payloads(run).items()
        ]
    }


def _allow_open_files() -> None:
    """As many open files as this user may have.

    Each connection is one, and 1,024 of those who say nothing keep others out.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def _open_router(
    listen: tuple[str, ...], party: Party, run: str, given: CredentialSet | None
) -> zenoh.Session:
    _allow_open_files()
    largest = max(_LARGE, *(key.largest for key in KEYS if key.writer is not party.role))
    with router_settings(given) as access:
        settings = (
            _COMMON
            | _ROUTER
            | _received(largest)
            | _dropped(run)
            | access
            | {"listen/endpoints": list(listen)}
        )
        try:
            return zenoh.open(_config(settings))
        except zenoh.ZError as error:
            raise BusError(f"cannot listen on {', '.join(listen)}: {_reason(error)}") from error


def _explained(
    endpoint: str, credential: Credential, identity: Identity, error: BusError
) -> BusError:
    """Names the fault that keeps a certificate from a router; all that Zenoh says is that it could not connect."""
    found = Locator.of(endpoint)
    try:
        fault = find_fault(found.host, int(found.port), identity)
    except OSError:
        return error
    return AccessDenied(
        f"the router at {endpoint} {fault or 'refuses this process'} (as {credential.name})"
    )


def _check_protocol(endpoints: tuple[str, ...], *, certified: bool) -> None:
    """Refuse what could not work, or would send in the clear.

    Raises:
        AccessDenied: If an endpoint and the credentials do not fit together.
    """
    for endpoint in endpoints:
        if certified and not endpoint.startswith("tls/"):
            raise AccessDenied(
                f"endpoint {endpoint}: these credentials are certificates, so it must begin with tls/"
            )
        if endpoint.startswith("tls/") and not certified:
            raise AccessDenied(
                f"endpoint {endpoint}: needs certificates; `outrider credentials --tls` makes them"
            )


def _check_certificate(identity: Identity, name: str) -> None:
    warning = expiry_warning(name, check_identity(identity, name))
    if warning:
        _LOG.warning("%s", warning)


def _await_router(router: Locator, endpoint: str, join_timeout: float) -> None:
    """Wait until the router accepts connections. A signal ends this wait; in Zenoh's own it would be ignored.

    Raises:
        BusError: If it does not do so in time.
    """
    limit = time.monotonic() + join_timeout
    while fault := router.connection_fault():
        if time.monotonic() >= limit:
            raise BusError(f"no router at {endpoint} within {join_timeout:g} s: {fault}")
        time.sleep(_PROBE)


def _open_client(
    connect: str, party: Party, credential: Credential | None, join_timeout: float | None
) -> zenoh.Session:
    router = Locator.of(connect)
    limit = _CLIENT["connect/timeout_ms"]
    if join_timeout is not None:
        wanted = round(1000.0 * join_timeout)
        if router.protocol in _PROBED:
            _await_router(router, connect, join_timeout)
            # A router that is there refuses this process for good, or is crowded for a while.
            limit = min(wanted, limit)
        else:
            limit = wanted
    largest = max((_LARGE, *(key.largest for key in (*read_by(party), *written_by(party)))))
    settings = _COMMON | _CLIENT | _received(largest) | client_settings(credential)
    settings |= {"connect/endpoints": [connect], "connect/timeout_ms": limit}
    try:
        return zenoh.open(_config(settings))
    except zenoh.ZError as error:
        missing = f"no router at {connect} within {limit / 1000.0:g} s"
        if router.protocol not in _PROBED:
            raise BusError(f"{missing} ({_reason(error)})") from error
        fault = router.connection_fault()
        if fault:
            raise BusError(f"{missing}: {fault}") from error
        if credential is not None and credential.tls is not None:
            raise _explained(connect, credential, credential.tls, BusError(missing)) from error
        who = (
            "without credentials"
            if credential is None
            else f"as {credential.name}: is the password the run's, and is it a router?"
        )
        raise AccessDenied(f"{connect} accepts connections, but not this process {who}") from error


def _refuse_fork() -> None:
    """Refuse a forked process whose parent has had a session: Zenoh would wait for ever for threads of the parent.

    Raises:
        BusError: If this is one.
    """
    if _OPENED_IN - {os.getpid()}:
        raise BusError(
            "a forked process cannot open a session on the bus after its parent has opened one; allowed: a process "
            "that is started otherwise, such as by multiprocessing.get_context('spawn')"
        )
    _OPENED_IN.add(os.getpid())


@contextmanager
def open_session(
    party: Party,
    run: str,
    *,
    connect: str = "",
    listen: tuple[str, ...] = (),
    credential: Credential | None = None,
    given: CredentialSet | None = None,
    join_timeout: float | None = None,
) -> Iterator[Session]:
    """Join the bus.

    Args:
        party: Who this process is.
        run: Name of the run.
        connect: Endpoint of the router, such as `tcp/127.0.0.1:7447`; then this process is its client.
        listen: Endpoints to listen on; then this process is the router.
        credential: By what a client is known.
        given: By what a router knows its clients; None lets everybody in to everything.
        join_timeout: Time for which a client tries to reach a router that is away [s]; None: 10 s. A router that
            refuses the client is tried for 10 s at most.

    Raises:
        ValueError: If the run's name cannot be part of a key.
        ScenarioError: If an endpoint is not one, or its host has no address.
        BusError: If the router cannot be reached, an endpoint cannot be listened on, or this process was forked from
            one that has opened a session.
        AccessDenied: If the router does not know the credential, or it does not fit the endpoint, or its
            certificate is not good.
    """
    check_run_name(run)
    if credential is not None and credential.party != party:
        raise AccessDenied(
            f"{party.name} ({party.role}) cannot use the credentials of {credential.name} ({credential.role})"
        )
    if listen:
        name, identity = ROUTER_FILE, None if given is None else given.tls
    else:
        name, identity = party.name, None if credential is None else credential.tls
    _check_protocol(listen or (connect,), certified=identity is not None)
    for endpoint in listen or (connect,):
        check_endpoint(endpoint)
    _refuse_fork()
    if identity is not None:
        _check_certificate(identity, name)
    opened = (
        _open_router(listen, party, run, given)
        if listen
        else _open_client(connect, party, credential, join_timeout)
    )
    session = Session(opened, party, run, hosts=bool(listen))
    if listen and given is not None and given.tls is not None:
        session.report_unknown_certificates(frozenset(one.name for one in given.parties))
    try:
        yield session
    finally:
        session.close()
        try:
            opened.close()  # type: ignore[no-untyped-call]
        except zenoh.ZError as error:  # what was to be said has been said
            _LOG.warning("the session did not close in time: %s", str(error).partition(" at /")[0])
