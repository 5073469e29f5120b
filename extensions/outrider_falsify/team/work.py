"""Work of `outrider falsify --team`: base scenario, search, report and file."""

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import typer

from bus.errors import PeerLost, ScenarioError
from bus.files import create_unused, writing
from bus.plugins import require
from outrider.cli.console import ERR, OUT, print_json, print_warnings, runs_bar
from outrider.cli.stopping import stop_on_signals
from outrider.running.warming import warm_up_flight
from outrider_falsify.limits import SearchLimits, beyond_declared, check_bounds, declared_base
from outrider_falsify.options import FLIGHT, TEAM_DEFAULTS, Expect, limits_of
from outrider_falsify.pool import Workers
from outrider_falsify.search import Budget, run_search
from outrider_falsify.team.candidate import TEAMS, TeamResult, TeamTally, attacked, repeated
from outrider_falsify.team.events import Events
from outrider_falsify.team.plan_file import attack_toml, read_attack
from outrider_falsify.work import flown_scenario
from sim.scenario.team import briefed_team
from sim.scenario.types import Scenario

_LINE = 10.0
"""Interval between two progress lines without a terminal [s]; the first violation prints one at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamOptions:
    """Options that change the scenario, as given."""

    law: str | None = None
    limit: list[str] | None = None
    duration: float | None = None
    changes: list[str] | None = None
    allow_code: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamBudget:
    """Extent of a search."""

    runs: int | None = None
    minutes: float | None = None
    seed: int = 1
    jobs: int = 1
    out: Path | None = None
    """File of the counterexample."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TeamRequest:
    """Parameters of a search."""

    base: Scenario
    limits: SearchLimits
    budget: TeamBudget


@dataclass(slots=True)
class TeamFound:
    """Result of a search."""

    wanted: TeamRequest
    tally: TeamTally = field(default_factory=TeamTally)
    seconds: float = 0.0
    path: Path | None = None
    """Path of the counterexample."""
    events: int = 0
    sha256: str | None = None
    """Hash of its trajectory."""

    def as_plain(self) -> dict[str, Any]:
        """Return the result as JSON data."""
        wanted, tally = self.wanted, self.tally
        return {
            "team": True,
            "law": wanted.base.law.name,
            "guards": wanted.base.team.guards if wanted.base.team else None,
            "uavs": len(wanted.base.uav),
            "runs": tally.runs,
            "violations": tally.violations,
            "certified_while_lost": tally.certified_while_lost,
            "certificate_broken": tally.certificate_broken,
            **asdict(tally.counts),
            "farthest_guard_share": tally.farthest / wanted.base.visibility.radius,
            "leash_time_share": tally.slowest,
            "scenario": None if self.path is None else str(self.path),
            "trajectory_sha256": self.sha256,
            "seconds": round(self.seconds, 3),
            "seed": wanted.budget.seed,
        }


def run_command(
    source: str, how: TeamOptions, budget: TeamBudget, expect: Expect | None, *, json: bool
) -> None:
    """Search for a violation, or repeat the attack of a file; errors as in `falsify_team` and `team_base`."""
    recorded = read_attack(source)
    if recorded is not None:
        attack_again(*recorded, expect, json=json)
        return
    flown = flown_scenario(
        source,
        law=how.law,
        duration=FLIGHT if how.duration is None else how.duration,
        changes=how.changes,
        allow_code=how.allow_code,
    )
    limits = SearchLimits(**limits_of(how.limit, flown.detections.noise, TEAM_DEFAULTS))
    wanted = TeamRequest(base=team_base(flown, limits), limits=limits, budget=budget)
    falsify_team(wanted, expect, json=json)


