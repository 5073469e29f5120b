"""The bus, with real Zenoh sessions over real sockets."""

import math
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext

import msgspec
import pytest
import zenoh

from bus.errors import AccessDenied
from bus.joining import open_session
from bus.keys import (
    COVERAGE,
    KEYS,
    STATUS,
    TRUTH,
    UAV_COMMAND,
    UAV_OBSERVATION,
    UGV_COMMAND,
    UGV_OBSERVATION,
    Key,
    Party,
    Role,
    check_reads,
    check_run_name,
    check_writes,
)
from bus.messages.base import Message
from bus.messages.vehicle import UavCommand, UgvCommand
from bus.session import Envelope, Session
from mutations import real_messages
from processes import python
from staging import zenoh_of

NAMES = {role: role.value for role in Role} | {Role.UAV: "uav_0", Role.UGV: "ugv_0"}


def party(role: Role) -> Party:
    return Party(role=role, name=NAMES[role])


@pytest.fixture
def sessions(endpoint: str) -> Iterator[dict[Role, Session]]:
    """Open a router and one client for each other role."""
    with ExitStack() as stack:
        opened = {
            Role.SIMULATOR: stack.enter_context(
                open_session(party(Role.SIMULATOR), "run", listen=(endpoint,))
            )
        }
        for role in set(Role) - {Role.SIMULATOR}:
            opened[role] = stack.enter_context(open_session(party(role), "run", connect=endpoint))
        yield opened


@pytest.mark.parametrize("key", KEYS, ids=lambda key: key.message.__name__)
def test_messages_round_trip_with_the_same_bits_and_vehicle(sessions, key):
    reader = key.readers[0]
    vehicle = NAMES.get(key.vehicle, "") if key.vehicle else ""
    inbox = sessions[reader].inbox(key, vehicle)
    outbox = sessions[key.writer].outbox(key, vehicle)
    sent: list[Message] = []
    for payload in real_messages(key)[:5]:
        sent.append(msgspec.json.decode(payload, type=key.message))
        assert isinstance(sent[-1], Message)
        assert sent[-1] not in sent[:-1]
        assert _send_until_read(outbox.send, sent, inbox.receive).sender == vehicle


def _send_until_read(send, sent: list[Message], receive) -> Envelope:
    """Send these until the last one is read: earlier ones may be sent before the subscription has arrived."""
    for _ in range(50):
        send(sent[-1])
        while (envelope := receive(0.2)) is not None:
            if envelope.message == sent[-1]:
                return envelope
            assert envelope.message in sent[:-1]  # it was sent again
    raise AssertionError("nothing arrived")


@pytest.mark.parametrize("key", KEYS, ids=lambda key: key.message.__name__)
@pytest.mark.parametrize("role", list(Role))
def test_api_denies_every_wrong_role(key: Key, role: Role) -> None:
    who = party(role)
    own = NAMES.get(key.vehicle, "") if key.vehicle else ""
    for check, allowed in ((check_writes, (key.writer,)), (check_reads, key.readers)):
        with nullcontext() if role in allowed else pytest.raises(AccessDenied, match=who.name):
            check(key, who, own)


def test_a_vehicle_is_denied_the_row_of_another_of_its_kind() -> None:
    other = Party(role=Role.UAV, name="uav_1")
    with pytest.raises(AccessDenied, match="uav_1"):
        check_reads(UAV_OBSERVATION, other, "uav_0")
    with pytest.raises(AccessDenied, match="uav_1"):
        check_writes(UAV_COMMAND, other, "uav_0")
    check_reads(UAV_OBSERVATION, other, "uav_1")


def test_a_denied_reader_and_writer_never_reach_the_bus(sessions: dict[Role, Session]) -> None:
    vehicles = ((UGV_OBSERVATION, "ugv_0"), (UGV_COMMAND, "ugv_0"))
    for key, vehicle in (*vehicles, (TRUTH, ""), (COVERAGE, ""), (STATUS, "")):
        with pytest.raises(AccessDenied):
            sessions[Role.UAV].inbox(key, vehicle)
        with pytest.raises(AccessDenied):
            sessions[Role.UAV].outbox(key, vehicle)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308])
def test_invalid_message_is_refused_before_it_is_sent(
    sessions: dict[Role, Session], bad: float
) -> None:
    outbox = sessions[Role.UAV].outbox(UAV_COMMAND, "uav_0")
    with pytest.raises(ValueError, match="command"):
        outbox.send(UavCommand(tick=1, acceleration=(bad, 0.0)))
    with pytest.raises(ValueError, match="command"):
        outbox.send(UavCommand(tick=-1, acceleration=(0.0, 0.0)))


GARBAGE = [
    b"{",
    b"\xff\xfe",
    b"null",
    b'{"tick":1}',
    b'{"tick":1,"acceleration":[null,0.0]}',
    b'{"tick":1,"acceleration":[1e308,0.0]}',
    b'{"tick":1,"acceleration":[0.0,0.0],"velocity":[0.0,0.0]}',
    b'{"tick":1,"acceleration":[0.0,0.0,0.0]}',
    b"[" * 60_000,
]


