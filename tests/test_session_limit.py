"""Sessions of one party that are too many are ended, and nobody else's."""

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest
from processes import free_port, wait_until
from staging import client_of, hosted, raw_session

from bus import session_limit
from bus.access import new_certificates, new_credentials
from bus.certificates import new_authority
from bus.keys import PLACES, session_token
from bus.session import Session, open_session
from bus.session_limit import GRACE, NAMELESS, NEWCOMERS, Connection, end_connections, surplus

RUN = "run"
GIVEN = {
    "tcp": new_credentials(RUN, ["uav_0"], ["ugv_0"]),
    "tls": new_certificates(new_authority(RUN), ["uav_0"], ["ugv_0"]),
}
SIMULATOR = GIVEN["tcp"].of("simulator").party


def links(name: str, count: int, certified: bool = False) -> list[Connection]:
    return [
        Connection(f"{name}{k}", "tcp/a:1", f"tcp/{name}:{k}", name if certified else None)
        for k in range(count)
    ]


@pytest.mark.parametrize("certified", [False, True])
def test_the_oldest_sessions_of_each_party_stay(certified: bool) -> None:
    many, few = links("ugv_0", 100, certified), links("uav_0", PLACES, certified)
    since = dict.fromkeys((*many, *few), 0.0)
    claims = {} if certified else {link.zid: {link.zid[:5]} for link in since}
    assert surplus(since, claims, GRACE) == many[PLACES:]
    assert surplus(since, claims, 0.9 * GRACE) == []


def test_of_nobodys_sessions_the_oldest_stay_and_newcomers_have_time() -> None:
    """A session from before a flood is not disturbed, and one that comes in it can say whose it is."""
    old, new = links("old", NAMELESS + 10), links("new", NEWCOMERS + 10)
    since = dict.fromkeys(old, 0.0) | dict.fromkeys(new, 10.0)
    assert surplus(since, {}, 10.0 + 0.5 * GRACE) == old[NAMELESS:] + new[:10]
    assert surplus(since, {new[0].zid: {"uav_0"}}, 10.0) == old[NAMELESS:] + new[1:10]


def test_nobody_can_have_anothers_session_ended_by_a_claim() -> None:
    mine, theirs = links("ugv_0", 20), links("uav_0", 2)
    since = dict.fromkeys((*mine, *theirs), 0.0)
    claims = {link.zid: {"ugv_0"} for link in since}
    claims |= {link.zid: {"ugv_0", "uav_0"} for link in theirs}
    assert surplus(since, claims, 10.0) == mine[PLACES:]


def test_connections_are_found_however_their_addresses_are_written() -> None:
    """IPv6, IPv4 within IPv6, and IPv4; what is not there is not found."""
    one, two = free_port(), free_port()
    listen = (f"tcp/[::]:{one}", f"tcp/127.0.0.1:{two}")
    connect = (f"tcp/[::1]:{one}", f"tcp/127.0.0.1:{one}", f"tcp/127.0.0.1:{two}")
    with ExitStack() as stack:
        router = stack.enter_context(open_session(SIMULATOR, RUN, listen=listen))
        clients = [
            stack.enter_context(open_session(SIMULATOR, RUN, connect=endpoint))
            for endpoint in connect
        ]
        there = [Connection(str(x.zid), x.src, x.dst, None) for x in router._zenoh.info.links()]
        assert {link.zid for link in there} == {client.id for client in clients}
        ended = end_connections(
            [*there, there[0]._replace(dst="tcp/[::1]:1"), there[0]._replace(src="ws/a")]
        )
        assert sorted(ended) == sorted(there)
        gone = {link.dst for link in there}
        wait_until(lambda: not gone & addresses(router))


def addresses(router: Session) -> set[str]:
    return {link.dst for link in router._zenoh.info.links()}


@contextmanager
def flooded(protocol: str, count: int, *, claimed: bool = False) -> Iterator[tuple[Session, str]]:
    """A router to which one vehicle opens so many sessions, after one that it uses; and that one's address."""
    given, endpoint = GIVEN[protocol], f"{protocol}/127.0.0.1:{free_port()}"
    rogue = given.of("ugv_0")
    with hosted(endpoint, given) as router, ExitStack() as stack:
        stack.enter_context(client_of(endpoint, rogue)).announce()
        (first,) = router._zenoh.info.links()
        for _ in range(count):
            opened = stack.enter_context(raw_session(endpoint, rogue))
            if claimed:
                own = session_token(RUN, "ugv_0", str(opened.zid()))
                stack.enter_context(opened.liveliness().declare_token(own))
        yield router, first.dst


@pytest.mark.parametrize(
    ("protocol", "count", "claimed", "left"),
    [
        ("tcp", 300, False, NAMELESS),
        ("tcp", 100, True, PLACES - 1),
        ("tls", 100, False, PLACES - 1),
    ],
    ids=["nameless", "claimed", "certified"],
)
def test_one_vehicle_with_hundreds_of_sessions_keeps_no_other_out(
    protocol, count, claimed, left, monkeypatch, caplog
) -> None:
    """Its own first one stays connected, and a few beside it; the rest are ended whenever they come again."""
    monkeypatch.setattr(session_limit, "GRACE", 1.0)
    monkeypatch.setattr(session_limit, "_QUIET", 1000.0)
    monkeypatch.setattr(session_limit, "_AT_ONCE", 100)
    with flooded(protocol, count, claimed=claimed) as (router, first):
        there = addresses(router)
        endpoint = router._zenoh.info.links()[0].src
        with client_of(endpoint, GIVEN[protocol].of("uav_0")) as late:
            late.announce()
            (mine,) = [x.dst for x in router._zenoh.info.links() if str(x.zid) == late.id]
            wait_until(lambda: len(there & addresses(router)) <= 1 + left)
            assert {first, mine} <= addresses(router)
    told = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    assert 1 <= len(told) <= 2  # a line for the party, and one for nobody's
    assert all("were ended" in line for line in told)


def test_a_party_claims_sessions_in_its_own_name_alone() -> None:
    given, endpoint = GIVEN["tcp"], f"tcp/127.0.0.1:{free_port()}"
    received: list[str] = []
    with hosted(endpoint, given) as router, raw_session(endpoint, given.of("ugv_0")) as rogue:
        router._zenoh.liveliness().declare_subscriber(
            session_token(RUN, "*", "*"), lambda sample: received.append(str(sample.key_expr))
        )
        claims = [session_token(RUN, name, "a") for name in ("uav_0", "simulator", "ugv_0")]
        kept = [rogue.liveliness().declare_token(claim) for claim in claims]
        wait_until(lambda: bool(received))
        assert received == [claims[-1]]
        assert kept