def team_base(scenario: Scenario, limits: SearchLimits) -> Scenario:
    """Return the base scenario of every attack.

    Raises:
        ScenarioError: If it has no team, or several, or nothing can be certified within these limits.
    """
    if scenario.team is None:
        raise ScenarioError(
            f"{scenario.name}: no [team]; allowed with --team: a scenario of a team"
        )
    if len(scenario.ugv) != 1 or len(scenario.uav) < 2:
        raise ScenarioError(
            f"{scenario.name}: {len(scenario.uav)} UAVs and {len(scenario.ugv)} UGVs; allowed with --team: "
            "2 UAVs or more, and one UGV"
        )
    require("falsify")
    base = declared_base(scenario, limits)
    check_bounds(base, limits)
    print_warnings(beyond_declared(base, limits))
    # the longest leash differs between the candidates: all fly the same
    return msgspec.structs.replace(base, team=briefed_team(base, base.uav[0]))


def search_team(
    found: TeamFound, *, asked: Callable[[], bool], on_run: Callable[[float], None]
) -> None:
    """Search until the budget is used up; results are counted as they arrive.

    Args:
        found: Empty result, updated in place.
        asked: Return true to stop the search.
        on_run: Progress callback: used share of the budget.

    Raises:
        PeerLost: If a worker process dies.
    """
    wanted, began = found.wanted, time.monotonic()
    given = wanted.budget
    budget = Budget(given.runs, None if given.minutes is None else 60.0 * given.minutes, asked)
    try:
        with Workers(given.jobs, warm_up_flight) as workers:
            run_search(
                workers,
                budget,
                found.tally,
                base=wanted.base,
                limits=wanted.limits,
                seed=given.seed,
                on_run=lambda: on_run(budget.share(found.tally.runs)),
                space=TEAMS,
            )
    finally:
        found.seconds = time.monotonic() - began


def save_attack(found: TeamFound) -> None:
    """Fly the worst violation again and save it; without a violation nothing is saved.

    Raises:
        OSError: If the file cannot be written.
    """
    wanted = found.wanted
    if not found.tally.violations:
        return
    scenario, events, flight, result = attacked(found.tally.elite[0][0], wanted.base, wanted.limits)
    path = wanted.budget.out or create_unused(Path("counterexample-team.toml"))
    title = (
        f"A team's guarantee is broken: found by outrider falsify --team, seed {wanted.budget.seed}"
    )
    saved = msgspec.structs.replace(scenario, name=path.stem, title=title)
    with writing(path):
        path.write_text(
            attack_toml(saved, events, [*_verdict(result), _repeat(path)]), encoding="utf-8"
        )
    found.path, found.events, found.sha256 = path, len(events), flight.recorder.sha256()


def _repeat(path: Path) -> str:
    return f"outrider falsify {path} --team repeats it"


def _verdict(result: TeamResult) -> Iterator[str]:
    counts = result.counts
    found = {
        "ticks certified while no UAV sees the UGV": counts.team_certified_while_lost,
        "ticks in which a UAV with one of the largest numbers does not guard": counts.team_certificate_broken,
        "ticks without a certified guard before g losses": counts.unguarded,
        "scouts that did not see the UGV in the time of the leash": counts.leash_missed,
        "ticks certified while the UAV does not see the UGV": result.certified_while_lost,
        "certificates lost although all assumptions held": result.certificate_broken,
    }
    yield from (f"{what}: {count:,}" for what, count in found.items() if count)


def attack_again(scenario: Scenario, events: Events, expect: Expect | None, *, json: bool) -> None:
    """Repeat the attack of a file and print its verdict.

    Raises:
        Exit: If the verdict is not the expected one.
    """
    flight, result = repeated(scenario, events)
    sha256 = flight.recorder.sha256()
    if json:
        plain = {"violated": result.violated, **asdict(result.counts), "trajectory_sha256": sha256}
        print_json({"team": True, "events": len(events), **plain})
    else:
        OUT.tell(f"{scenario.name}: {len(events):,} events, hash {sha256}")
        for line in _verdict(result):
            OUT.tell(f"  {line}")
        if not result.violated:
            OUT.tell("  no violation")
    if expect is not None and result.violated is (expect == "none"):
        raise typer.Exit(1)


