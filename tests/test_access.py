"""The information contract, layer three.

What the router enforces for real sessions that bypass our API.
"""

import functools
import os
import stat
import tempfile
import time
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh

from bus.access import access_control
from bus.certificates import new_authority
from bus.credentials import (
    Credential,
    CredentialSet,
    give_folder,
    new_certificates,
    new_credentials,
    read_credential,
    read_credentials,
    write_credentials,
)
from bus.errors import AccessDenied
from bus.joining import open_session
from bus.keys import (
    KEYS,
    MAX_SESSIONS,
    STAFF,
    Party,
    Role,
    check_reads,
    check_writes,
    token,
)
from bus.session import Session
from outrider.running.child import child_environment
from processes import free_port
from staging import (
    Received,
    await_exactly,
    client_of,
    hosted,
    raw_session,
    raw_sessions,
    subscribed,
    zenoh_of,
)

RUN = "run"
GIVEN = new_credentials(RUN, ["uav_0", "uav_1"], ["ugv_0", "ugv_1"])
NAMES = [credential.name for credential in GIVEN.parties]
VEHICLES = {Role.UAV: ["uav_0", "uav_1"], Role.UGV: ["ugv_0", "ugv_1"]}
REMOTE = zenoh.Locality.REMOTE


pytestmark = pytest.mark.usefixtures("impatient")


@functools.cache
def certified() -> CredentialSet:
    return new_certificates(new_authority(RUN), ["uav_0", "uav_1"], ["ugv_0", "ugv_1"])


@pytest.fixture(params=["password", "tls"])
def known_by(request: pytest.FixtureRequest, endpoint: str) -> str:
    """Return an endpoint for clients with passwords, and one for clients with certificates."""
    if request.param == "tls":
        pytest.importorskip("cryptography", reason="the extra [tls] is not installed")
    return endpoint if request.param == "password" else f"tls/127.0.0.1:{free_port()}"


def given(endpoint: str) -> CredentialSet:
    return certified() if endpoint.startswith("tls/") else GIVEN


def router(endpoint: str) -> AbstractContextManager[Session]:
    """Open a router that is only an observer of the run."""
    return hosted(endpoint, given(endpoint), "observer")


def parties(endpoint: str) -> AbstractContextManager[dict[str, zenoh.Session]]:
    """Open such a router, and a raw client for each party."""
    return raw_sessions(endpoint, given(endpoint), NAMES, "observer")


def all_keys() -> list[tuple[Any, str, str]]:
    """Return each key of the table for every vehicle: row, vehicle, expression."""
    pairs = [(key, vehicle) for key in KEYS for vehicle in VEHICLES.get(key.vehicle, [""])]
    return [(key, vehicle, key.expression(RUN, vehicle)) for key, vehicle in pairs]


def publisher_of(session: zenoh.Session, expression: str) -> Any:
    return session.declare_publisher(expression, allowed_destination=REMOTE)


def may(check: Any, key: Any, name: str, vehicle: str) -> bool:
    try:
        check(key, GIVEN.of(name).party, vehicle)
    except AccessDenied:
        return False
    return True


def test_messages_go_from_their_writer_to_their_readers_alone(known_by: str) -> None:
    """Let all parties write and read every key, each key by itself and by the widest wildcards."""
    wanted = {
        (reader, expression, writer)
        for key, vehicle, expression in all_keys()
        for reader in NAMES
        for writer in NAMES
        if reader != writer
        and may(check_reads, key, reader, vehicle)
        and may(check_writes, key, writer, vehicle)
    }
    assert len(wanted) >= 20
    found: Received = set()
    with parties(known_by) as sessions:
        expressions = [row[2] for row in all_keys()]
        widest = ("**", "outrider/**", f"outrider/{RUN}/*/command")
        kept = [
            subscribed(opened, name, (*expressions, *widest), found)
            for name, opened in sessions.items()
        ]
        publishers = {
            name: [publisher_of(opened, expression) for expression in expressions]
            for name, opened in sessions.items()
        }

        def publish() -> None:
            for name, opened in sessions.items():
                for publisher in publishers[name]:
                    publisher.put(name.encode())
                for expression in expressions:  # also without a declared publisher
                    opened.put(expression, name.encode(), allowed_destination=REMOTE)

        await_exactly(wanted, found, publish)
        assert kept
    assert found == wanted


def declared(owner: str, name: str) -> list[str]:
    """Return tokens of one party in another's name; only the first may pass, and only for a party's own name."""
    places = (NAMES.index(name), MAX_SESSIONS, "0/more", f"by_{name}")
    return [token(RUN, owner, place) for place in places]


