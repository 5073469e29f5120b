"""Keeps one party's sessions from taking a router's room from all others.

Zenoh limits the sessions of everybody together and ends none. A router of ours is this very process, so it ends the
connection below a session, and Zenoh drops what was on it. Whose a session is tells its certificate; or a liveliness
token with its id, on a key that access control lets its party alone declare. (The router's admin space knows the holder
of each token too, but in Zenoh 1.10.2 a look at it while others join stops all routing for good:
https://github.com/eclipse-zenoh/zenoh/pull/2619.)
"""

import logging
import os
import socket
import stat
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from contextlib import suppress
from ipaddress import ip_address
from typing import NamedTuple

import zenoh

from bus.keys import PLACES, session_owner, session_token
from bus.locator import Locator

_LOG = logging.getLogger("outrider.bus")
NAMELESS = 64
"""Sessions of nobody knows whom that stay, such as those of programs in other languages that declare no such token."""
NEWCOMERS = 512
"""Sessions that stay until they are `GRACE` old, though they are too many otherwise."""
GRACE = 2.0
"""Age from which a session must be within its party's places, or among the nameless [s]."""
_PAUSE = 0.2
"""Time between two looks [s]."""
_AT_ONCE = 25
"""Connections that a look ends: whose is ended connects again, and many at once cost much memory and time."""
_CROWDED = 2000
"""Of so many sessions it ends all that are too many."""
_MOST_CLAIMS = 1000
"""Sessions of one party that are known as its own; others are nobody's."""
_QUIET = 10.0
"""Time between two lines in the log about one party [s]."""
_OVER_TCP = ("tcp/", "tls/", "ws/")
"""Of these each session has a connection of its own that can be found; a Unix socket is this machine's users' alone."""


class Connection(NamedTuple):
    """The connection of one session."""

    zid: str
    src: str
    dst: str
    name: str | None
    """The name in the certificate that it has shown; None: none."""


def surplus(
    since: Mapping[Connection, float], claims: Mapping[str, Collection[str]], now: float
) -> list[Connection]:
    """Tells the connections that are too many.

    The oldest `PLACES` of each party stay. Of the others those that are younger than `GRACE` stay, the newest
    `NEWCOMERS` of them: who comes in a flood has time to say who it is. Of the older ones the oldest `NAMELESS` of
    nobody's stay: who was there before a flood is not disturbed by it.

    Args:
        since: When each one came [s], in this order.
        claims: The parties that say that a session is their own. One that several claim stays where it is within the
            places of any: nobody can have the session ended of a party that says that it is its own.
        now: The present [s].
    """
    parties: defaultdict[str, list[Connection]] = defaultdict(list)
    for link in since:
        for name in {link.name} if link.name is not None else claims.get(link.zid, ()):
            parties[name].append(link)
    within = {link for links in parties.values() for link in links[:PLACES]}
    known = {link for links in parties.values() for link in links}
    others = [link for link in since if link not in within]
    young = [link for link in others if now - since[link] < GRACE]
    old = [link for link in others if now - since[link] >= GRACE]
    return (
        [link for link in old if link in known]
        + [link for link in old if link not in known][NAMELESS:]
        + young[: max(0, len(young) - NEWCOMERS)]
    )


