"""The search for violations.

It finds what is known to be wrong, breaks nothing that is known to hold, and each find can be flown again.
"""

import json
import math
import os
import signal
import subprocess
import time
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from bus.errors import PeerLost
from bus.messages.decision import NotCertified
from bus.messages.links import LinkKind
from bus.messages.vehicle import UavCommand, UavObservation
from flights import R_S, R_V, Piloted, distances
from outrider.running.flying import fly, make_pilots
from outrider_falsify import attacks, search
from outrider_falsify import candidate as flying
from outrider_falsify.candidate import flown, guaranteed
from outrider_falsify.conditions import Conditions, declared
from outrider_falsify.engines import SearchRequest, SearchResult, save
from outrider_falsify.engines import search as search_both
from outrider_falsify.genome import SIZES, Candidate, decode, proof_cases
from outrider_falsify.limits import SearchLimits, base_of, beyond_declared, needed_age
from outrider_falsify.pool import Workers
from processes import OUTRIDER, PIPES
from sim.scenario.checks import check_scenario
from sim.scenario.loading import load_scenario, shipped_text
from sim.scenario.resolved import as_toml
from sim.scenario.types import Scenario
from sim.server.flight import Flight
from tabular import words

DEGRADED = SearchLimits(delay=1.0, loss=0.3, blackout=5.0, noise=0.1, command_delay=0.5)
QUICK = {"duration": 25.0}
UNDEGRADED = SearchLimits()


def base(law: str, limits: SearchLimits = UNDEGRADED, **changes: Any) -> Scenario:
    return base_of(load_scenario("escort", overrides={"law.name": law, **QUICK, **changes}), limits)


def found(
    law: str, runs: int | None, limits: SearchLimits = UNDEGRADED, **wanted: Any
) -> SearchResult:
    changes = wanted.pop("changes", {})
    budget = {"flies": True, "attacks": False, "runs": runs} | wanted
    result = SearchResult(SearchRequest(base=base(law, limits, **changes), limits=limits, **budget))
    search_both(result, asked=lambda: False, on_run=lambda *_: None)
    return result


def candidates(count: int) -> list[Candidate]:
    chances = islice(search._chances(3), len(proof_cases()) + count)
    return [
        Candidate(number=k, kind=kind, vector=x, seed=seed)
        for k, (kind, x, seed) in enumerate(chances)
    ]


# Finds, and their absence


def test_switching_law_fails_undegraded_and_refly_is_identical(tmp_path):
    path = tmp_path / "broken.toml"
    result = found("switching", 3, out=path, changes={"duration": 60.0})
    assert result.violations
    assert result.worst > R_V + 0.01
    save(result)
    flight, summary = fly(load_scenario(path), load_scenario(path).seed)
    assert summary.max_distance == result.worst
    assert summary.trajectory_sha256 == result.sha256 == flight.recorder.sha256()
    assert f"{summary.max_distance:.4f} m" in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("law", ["logarithmic", "linear"])
def test_laws_that_keep_sight_undegraded_are_not_broken(law: str) -> None:
    result = found(law, 12)
    assert result.violations == result.lost == 0
    assert 2.0 < result.worst < R_V


def test_blackouts_and_late_commands_break_the_logarithmic_law() -> None:
    for limits in (SearchLimits(blackout=5.0), SearchLimits(command_delay=1.0)):
        assert found("logarithmic", 16, limits).worst > R_V + 0.05


def test_the_certified_law_stands_within_its_limits() -> None:
    result = found("certified", 12, DEGRADED)
    assert result.violations == result.lost == 0
    assert result.flights.certified_while_lost == result.flights.certificate_broken == 0
    assert result.worst > 4.0


def test_declared_error_covers_noise_at_the_greatest_slant_range() -> None:
    base = base_of(load_scenario("town"), SearchLimits(noise=0.05))
    largest = 3.0 * 0.05 * math.hypot(16.0, 5.0) / 10.0
    assert base.certificate.max_measurement_error == pytest.approx(largest)
    assert beyond_declared(base, SearchLimits(noise=0.05)) == ()