def test_parties_announce_themselves_alone(known_by):
    """Let each party declare tokens in every party's name, also with an unused number."""
    seen: dict[str, set[str]] = {name: set() for name in NAMES}
    assert len(NAMES) <= MAX_SESSIONS
    with parties(known_by) as sessions:
        kept: list[object] = []
        for name, opened in sessions.items():
            for expression in (token(RUN, "*", "*"), token(RUN, "simulator", "*"), "outrider/**"):
                kept.append(
                    opened.liveliness().declare_subscriber(
                        expression,
                        lambda sample, name=name: seen[name].add(str(sample.key_expr)),
                        history=True,
                    )
                )
        for name, opened in sessions.items():
            for owner in NAMES:
                for expression in declared(owner, name):
                    kept.append(opened.liveliness().declare_token(expression))
        wanted = {token(RUN, name, NAMES.index(name)) for name in NAMES}
        await_exactly(wanted, seen["simulator"])
    own = {
        name: {expression for owner in NAMES for expression in declared(owner, name)}
        for name in NAMES
    }  # it receives its own tokens
    assert seen["simulator"] - own["simulator"] == wanted - own["simulator"]
    for name in set(NAMES) - {"simulator"}:
        assert seen[name] - own[name] == {token(RUN, "simulator", NAMES.index("simulator"))}


def test_no_party_can_query_the_router_or_another_party(known_by: str) -> None:
    with parties(known_by) as sessions:
        answered = sessions["ugv_0"].declare_queryable(
            "outrider/**", lambda query: query.reply(query.key_expr, b"secret")
        )
        for name in set(NAMES) - {"ugv_0"}:
            own = str(sessions[name].zid())
            for selector in ("outrider/**", "@/**", "**"):
                asked = sessions[name].get(selector, timeout=0.3)
                keys = [str(reply.ok.key_expr) for reply in asked if reply.ok is not None]
                assert all(own in key for key in keys)
        answered.undeclare()


def named(name: str, role: Role, password: str = "x" * 32) -> Credential:
    return Credential(name=name, role=role, password=password)


STRANGERS: dict[str, Credential | None] = {
    "no password": None,
    "a wrong password": named("uav_0", Role.UAV),
    "another's name with its own password": named("ugv_0", Role.UGV, GIVEN.of("uav_0").password),
    "an unknown name": named("nobody", Role.UAV),
}


@pytest.mark.parametrize("kind", STRANGERS)
@pytest.mark.parametrize("mode", ["client", "peer", "router"])
def test_a_stranger_gets_nothing(endpoint: str, kind: str, mode: str) -> None:
    with ExitStack() as stack:
        host = zenoh_of(stack.enter_context(hosted(endpoint, GIVEN)))
        publishers = [publisher_of(host, expression) for _, _, expression in all_keys()]
        commands = host.declare_subscriber("outrider/**", zenoh.handlers.FifoChannel(100))
        settings = {"mode": mode, "scouting__gossip__enabled": True, "listen__endpoints": []}
        try:
            opened = stack.enter_context(raw_session(endpoint, STRANGERS[kind], **settings))
        except zenoh.ZError:
            return  # it was not admitted
        inbox = opened.declare_subscriber("outrider/**", zenoh.handlers.FifoChannel(100))
        limit = time.monotonic() + 1.0
        while time.monotonic() < limit:
            for publisher in publishers:
                publisher.put(b"secret")
            for _, _, expression in all_keys():
                opened.put(expression, b"evil", allowed_destination=REMOTE)
        assert inbox.try_recv() is None
        assert commands.try_recv() is None


def test_a_known_peer_with_gossip_gets_no_more_than_a_client(endpoint: str) -> None:
    with ExitStack() as stack:
        host = zenoh_of(stack.enter_context(hosted(endpoint, GIVEN)))
        stack.enter_context(raw_session(endpoint, GIVEN.of("ugv_0")))
        settings = {"mode": "peer", "scouting__gossip__enabled": True}
        peer = stack.enter_context(raw_session(endpoint, GIVEN.of("uav_0"), **settings))
        expressions = [row[2] for row in all_keys()]
        found: Received = set()
        kept = subscribed(peer, "uav_0", (*expressions, "**"), found)
        publishers = [publisher_of(host, expression) for expression in expressions]

        def publish() -> None:
            for publisher in publishers:
                publisher.put(b"simulator")

        own = {
            ("uav_0", f"outrider/{RUN}/uav_0/{topic}", "simulator")
            for topic in ("observation", "briefing")
        }
        await_exactly(own, found, publish)
        assert kept
        assert found == own
        assert [str(zid) for zid in peer.info.peers_zid()] == []


def test_refused_client_receives_the_reason(endpoint: str) -> None:
    uav, ugv = GIVEN.of("uav_0"), GIVEN.of("ugv_0")
    for party, credential, phrase in (
        (uav.party, None, "without credentials"),
        (uav.party, named("uav_0", Role.UAV), "as uav_0: check the run's password"),
        (ugv.party, uav, "cannot use the credentials of uav_0"),
    ):
        with (
            router(endpoint),
            pytest.raises(AccessDenied, match=phrase),
            open_session(party, RUN, connect=endpoint, credential=credential),
        ):
            pass