def falsify_team(wanted: TeamRequest, expect: Expect | None, *, json: bool) -> None:
    """Search, print the result and save the worst violation.

    Raises:
        Exit: If a signal ended the search, or the result is not the expected one.
        PeerLost: If a worker failed; the result so far is printed.
    """
    found, fault = TeamFound(wanted), None
    with stop_on_signals() as stop:
        try:
            _search_with_progress(found, lambda: bool(stop))
        except PeerLost as error:  # print the result so far first
            fault = error
        save_attack(found)
    if json:
        print_json(found.as_plain())
    else:
        for line in _lines(found):
            OUT.tell(line)
    if fault is not None:
        raise fault
    runs, violations = found.tally.runs, found.tally.violations
    if stop:
        ERR.tell(f"outrider: interrupted after {runs:,} runs; results so far are printed")
        raise typer.Exit(stop.exit_code)
    if expect is not None and not runs:
        ERR.tell(f"outrider: --expect {expect}: time ran out before the first run")
        raise typer.Exit(1)
    if expect is not None and (violations > 0) is (expect == "none"):
        ERR.tell(f"outrider: --expect {expect}: {violations:,} of {runs:,} runs are violations")
        raise typer.Exit(1)


def _search_with_progress(found: TeamFound, asked: Callable[[], bool]) -> None:
    """Search with a progress bar on a terminal, otherwise a line at intervals."""
    began = printed = time.monotonic()
    shown = 0
    with runs_bar(width=30) as progress:
        task = progress.add_task("team", total=1.0, note="")

        def show(share: float) -> None:
            nonlocal printed, shown
            tally, now = found.tally, time.monotonic()
            c = tally.counts
            note = (
                f"{tally.runs:,} runs, {tally.runs / max(now - began, 1e-9):.1f} runs/s, {c.deaths:,} deaths, "
                f"{c.handovers:,} hand-overs, farthest guard {_share(found):.4f} r_v, {tally.violations:,} violations"
            )
            progress.update(task, completed=min(1.0, share), note=note)
            if not ERR.is_terminal and (now - printed >= _LINE or (tally.violations and not shown)):
                printed, shown = now, tally.violations
                ERR.tell(f"team: {note}")

        search_team(found, asked=asked, on_run=show)


def _share(found: TeamFound) -> float:
    return found.tally.farthest / found.wanted.base.visibility.radius


def _lines(found: TeamFound) -> Iterator[str]:
    """Yield the lines of the printed result."""
    tally, base = found.tally, found.wanted.base
    c, guards = tally.counts, base.team.guards if base.team else 0
    rate = tally.runs / found.seconds if found.seconds > 0.0 else 0.0
    yield (
        f"team of {len(base.uav)} UAVs, {guards} to guard: {tally.violations:,} violations in {tally.runs:,} runs, "
        f"{found.seconds:.1f} s, {rate:.1f} runs/s"
    )
    yield f"  of {c.ticks:,} ticks, with a certified guard: {c.certified / max(1, c.ticks):.2%}"
    yield f"    certified while no UAV sees the UGV: {c.team_certified_while_lost:,} ticks"
    yield f"    a UAV with one of the {guards} largest numbers does not guard: {c.team_certificate_broken:,} ticks"
    yield f"    without a certified guard before {guards} losses: {c.unguarded:,} ticks; after them: {c.excused:,}"
    yield f"    certificates lost although all assumptions held: {tally.certificate_broken:,}"
    yield f"  scouts that turned back: {c.returned:,}; too late for the leash: {c.leash_missed:,}"
    yield f"  farthest certified guard: {_share(found):.4f} r_v; slowest scout: {tally.slowest:.4f} of the leash's time"
    yield (
        f"  {c.handovers:,} hand-overs, {c.deaths:,} deaths, {c.blackouts:,} blackouts, {c.requests:,} requests, "
        f"{c.left_without_relief:,} guards left without relief"
    )
    if found.path is not None:
        yield f"  {found.path}: {found.events:,} events; {_repeat(found.path)}: {found.sha256}"