BROKEN = {
    "max_measurement_age": (
        SearchLimits(delay=1.0, blackout=5.0),
        {"certificate.max_measurement_age": 1.1},
    ),
    "max_measurement_error": (SearchLimits(noise=0.3), {"certificate.max_measurement_error": 0.05}),
    "max_command_delay": (SearchLimits(command_delay=1.0), {"certificate.max_command_delay": 0.0}),
}
"""Limits beyond the declared bounds."""


@pytest.mark.parametrize("name", BROKEN)
def test_broken_assumption_is_reported_and_is_no_violation(name: str) -> None:
    limits, declared = BROKEN[name]
    warnings = beyond_declared(base("certified", limits, **declared), limits)
    assert len(warnings) == 1
    assert f"certificate.{name}" in warnings[0]
    result = found("certified", 6, limits, changes=declared)
    assert result.flights.uncertified > 0
    assert result.violations == 0


def test_guarantee_starts_certified_and_resumes_after_a_gap() -> None:
    certified = np.array([False, True, True, False, True, True, True, True], dtype=np.bool_)
    assert guaranteed(certified, 2).tolist() == [
        False,
        False,
        True,
        True,
        False,
        False,
        False,
        True,
        True,
    ]
    assert not guaranteed(np.zeros(3, dtype=np.bool_), 0).any()


def test_certified_tick_out_of_sight_after_a_gap_is_a_violation(monkeypatch):
    """Fly away while single ticks, too few for a guarantee, are certified."""

    def fly_off(scenario, seed, *, on_tick):
        flight, pilots = Flight(scenario, seed), make_pilots(scenario, seed)

        def act(seen: UavObservation) -> UavCommand:
            command = pilots["uav_0"].act(seen)
            reason = None if seen.tick % 10 == 9 else NotCertified.NO_PLAN
            decision = msgspec.structs.replace(command.report.decision, reason=reason)
            report = msgspec.structs.replace(command.report, decision=decision)
            return msgspec.structs.replace(
                command, acceleration=(0.3, 0.3), backup_trajectories=(), report=report
            )

        flight.fly(Piloted(pilots, "uav_0", act), on_tick=lambda: on_tick(flight))
        return flight, None

    monkeypatch.setattr(flying, "fly", fly_off)
    candidate = next(one for one in candidates(8) if one.kind != "adversary")
    _, flight, result = flown(candidate, base("certified"), UNDEGRADED)
    lost = distances(flight) >= R_V
    lies = int(lost[9:-1:10].sum() + lost[-1])  # also at the last state
    assert result.certified_while_lost == lies > 5
    assert result.violated
    assert result.score >= R_V
    tally = search.Tally()
    tally.take(candidate, result)
    tally.take(candidate, result)
    wanted = SearchRequest(base=base("certified"), limits=UNDEGRADED, flies=True, attacks=False)
    counts = SearchResult(wanted, flights=tally).as_plain()["flights"]
    assert (counts["violations"], counts["certified_while_lost"]) == (2, 2 * lies)
    assert counts["certificate_broken"] == 2 * result.certificate_broken


# Candidates


@pytest.mark.parametrize("law", ["switching", "certified"])
def test_every_candidate_can_be_flown_and_is_within_the_limits(law: str) -> None:
    start = base(law, DEGRADED)
    for candidate in candidates(60):
        scenario = check_scenario(decode(candidate, start, DEGRADED))
        uav, ugv, link = scenario.uav[0], scenario.ugv[0], scenario.links.detections
        assert math.hypot(*uav.velocity) <= uav.max_speed
        assert math.hypot(*ugv.velocity) <= ugv.max_speed
        assert all(math.hypot(*step.velocity) <= ugv.max_speed for step in ugv.script)
        outward = (math.hypot(*uav.velocity) + ugv.max_speed) ** 2 / (2.0 * uav.max_acceleration)
        assert math.dist(uav.position, ugv.position) + outward <= R_S + 0.01
        assert link.delay + link.jitter <= DEGRADED.delay + 1e-9
        assert link.loss <= DEGRADED.loss
        assert all(length <= DEGRADED.blackout for _, length in link.blackouts)
        assert scenario.detections.noise <= DEGRADED.noise
        assert scenario.links.of("uav_0", LinkKind.COMMANDS).delay <= DEGRADED.command_delay
        assert scenario.links.of("ugv_0", LinkKind.COMMANDS).delay == 0.0


