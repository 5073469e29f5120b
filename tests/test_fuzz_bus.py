"""Invalid messages on a live bus: valid ones arrive, invalid ones are counted, and nothing else happens."""

import gc
import os
import random
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh

from bus import joining
from bus.joining import open_session
from bus.keys import (
    CONTROL,
    OPERATOR,
    STATUS,
    TRUTH,
    UAV_COMMAND,
    UAV_OBSERVATION,
    UGV_COMMAND,
    Key,
    Party,
    Role,
)
from bus.messages.vehicle import UavCommand, UgvCommand
from bus.session import Inbox, Session
from mutations import REFUSALS, mutated
from processes import free_port
from staging import GIVEN, client_of, hosted, stage, zenoh_of

STREAM = 20_000
TICKS, GARBAGE_PER_TICK = 200, 5

LARGEST = UAV_COMMAND.largest
SENTINEL = UgvCommand(tick=123_456_789, acceleration=(0.015625, -0.0078125))
COMMANDS = {"uav_0": UAV_COMMAND, "ugv_0": UGV_COMMAND}
SIMULATOR, UGV = Party(role=Role.SIMULATOR, name="simulator"), Party(role=Role.UGV, name="ugv_0")


def refuses(key: Key, payload: bytes) -> bool:
    """Return whether no reader may receive this payload."""
    try:
        msgspec.json.decode(payload, type=key.message)
    except REFUSALS:
        return True
    return len(payload) > LARGEST


@cache
def stream() -> tuple[tuple[str, bytes], ...]:
    """Return the payloads of one client: mutations, its own wake-ups, and payloads of 64 KiB and more."""
    rng = random.Random(12)
    sent = [(name, mutated(COMMANDS[name], rng)) for name in rng.choices(list(COMMANDS), k=STREAM)]
    good = msgspec.json.encode(UgvCommand(tick=1, acceleration=(0.0, 0.0)))
    for size in (LARGEST, LARGEST + 1, *[LARGEST + 1000] * 20):
        sent.insert(rng.randrange(len(sent)), (rng.choice(list(COMMANDS)), good.ljust(size)))
    for _ in range(200):
        sent.insert(rng.randrange(len(sent)), (rng.choice(list(COMMANDS)), b""))
    return tuple(
        (name, payload) for name, payload in sent if payload != msgspec.json.encode(SENTINEL)
    )


class Wire:
    """A simulator's inbox of all commands, and a client that may send anything on their keys."""

    def __init__(self, simulator: Session, client: Session) -> None:
        self.client = client
        self.inbox: Inbox = simulator.inbox_of_all(COMMANDS)
        self._publishers = {
            name: publisher(client, key.expression("run", name)) for name, key in COMMANDS.items()
        }
        while not all(each.matching_status.matching for each in self._publishers.values()):
            self.inbox.receive(0.02)

    def carry(self, sent: tuple[tuple[str, bytes], ...]) -> list[tuple[str, object]]:
        """Send all payloads and then the sentinel, from another thread; return the messages before the sentinel."""
        writer = threading.Thread(target=self._send, args=(sent,), daemon=True)
        writer.start()
        read: list[tuple[str, object]] = []
        while (envelope := self.inbox.receive(20.0)) is not None and envelope.message != SENTINEL:
            read.append((envelope.sender, envelope.message))
        writer.join(20.0)
        assert envelope is not None, "the sentinel is lost"
        return read

    def _send(self, sent: tuple[tuple[str, bytes], ...]) -> None:
        for name, payload in sent:
            self._publishers[name].put(payload)
        self._publishers["ugv_0"].put(msgspec.json.encode(SENTINEL))


def publisher(session: Session, expression: str) -> zenoh.Publisher:
    """Return a publisher that blocks instead of dropping messages, for any key."""
    return zenoh_of(session).declare_publisher(
        expression, congestion_control=zenoh.CongestionControl.BLOCK
    )


@pytest.fixture
def wire(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Wire]:
    """Open a wire that loses no message, even if a busy machine stops the reader for long."""
    patience, lease = "queue/congestion_control/block/wait_before_close", "lease"
    for settings, name, value in (
        (joining._COMMON, patience, 20_000_000),  # [µs]
        (joining._CLIENT, lease, 20_000),  # [ms]
    ):
        assert f"transport/link/tx/{name}" in settings
        monkeypatch.setitem(settings, f"transport/link/tx/{name}", value)
    with (
        open_session(SIMULATOR, "run", listen=(endpoint,)) as simulator,
        open_session(UGV, "run", connect=endpoint) as client,
    ):
        yield Wire(simulator, client)


