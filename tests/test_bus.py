"""The bus, with real Zenoh sessions over real sockets."""

import math
import queue
import time
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext

import msgspec
import pytest

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
    Party,
    Role,
    check_reads,
    check_run_name,
    check_writes,
)
from bus.messages.vehicle import UavCommand
from bus.session import Session
from mutations import real_messages
from processes import python, wait_until
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


def test_messages_round_trip_with_the_same_bits_and_vehicle(sessions: dict[Role, Session]) -> None:
    for key in KEYS:
        vehicle = NAMES[key.vehicle] if key.vehicle else ""
        inbox = sessions[key.readers[0]].inbox(key, vehicle)
        outbox = sessions[key.writer].outbox(key, vehicle)
        wait_until(lambda outbox=outbox: outbox.wanted)
        for payload in real_messages(key)[:5]:
            message = msgspec.json.decode(payload, type=key.message)
            outbox.send(message)
            envelope = inbox.receive(10.0)
            assert envelope is not None, key
            assert (envelope.sender, envelope.message) == (vehicle, message)


@pytest.mark.parametrize("role", list(Role))
def test_api_denies_every_wrong_role(role: Role) -> None:
    who = party(role)
    for key in KEYS:
        own = NAMES[key.vehicle] if key.vehicle else ""
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


def test_reader_rejects_a_message_that_is_too_large(sessions: dict[Role, Session]) -> None:
    inbox = sessions[Role.OBSERVER].inbox(TRUTH)
    router = zenoh_of(sessions[Role.SIMULATOR])

    def rejected() -> bool:
        router.put("outrider/run/truth", b" " * (TRUTH.largest + 1))
        assert inbox.receive(0.05) is None
        return any(inbox.refused.values())

    wait_until(rejected)
    reason = f"{TRUTH.largest + 1} bytes; allowed: at most {TRUTH.largest}"
    assert list(inbox.fault.values()) == [reason]


def test_receive_gives_up_after_its_patience(sessions: dict[Role, Session]) -> None:
    inbox = sessions[Role.UAV].inbox(UAV_OBSERVATION, "uav_0")
    started = time.monotonic()
    assert inbox.receive(0.3) is None
    assert 0.25 < time.monotonic() - started < 5.0


def test_tokens_report_joining_and_leaving_parties(endpoint: str) -> None:
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
    wait_until(lambda: outbox.wanted)
    sessions[Role.OBSERVER].forget(inbox)
    wait_until(lambda: not outbox.wanted)


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