def test_a_saved_scenario_is_the_same_scenario(tmp_path: Path) -> None:
    for k, candidate in enumerate(candidates(12)[-14:]):
        title = 'a "quoted" \\ title, ü'
        scenario = msgspec.structs.replace(
            decode(candidate, base("certified", DEGRADED), DEGRADED), name=f"c{k}", title=title
        )
        path = tmp_path / f"c{k}.toml"
        path.write_text(as_toml(scenario, ["two\nlines"]), encoding="utf-8")
        assert load_scenario(path) == scenario


@pytest.mark.parametrize("kind", SIZES)
def test_a_candidate_flies_again_from_its_saved_scenario(kind: str, tmp_path: Path) -> None:
    candidate = [one for one in candidates(2) if one.kind == kind][-1]
    scenario, flight, _ = flown(candidate, base("certified", DEGRADED), DEGRADED)
    path = tmp_path / "again.toml"
    path.write_text(as_toml(scenario, []), encoding="utf-8")
    assert fly(load_scenario(path), candidate.seed)[0].recorder.sha256() == flight.recorder.sha256()


def test_base_declares_needed_bounds_and_keeps_declared_ones() -> None:
    start = base("certified", DEGRADED)
    assert start.certificate.max_measurement_age == needed_age(DEGRADED, start) > 6.0
    assert start.certificate.max_measurement_error == pytest.approx(0.3)
    assert beyond_declared(start, DEGRADED) == ()
    assert (
        base(
            "certified", DEGRADED, **{"certificate.max_measurement_age": 3.0}
        ).certificate.max_measurement_age
        == 3.0
    )


def test_command_timeout_is_raised_for_late_commands() -> None:
    late = SearchLimits(command_delay=1.01)
    start = base("linear", late)
    assert start.command_timeout == pytest.approx(1.05)
    assert base("linear", late, command_timeout=2.0).command_timeout == 2.0
    assert base("linear", SearchLimits(command_delay=0.5)).command_timeout == 0.5
    for candidate in candidates(20):
        check_scenario(decode(candidate, start, late))


# The search


def test_the_search_is_the_same_for_any_number_of_workers() -> None:
    limits, short = SearchLimits(noise=0.05, blackout=1.0), {"duration": 2.0}
    one, two = (found("switching", 70, limits, jobs=jobs, changes=short) for jobs in (1, 2))
    assert one.flights.elite == two.flights.elite
    assert (one.runs, one.violations) == (two.runs, two.violations) == (70, one.violations)
    other = found("switching", 40, limits, seed=2, changes=short)
    assert other.flights.elite != one.flights.elite


def test_cma_continues_from_the_best_and_keeps_numpys_rng_state() -> None:
    np.random.seed(5)  # noqa: NPY002
    expected = np.random.RandomState(5).random(3)
    result = found("linear", 100, changes={"duration": 6.0})
    assert np.array_equal(np.random.random(3), expected)  # noqa: NPY002
    first = max(
        flown(one, base("linear", duration=6.0), SearchLimits())[2].score for one in candidates(0)
    )
    assert result.worst > first
    # the first two batches are random
    assert all(candidate.number >= 64 for candidate, _ in result.flights.elite)


def test_the_budget_is_kept() -> None:
    assert found("linear", 37, changes={"duration": 2.0}).runs == 37
    began = time.monotonic()
    result = found(
        "linear", None, minutes=0.03
    )  # the workers also need time to start on a busy machine
    assert 1.5 < time.monotonic() - began < 40.0
    assert result.runs > 0


def test_dead_worker_is_reported_in_one_line() -> None:
    with Workers(2, int) as workers, pytest.raises(PeerLost, match="a worker process died"):
        list(workers.stream(os._exit, [(3,)], lambda: False))


# The attack


def attacked(control, runs, *, duration=40.0, first=False, **wanted):
    tally = attacks.AttackTally()
    budget = search.Budget(runs, None, lambda: first and tally.violations > 0)
    with Workers(1, attacks.warm) as workers:
        attacks.run_attack(workers, budget, tally, control=control, duration=duration, **wanted)
    return tally


