"""A crowd at the router's port, or a vehicle with credentials, ends no run."""

import socket
from contextlib import ExitStack
from pathlib import Path

import pytest

from bus import joining
from bus.errors import AccessDenied
from bus.keys import PLACES
from processes import free_port
from staging import GIVEN, client_of, hosted, stage


@pytest.mark.parametrize(
    ("without", "zenohs_own", "patience"),
    [("accept_pending", 100, 6000), ("accept_timeout", 10_000, 2500)],
)
def test_a_client_joins_beside_connections_that_say_nothing_or_nonsense(
    without: str, zenohs_own: int, patience: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Room for many and patience with none each suffice; with neither it takes 10 s."""
    monkeypatch.setitem(joining._ROUTER, f"transport/unicast/{without}", zenohs_own)
    monkeypatch.setitem(joining._CLIENT, "connect/timeout_ms", patience)
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


def test_a_party_has_so_many_sessions_and_no_more(endpoint: str) -> None:
    with ExitStack() as stack:
        stack.enter_context(hosted(endpoint))
        ugv = GIVEN.of("ugv_0")
        opened = [stack.enter_context(client_of(endpoint, ugv)) for _ in range(PLACES + 1)]
        for one in opened[:PLACES]:
            one.announce()
        assert [one.place for one in opened[:PLACES]] == list(range(PLACES))
        with pytest.raises(
            AccessDenied, match=f"ugv_0 already has {PLACES} sessions in the run run"
        ):
            opened[-1].announce()


def test_a_flood_of_tokens_is_kept_once_for_each_place(tmp_path: Path) -> None:
    with stage(tmp_path, 10) as run:
        slots = run.server._slots
        for number in range(20_000):
            slots._note("ugv_0", number % PLACES, number % 3 > 0)
            slots._note("nobody", number % PLACES, True)
        assert len(slots._changes) == len(slots._arrivals) == PLACES
        slots.follow()
        assert len(slots._slots["ugv_0"].sessions) <= PLACES
        assert not slots._changes


def test_a_session_that_goes_and_comes_between_two_looks_is_briefed_anew(tmp_path: Path) -> None:
    with stage(tmp_path, 10) as run:
        slots = run.server._slots
        slots._note("ugv_0", 0, True)
        slots.follow()
        slot = slots._slots["ugv_0"]
        slot.owed = None
        slots._note("ugv_0", 0, False)
        slots._note("ugv_0", 0, True)
        slots.follow()
    assert (slot.lost, slot.rejoined, slot.owed, slot.holder) == (1, 1, 0, 0)
