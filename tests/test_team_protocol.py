"""Hand-over between the UAVs of a team: the product's rules against random links and losses, and wrong rules."""

import pytest

from team_protocol import TICKS, Protocol, counts

RUNS = [4_000, pytest.param(100_000, marks=pytest.mark.long)]
"""For each setting."""


@pytest.mark.parametrize("runs", RUNS)
@pytest.mark.parametrize(("guards", "losses"), [(1, 0), (1, 3), (2, 0), (2, 1), (2, 3)])
def test_a_team_with_guards_does_not_run_out_of_them(guards: int, losses: int, runs: int) -> None:
    found = counts(runs, guards=guards, losses=losses)
    assert (found.broken, found.dark, found.disordered) == (0, 0, 0)
    # the adversary leaves the team a chance, and uses its own
    assert found.certified > 0.8 * TICKS * runs
    assert found.handovers > 2 * runs
    assert found.losses >= 0.5 * losses * runs


@pytest.mark.parametrize("runs", RUNS)
@pytest.mark.parametrize("guards", [1, 2])
@pytest.mark.parametrize("forgets", [False, True])
def test_late_commands_do_not_end_the_watch(guards: int, forgets: bool, runs: int) -> None:
    found = counts(runs, guards=guards, losses=1, late=3, forgets=forgets)
    assert (found.broken, found.dark) == (0, 0)


@pytest.mark.parametrize(
    ("protocol", "guards", "losses"),
    [
        (Protocol.RELEASE_ON_OFFER, 1, 0),
        (Protocol.EQUAL_NUMBERS_RELEASE, 1, 0),
        (Protocol.NUMBER_LOST_WITH_PROCESS, 1, 3),
        (Protocol.ACCEPT_UNCERTIFIED, 1, 0),
        (Protocol.RESIGN_ON_TIMEOUT, 1, 0),
        (Protocol.COUNT_MESSAGES, 2, 1),
    ],
)
def test_a_wrong_protocol_is_caught(protocol: Protocol, guards: int, losses: int) -> None:
    found = counts(500, protocol=protocol, guards=guards, losses=losses)
    assert found.caught > 25