def test_access_is_denied_by_default_and_limited_to_the_run() -> None:
    rules = access_control(GIVEN)
    assert rules["default_permission"] == "deny"
    assert {rule["permission"] for rule in rules["rules"]} == {"allow"}
    assert all(
        key.startswith(f"outrider/{RUN}/") and "**" not in key
        for rule in rules["rules"]
        for key in rule["key_exprs"]
    )
    assert {name for subject in rules["subjects"] for name in subject["usernames"]} == set(NAMES)


def test_credentials_are_private_random_and_read_back(tmp_path: Path) -> None:
    files = write_credentials(GIVEN, tmp_path / "made")
    assert {path.name for path in files.values()} == {f"{name}.json" for name in ("router", *NAMES)}
    assert stat.S_IMODE((tmp_path / "made").stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in files.values()} == {0o600}
    assert read_credentials(files["router"]) == GIVEN
    assert {read_credential(files[name]) for name in NAMES} == set(GIVEN.parties)
    for name in NAMES:  # no file contains another party's password
        text = files[name].read_text(encoding="utf-8")
        assert [other for other in NAMES if GIVEN.of(other).password in text] == [name]
    again = new_credentials(RUN, ["uav_0", "uav_1"], ["ugv_0", "ugv_1"])
    assert not {c.password for c in again.parties} & {c.password for c in GIVEN.parties}
    assert not any(c.password in repr(c) + repr(GIVEN) for c in GIVEN.parties)
    with pytest.raises(FileExistsError):
        write_credentials(GIVEN, tmp_path / "made")


def test_credentials_that_cannot_be_used_are_refused_in_one_line(tmp_path: Path) -> None:
    files = write_credentials(GIVEN, tmp_path / "made")
    files["uav_0"].chmod(0o644)
    with pytest.raises(AccessDenied, match="others can read"):
        read_credential(files["uav_0"])
    with pytest.raises(AccessDenied, match="cannot read"):
        read_credential(tmp_path / "nowhere.json")
    with pytest.raises(AccessDenied, match="not a party's credentials"):
        read_credential(files["router"])
    with pytest.raises(AccessDenied, match="not a router's credentials"):
        read_credentials(files["ugv_0"])


def test_the_routers_list_of_passwords_is_gone_once_it_is_open(endpoint, monkeypatch, tmp_path):
    private = tmp_path / "private"
    private.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(private))
    before = private.stat().st_mtime_ns
    with router(endpoint), raw_session(endpoint, GIVEN.of("uav_0")):
        assert private.stat().st_mtime_ns > before  # it was here
        assert not list(private.iterdir())


def test_two_parties_cannot_have_one_name() -> None:
    for uavs, ugvs in ((["a"], ["a"]), (["simulator"], ["a"]), (["a", "a"], ["b"])):
        with pytest.raises(ValueError, match="two parties have this name"):
            new_credentials(RUN, uavs, ugvs)
    assert set(STAFF) <= set(NAMES)
    with pytest.raises(AccessDenied, match="no credentials for uav_7"):
        CredentialSet(run=RUN, parties=GIVEN.parties).of("uav_7")
    assert GIVEN.of("uav_0").party == Party(role=Role.UAV, name="uav_0")


def test_links_are_not_followed_where_credentials_are_given_away(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    folder = tmp_path / "credentials"
    folder.mkdir()
    (folder / "uav_0.json").symlink_to(victim)
    with pytest.raises(FileExistsError):
        write_credentials(GIVEN, folder, owner=(os.geteuid(), os.getegid()))
    assert victim.read_text() == "mine"
    (tmp_path / "link").symlink_to(folder)
    with pytest.raises(OSError, match=r"Not a directory|symbolic"):
        give_folder(tmp_path / "link", (os.geteuid(), os.getegid()))


def test_vehicle_processes_inherit_no_credentials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OUTRIDER_TOKEN", "x" * 20)
    for name in ("OUTRIDER_CREDENTIALS", "OUTRIDER_HOST", "OUTRIDER_PASSWORD"):
        monkeypatch.setenv(name, "y")
        assert name not in child_environment(companion=True)
    assert "OUTRIDER_TOKEN" not in child_environment()
    assert "OUTRIDER_TOKEN" in child_environment(companion=True)


def test_the_sessions_of_a_party_are_limited(endpoint: str) -> None:
    with ExitStack() as stack:
        stack.enter_context(hosted(endpoint, GIVEN))
        ugv = GIVEN.of("ugv_0")
        opened = [stack.enter_context(client_of(endpoint, ugv)) for _ in range(MAX_SESSIONS + 1)]
        for one in opened[:MAX_SESSIONS]:
            one.announce()
        assert [one.number for one in opened[:MAX_SESSIONS]] == list(range(MAX_SESSIONS))
        with pytest.raises(AccessDenied, match=f"ugv_0 already has {MAX_SESSIONS} sessions"):
            opened[-1].announce()
