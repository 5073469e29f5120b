"""The attack on a team's guarantee: it breaks wrong teams, not the product's, and each find can be flown again."""

import json
from pathlib import Path
from random import Random

import msgspec
import pytest

from agents.team.member import TeamMember
from bus.errors import ScenarioError
from bus.messages.decision import FilterDecision
from outrider_falsify.genome import Candidate
from outrider_falsify.limits import SearchLimits
from outrider_falsify.team.candidate import TeamResult, attacked, repeated
from outrider_falsify.team.genome import decode_team, team_cases
from outrider_falsify.team.plan_file import attack_toml, read_attack
from outrider_falsify.team.work import team_base
from sim.scenario.checks import check_scenario
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from tabular import words

REQUESTS, DARK_AT_LEASH = 0, 5
"""Cases of `team_cases`: requests without need, and blackouts at the end of the leash."""
QUICK = {"area.cell": 0.5, "law.name": "coverage"}


def case(number: int, seed: int = 3) -> Candidate:
    return Candidate(number=number, kind="team", vector=tuple(team_cases()[number]), seed=seed)


def base(duration: float, **changes: object) -> Scenario:
    given = {key.replace("__", "."): value for key, value in changes.items()}
    scenario = load_scenario("scouts", overrides=QUICK | {"duration": duration} | given)
    return team_base(scenario, SearchLimits())


def result_of(number: int, scenario: Scenario) -> TeamResult:
    return attacked(case(number), scenario, SearchLimits())[3]


@pytest.mark.parametrize("guards", [1, 2])
def test_attack_on_the_product_finds_nothing(guards: int) -> None:
    scenario = base(12.0, team__guards=guards)
    results = [result_of(number, scenario) for number in (0, 1, 2, 3, 11)]
    assert not any(one.violated for one in results)
    assert sum(one.counts.handovers for one in results) > 4
    assert sum(one.counts.deaths for one in results) > 2
    assert sum(one.counts.blackouts for one in results) > 0
    assert max(one.score for one in results) > 0.8


def accept_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Break R1: a relief guards, and claims a certificate, before its filter certifies."""
    sound = TeamMember.accept

    def accept(member: TeamMember, decision: FilterDecision | None) -> None:
        lie = None if decision is None else msgspec.structs.replace(decision, reason=None)
        sound(member, lie)

    monkeypatch.setattr(TeamMember, "accept", accept)


def test_uncertified_acceptance_is_caught_and_repeated(monkeypatch, tmp_path: Path) -> None:
    accept_at_once(monkeypatch)
    scenario, events, flight, result = attacked(case(REQUESTS), base(20.0), SearchLimits())
    assert result.violated
    assert result.counts.unguarded > 0
    path = tmp_path / "found.toml"
    path.write_text(attack_toml(scenario, events, ["a comment"]), encoding="utf-8")
    recorded = read_attack(str(path))
    assert recorded == (scenario, events)
    again, verdict = repeated(*recorded)
    assert again.recorder.sha256() == flight.recorder.sha256()
    assert verdict.counts == result.counts


def test_attack_with_deaths_is_repeated_to_the_bit() -> None:
    scenario, events, flight, result = attacked(case(3), base(12.0), SearchLimits())
    assert {event.kind.value for event in events} == {"DEATH", "BLACKOUT", "REQUEST"}
    again, verdict = repeated(scenario, events)
    assert again.recorder.sha256() == flight.recorder.sha256()
    assert verdict.counts == result.counts


def test_leash_twice_as_long_as_allowed_is_caught() -> None:
    sound = base(50.0)
    assert sound.team is not None
    too_long = msgspec.structs.replace(sound.team, scout_range=18.0)  # 9.09 m are allowed
    result = result_of(DARK_AT_LEASH, msgspec.structs.replace(sound, team=too_long))
    assert result.counts.leash_missed > 0
    result = result_of(DARK_AT_LEASH, sound)
    assert result.counts.leash_missed == 0
    assert result.counts.returned > 0


def test_every_attack_can_be_flown() -> None:
    """Its vector's entries are 0 and 1, too: mutations are clipped there."""
    random, start, size = Random(1), base(12.0), len(team_cases()[0])
    for number in range(60):
        vector = tuple(random.choice((0.0, 1.0, random.random())) for _ in range(size))
        attack = Candidate(number=number, kind="team", vector=vector, seed=number)
        check_scenario(decode_team(attack, start, SearchLimits()))


def test_a_scenario_without_a_team_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"escort: no \[team\]; allowed with --team"):
        team_base(load_scenario("escort"), SearchLimits())


def test_command_counts_and_refuses_other_engines(here, command) -> None:
    quick = words("falsify scouts --team --runs 2 --duration 6 --jobs 1 --json --expect none")
    run = command(*quick, "--set", "area.cell=0.5")
    assert run.returncode == 0, run.stderr
    output = json.loads(run.stdout)
    assert (output["runs"], output["violations"], output["scenario"]) == (2, 0, None)
    assert (output["ticks"], output["uavs"], output["guards"]) == (240, 3, 1)
    assert not list(here.iterdir())
    refused = command("falsify", "scouts", "--team", "--engine", "attack")
    assert refused.returncode == 2
    assert "--team: excludes --engine" in refused.stderr