class SessionLimit:
    """Ends the surplus sessions of a router whose clients have credentials, for as long as it is open."""

    def __init__(self, router: zenoh.Session, run: str, known: frozenset[str]) -> None:
        """Start to look after a router.

        Args:
            router: The router.
            run: Name of the run.
            known: Names of all parties; another certificate of the same authority is named in the log.
        """
        self._router, self._known = router, known
        self._since: dict[Connection, float] = {}
        self._claims: dict[str, set[str]] = {}
        self._claimed: Counter[str] = Counter()
        self._told: dict[str, float] = {}
        self._untold: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._news, self._closing = threading.Event(), threading.Event()
        claimed = session_token(run, "*", "*")
        self._listeners = (
            router.liveliness().declare_subscriber(claimed, self._note_claim, history=True),
            router.info.declare_link_events_listener(self._note_link, history=True),
        )
        self._thread = threading.Thread(target=self._watch, name="outrider-sessions", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop; the router is still open."""
        self._closing.set()
        self._news.set()
        self._thread.join()
        for listener in self._listeners:
            listener.undeclare()  # type: ignore[no-untyped-call]

    def _note_claim(self, sample: zenoh.Sample) -> None:
        """A party says that a session is its own, or no longer; called by a thread of Zenoh's."""
        name, zid = session_owner(str(sample.key_expr))
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT and self._claimed[name] < _MOST_CLAIMS:
                names = self._claims.setdefault(zid, set())
                self._claimed[name] += name not in names
                names.add(name)
            elif sample.kind == zenoh.SampleKind.DELETE and name in self._claims.get(zid, ()):
                self._claimed[name] -= 1
                self._claims[zid].discard(name)
                if not self._claims[zid]:
                    del self._claims[zid]

    def _note_link(self, event: zenoh.LinkEvent) -> None:
        """A session comes or goes; called by a thread of Zenoh's, not always in this order."""
        name = event.link.auth_identifier
        if event.kind != zenoh.SampleKind.PUT:
            return
        if name is not None and name not in self._known:
            _LOG.warning(
                "%r has a certificate of this run's authority, but is no party of it: it gets nothing",
                name[:64],
            )
        self._news.set()

    def _watch(self) -> None:
        more = False
        while not self._closing.is_set():
            self._news.wait(_PAUSE if more else None)
            self._news.clear()
            more = self._look()
            self._closing.wait(_PAUSE)

    def _look(self) -> bool:
        """End some of what is too many; whether more is, or will be by its age."""
        now = time.monotonic()
        there = [
            Connection(str(link.zid), link.src, link.dst, link.auth_identifier)
            for link in self._router.info.links()
            if link.dst.startswith(_OVER_TCP)
        ]
        left = self._since.keys() & there
        self._since = {link: came for link, came in self._since.items() if link in left}
        for link in there:
            self._since.setdefault(link, now)
        with self._lock:
            claims = {zid: frozenset(own) for zid, own in self._claims.items()}
        wanted = surplus(self._since, claims, now)
        ended = end_connections(wanted if len(there) > _CROWDED else wanted[:_AT_ONCE])
        self._tell(Counter(link.name or min(claims.get(link.zid, ("",))) for link in ended))
        return bool(surplus(self._since, claims, now + GRACE))

    def _tell(self, ended: Counter[str]) -> None:
        """A line in the log for each party, though not at every look."""
        self._untold += ended
        now = time.monotonic()
        for name in ended:
            if now - self._told.get(name, -_QUIET) < _QUIET:
                continue
            self._told[name] = now
            count = self._untold.pop(name)
            if name:
                _LOG.warning("%r: %d sessions beyond %d were ended", name[:64], count, PLACES)
            else:
                _LOG.warning(
                    "%d sessions that do not say whose they are were ended; %d may stay",
                    count,
                    NAMELESS,
                )


_Ends = tuple[object, int, object, int]


def _ends(link: Connection) -> _Ends:
    near, far = Locator.of(link.src), Locator.of(link.dst)
    return _numeric(near.host), int(near.port), _numeric(far.host), int(far.port)


def _numeric(host: str) -> object:
    """An address however it is written, without the name of an interface."""
    return ip_address(host.partition("%")[0])


def end_connections(links: Collection[Connection]) -> list[Connection]:
    """End connections of this process that a library holds.

    Returns:
        Those that were found.
    """
    wanted: dict[_Ends, Connection] = {}
    for one in links:
        with suppress(ValueError):  # an end that is no address is not found either
            wanted[_ends(one)] = one
    ended: list[Connection] = []
    for number in os.listdir("/dev/fd") if wanted else ():
        with suppress(OSError, ValueError):
            # Of sockets alone: to close a copy of a file's descriptor would give back the process' locks on the file.
            if not stat.S_ISSOCK(os.fstat(int(number)).st_mode):
                continue
            # A copy stays this connection, also where the library closes its own meanwhile.
            with socket.socket(fileno=os.dup(int(number))) as copy:
                if copy.family not in (socket.AF_INET, socket.AF_INET6):
                    continue
                near, far = copy.getsockname(), copy.getpeername()
                link = wanted.get((_numeric(near[0]), near[1], _numeric(far[0]), far[1]))
                if link is not None:
                    copy.shutdown(socket.SHUT_RDWR)
                    ended.append(link)
    return ended