def test_the_attack_finds_nothing_within_the_assumptions() -> None:
    tally = attacked(None, 60)
    assert (tally.runs, tally.violations, tally.lost, tally.uncertified) == (60, 0, 0, 0)
    assert tally.combinations == 60
    assert tally.excess <= 1e-9
    assert tally.worst is not None
    assert 4.0 < tally.worst.worst_distance < R_V


@pytest.mark.parametrize("control", ["tracking", "paper-radius", "switching"])
def test_wrong_safety_filter_is_caught_and_its_run_reflies(control: str) -> None:
    tally = attacked(control, 100, first=True, duration=120.0)
    assert tally.violations
    assert tally.worst is not None
    namespace: dict[str, Any] = {}
    statements, _, expression = attacks.again(tally.worst, 1).rpartition("; ")
    exec(statements, namespace)  # noqa: S102
    row = eval(expression, namespace)  # noqa: S307
    assert row["max_distance"] == tally.worst.worst_distance >= R_V


def test_the_best_detection_is_caught_where_there_are_blackouts() -> None:
    conditions = Conditions(blackout=1, blackout_time=10.0)
    bounds = declared(conditions, 0.9)
    assert attacks.fly_attack(
        bounds, attacks._guarded("argmin", bounds, conditions), None, 1, 0, 60, 200.0
    ).violations


def test_combination_with_uncertified_ticks_has_no_violation() -> None:
    conditions = Conditions(blackout=1, blackout_time=12.0)
    bounds = declared(conditions._replace(blackout_time=2.0), 0.3)
    result = attacks.fly_attack(bounds, conditions, None, 1, 0, 20, 100.0)
    assert result.uncertified == 20
    assert result.violations == 0


# The command line


def test_command_saves_the_find_and_reports_it_by_exit_code(here, command):
    quick = words("--limit none --duration 25 --jobs 1 --runs 3 --json --expect none")
    run = command("falsify", "--law", "switching", *quick)
    assert run.returncode == 1
    output = json.loads(run.stdout)
    assert set(words("law runs violations worst_distance scenario seconds seed")) <= set(output)
    found = (output["law"], output["runs"], output["scenario"])
    assert found == ("switching", 3, "counterexample-switching.toml")
    assert "--expect none" in run.stderr
    again = command("run", output["scenario"], "--in-process", "--no-files", "--json")
    flown_again = json.loads(again.stdout)
    assert flown_again["max_distance"] == output["worst_distance"]
    assert flown_again["trajectory_sha256"] == output["trajectory_sha256"]


def test_nothing_found_is_no_file_and_exit_code_0(here, command):
    quick = words("falsify --law linear --limit none --duration 5 --jobs 1 --runs 2 --json")
    run = command(*quick, "--expect", "none")
    assert run.returncode == 0
    output = json.loads(run.stdout)
    assert (output["violations"], output["scenario"]) == (0, None)
    assert command(*quick, "--expect", "some").returncode == 1
    assert not list(here.iterdir())


def test_ctrl_c_keeps_the_best(tmp_path: Path) -> None:
    arguments = words("falsify --law switching --limit none --minutes 5 --jobs 1 --json")
    process = subprocess.Popen([*OUTRIDER, *arguments], cwd=tmp_path, **PIPES)
    assert process.stderr is not None
    while "runs" not in process.stderr.readline():  # the first line of progress
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted after" in err
    assert "Traceback" not in err
    output = json.loads(out)
    assert output["violations"] > 0
    assert (tmp_path / output["scenario"]).exists()


def test_a_search_asks_before_it_loads_code_of_a_file(here, command) -> None:
    (here / "theirs.py").write_text("from pathlib import Path\nPath('loaded').touch()\n")
    text = shipped_text("escort").replace('driver = "waypoints"', 'driver = "policy"')
    (here / "theirs.toml").write_text(f'{text}\n[custom]\npolicy = "theirs:policy"\n')
    refused = command("falsify", "theirs.toml")
    assert (refused.returncode, "--allow-code" in refused.stderr) == (2, True)
    assert not (here / "loaded").exists()