def test_inbox_delivers_valid_messages_and_counts_the_rest(wire: Wire) -> None:
    # the router drops larger payloads
    sent = [(name, payload) for name, payload in stream() if 0 < len(payload) <= LARGEST]
    refused = [name for name, payload in sent if refuses(COMMANDS[name], payload)]
    taken = [
        (name, msgspec.json.decode(payload, type=COMMANDS[name].message))
        for name, payload in sent
        if not refuses(COMMANDS[name], payload)
    ]
    assert len(sent) > 0.99 * STREAM
    assert min(len(taken), len(refused)) > 0.05 * STREAM
    assert wire.carry(stream()) == taken
    assert wire.inbox.refused == {name: refused.count(name) for name in COMMANDS}
    assert all(0 < len(fault) <= 500 for fault in wire.inbox.fault.values())
    assert wire.carry(()) == []


def test_garbage_leaves_nothing_behind(wire: Wire) -> None:
    measured = []
    for _ in range(3):
        wire.carry(stream())
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        measured.append((sys.getallocatedblocks(), pages * os.sysconf("SC_PAGE_SIZE")))
    _, warm, after = measured
    assert after[0] - warm[0] < 500, measured  # of 20,000 payloads
    assert after[1] - warm[1] < 10e6, measured  # of 5 MB


FOREIGN = (
    *((UAV_COMMAND, "uav_0"), (UAV_OBSERVATION, "uav_0"), (OPERATOR, "ugv_0"), (CONTROL, "")),
    *((UGV_COMMAND, "nobody"), (TRUTH, ""), (STATUS, "")),
)
"""Keys of other vehicles and of other writers; the last three have no reader in this run."""


def undecodable(key: Key, rng: random.Random) -> bytes:
    while not (payload := mutated(key, rng)) or not refuses(key, payload):
        pass
    return payload


def flood_from(session: Session) -> Callable[[], None]:
    """Return a function that sends all invalid messages of a vehicle's session, on its own key and on others."""
    own, rng = (UGV_COMMAND, "ugv_0"), random.Random(13)
    writers = [
        (key, publisher(session, key.expression("run", vehicle)))
        for key, vehicle in (*[own] * GARBAGE_PER_TICK, *FOREIGN)
    ]

    def flood() -> None:
        for key, writer in writers:
            writer.put(undecodable(key, rng))

    return flood


def steadily(command: Any) -> Callable[[Any, int], None]:
    """Answer every observation at once."""
    return lambda commands, tick: commands.send(command(tick=tick, acceleration=(0.01, 0.0)))


def test_flood_of_garbage_is_counted_and_changes_no_flight(tmp_path: Path) -> None:
    """Fly with two valid programs, one of which floods the bus."""
    (tmp_path / "flooded").mkdir()
    with stage(tmp_path, TICKS, is_open=True) as run:
        run.program("uav_0", steadily(UavCommand))
        run.program("ugv_0", steadily(UgvCommand))
        undisturbed = run.fly()
    assert undisturbed.answers.missing == {"uav_0": 0, "ugv_0": 0}
    assert undisturbed.answers.first_missing is None
    (stranger,) = run.events  # a UAV without one of our pilots is reported once
    assert "your own program" in stranger
    with stage(tmp_path / "flooded", TICKS, is_open=True) as run:
        uav = run.program("uav_0", steadily(UavCommand))
        answer = steadily(UgvCommand)
        ugv = run.program("ugv_0", lambda commands, tick: (flood(), answer(commands, tick)))
        flood = flood_from(ugv.session)
        flight = run.fly()
        vehicles = run.server.vehicles()
    assert flight.complete
    assert flight.answers.missing == flight.answers.stale == {"uav_0": 0, "ugv_0": 0}
    assert flight.recorder.sha256() == undisturbed.recorder.sha256()
    assert vehicles["ugv_0"].rejected == {"does not decode": TICKS * GARBAGE_PER_TICK}
    assert vehicles["uav_0"].rejected == {"does not decode": TICKS}
    assert uav.observations.refused == {"uav_0": TICKS}
    assert len({*run.events} - {stranger}) == len(run.events) - 1 == 2


def test_message_on_a_foreign_or_wildcard_key_is_not_delivered(wire: Wire) -> None:
    foreign = ("outrider/run/nobody/command", "outrider/another/ugv_0/command")
    for key in (*foreign, "**", "outrider/**", "*/run/ugv_0/*", "outrider/*/ugv_0/command"):
        zenoh_of(wire.client).put(key, b'{"tick":1,"acceleration":[0,0]}')
    assert wire.carry(()) == []
    assert not any(wire.inbox.refused.values())


def test_a_fault_is_one_printable_line(wire: Wire) -> None:
    wire.carry((("ugv_0", b'{"tick":1,"acceleration":[0,0],"a\\n\\u001b[2J":0}'),))
    assert "\\x1b" in wire.inbox.fault["ugv_0"]
    assert wire.inbox.fault["ugv_0"].isprintable()


def test_idle_connections_keep_no_client_out() -> None:
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    with ExitStack() as stack:
        stack.enter_context(hosted(endpoint))
        for number in range(300):
            opened = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
            if number % 2:
                # the beginning of a message that never ends
                opened.sendall(b"\xff\xff" + b"\xa5" * 300)
        assert stack.enter_context(client_of(endpoint, GIVEN.of("observer"))).connected