def test_undecodable_message_is_counted_named_and_dropped(sessions: dict[Role, Session]) -> None:
    inbox = sessions[Role.SIMULATOR].inbox_of_all({"uav_0": UAV_COMMAND, "ugv_0": UGV_COMMAND})
    raw = zenoh_of(sessions[Role.UGV])
    good = UgvCommand(tick=3, acceleration=(0.0, 0.1))
    outbox = sessions[Role.UGV].outbox(UGV_COMMAND, "ugv_0")
    for payload in GARBAGE:
        raw.put(
            "outrider/run/ugv_0/command", payload, congestion_control=zenoh.CongestionControl.BLOCK
        )
    outbox.send(good)
    envelope = inbox.receive(10.0)
    assert envelope is not None
    assert (envelope.sender, envelope.message) == ("ugv_0", good)
    assert inbox.refused == {"uav_0": 0, "ugv_0": len(GARBAGE)}


def test_oversized_messages_are_dropped_or_refused(sessions):
    inbox = sessions[Role.SIMULATOR].inbox_of_all({"uav_0": UAV_COMMAND, "ugv_0": UGV_COMMAND})
    observer = sessions[Role.OBSERVER].inbox(TRUTH)
    client, router = zenoh_of(sessions[Role.UGV]), zenoh_of(sessions[Role.SIMULATOR])
    good = msgspec.json.encode(UgvCommand(tick=3, acceleration=(0.0, 0.1)))
    for size in (UGV_COMMAND.largest + 1, 2 << 20, UGV_COMMAND.largest):
        client.put(
            "outrider/run/ugv_0/command",
            good.ljust(size),
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
    assert inbox.receive(10.0) is not None
    assert inbox.next_waiting() is None
    assert inbox.refused == {"uav_0": 0, "ugv_0": 0}
    for _ in range(100):
        router.put("outrider/run/truth", b" " * (TRUTH.largest + 1))
        assert observer.receive(0.05) is None
        if any(observer.refused.values()):
            break
    assert list(observer.fault.values()) == [
        f"{TRUTH.largest + 1} bytes; allowed: at most {TRUTH.largest}"
    ]


def test_messages_of_a_stranger_are_not_received(sessions: dict[Role, Session]) -> None:
    inbox = sessions[Role.SIMULATOR].inbox_of_all({"uav_0": UAV_COMMAND, "ugv_0": UGV_COMMAND})
    for key in ("outrider/run/nobody/command", "outrider/another/ugv_0/command"):
        zenoh_of(sessions[Role.UGV]).put(key, b'{"tick":1,"acceleration":[0.0,0.0]}')
    assert inbox.receive(0.5) is None


def test_receive_gives_up_after_its_patience(sessions: dict[Role, Session]) -> None:
    import time

    inbox = sessions[Role.UAV].inbox(UAV_OBSERVATION, "uav_0")
    started = time.monotonic()
    assert inbox.receive(0.3) is None
    assert 0.25 < time.monotonic() - started < 5.0


def test_tokens_report_joining_and_leaving_parties(endpoint: str) -> None:
    import queue

    seen: queue.SimpleQueue[tuple[str, int, bool]] = queue.SimpleQueue()
    with open_session(party(Role.SIMULATOR), "run", listen=(endpoint,)) as simulator:
        with open_session(party(Role.UAV), "run", connect=endpoint) as early:
            early.announce()
            simulator.watch("*", lambda *change: seen.put(change))
            assert seen.get(timeout=10.0) == ("uav_0", 0, True)
            with open_session(party(Role.UAV), "run", connect=endpoint) as another:
                another.announce()
                assert seen.get(timeout=10.0) == ("uav_0", 1, True)
            assert seen.get(timeout=10.0) == ("uav_0", 1, False)
            with open_session(party(Role.UGV), "run", connect=endpoint) as late:
                late.announce()
                assert seen.get(timeout=10.0) == ("ugv_0", 0, True)
            assert seen.get(timeout=10.0) == ("ugv_0", 0, False)
        assert seen.get(timeout=10.0) == ("uav_0", 0, False)


def test_telemetry_detects_its_readers(sessions: dict[Role, Session]) -> None:
    outbox = sessions[Role.SIMULATOR].outbox(TRUTH)
    assert not outbox.wanted
    inbox = sessions[Role.OBSERVER].inbox(TRUTH)
    for _ in range(100):
        if outbox.wanted:
            break
        inbox.receive(0.05)
    assert outbox.wanted


@pytest.mark.parametrize("bad", ["", "a/b", "*", "../x", "-x", "x" * 65])
def test_a_run_name_that_cannot_be_a_key_is_refused(bad: str) -> None:
    with pytest.raises(ValueError, match="run"):
        check_run_name(bad)


FORKED = """
import multiprocessing, sys
from bus.errors import BusError
from bus.keys import Party, Role
from bus.joining import open_session

def join(results):
    try:
        with open_session(Party(role=Role.UAV, name="uav_0"), "run", connect=sys.argv[1]):
            results.put("joined")
    except BusError as error:
        results.put(str(error))

forks = multiprocessing.get_context("fork")
results = forks.Queue()
with open_session(Party(role=Role.SIMULATOR, name="simulator"), "run", listen=(sys.argv[1],)):
    child = forks.Process(target=join, args=(results,))
    child.start()
    child.join(20.0)
    child.kill()
    print("hung" if results.empty() else results.get())
"""


def test_a_forked_process_is_refused_a_session_after_its_parents(endpoint: str) -> None:
    (line,) = python(FORKED, endpoint, timeout=60).stdout.splitlines()
    assert line.startswith("a forked process cannot join the bus")
