"""Search with both engines under one budget: simulated scenarios and, for `certified`, the compiled attack."""

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from bus.files import create_unused, writing
from outrider.running.warming import warm_up_flight
from outrider_falsify.attacks import AttackTally, again, run_attack
from outrider_falsify.attacks import warm as warm_attack
from outrider_falsify.candidate import flown
from outrider_falsify.description import describe
from outrider_falsify.limits import SearchLimits
from outrider_falsify.pool import Workers
from outrider_falsify.search import Budget, Tally, run_search
from sim.scenario.checks import check_scenario
from sim.scenario.resolved import as_toml
from sim.scenario.types import Scenario

_SHARE, _LEAST = 100, 32
"""With both engines, one run in _SHARE is a simulated scenario, but at least _LEAST are."""
_SHARE_OF_TIME = 1.0 / 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRequest:
    """Parameters of a search."""

    base: Scenario
    limits: SearchLimits
    flies: bool
    """True to search scenarios."""
    attacks: bool
    """True to run the compiled attack."""
    runs: int | None = None
    minutes: float | None = None
    attack_duration: float = 200.0
    """Duration of an attack's run [s]."""
    seed: int = 1
    jobs: int = 1
    altitude: bool = False
    """True to attack a UAV that dives and climbs over towns."""
    control: str | None = None
    """Faulty guard to expose, a row of `CONTROLS`."""
    eps: float | None = None
    """Restriction of the attack to one detection error [m]."""
    out: Path | None = None


@dataclass(slots=True)
class SearchResult:
    """Result of a search."""

    wanted: SearchRequest
    flights: Tally = field(default_factory=Tally)
    attacks: AttackTally = field(default_factory=AttackTally)
    seconds: float = 0.0
    path: Path | None = None
    """Path of the counterexample."""
    description: list[str] = field(default_factory=list)
    sha256: str | None = None
    """Hash of its trajectory."""

    @property
    def runs(self) -> int:
        """Return the runs of both engines."""
        return self.flights.runs + self.attacks.runs

    @property
    def violations(self) -> int:
        """Return the violations of both engines."""
        return self.flights.violations + self.attacks.violations

    @property
    def lost(self) -> int:
        """Return the runs of both engines in which the UGV was lost at any state."""
        return self.flights.lost + self.attacks.lost

    @property
    def worst(self) -> float:
        """Return the largest distance with guaranteed visibility [m], of both engines."""
        attacked = self.attacks.worst
        return max(self.flights.worst, 0.0 if attacked is None else attacked.worst_distance)

    @property
    def attack_again(self) -> str | None:
        """Return Python that repeats the attack's worst run, if it is a violation."""
        attacked, wanted = self.attacks.worst, self.wanted
        if attacked is None or not self.attacks.violations:
            return None
        return again(attacked, wanted.seed)

    def as_plain(self) -> dict[str, Any]:
        """Return the result as JSON data."""
        wanted, attacks = self.wanted, self.attacks
        return {
            "law": wanted.base.law.name,
            "control": wanted.control,
            "altitude": wanted.altitude,
            "runs": self.runs,
            "violations": self.violations,
            "lost": self.lost,
            "worst_distance": self.worst if self.runs else None,
            "visibility_radius": wanted.base.visibility.radius,
            "scenario": None if self.path is None else str(self.path),
            "trajectory_sha256": self.sha256,
            "seconds": round(self.seconds, 3),
            "runs_per_second": round(self.runs / self.seconds, 3) if self.seconds > 0.0 else 0.0,
            "seed": wanted.seed,
            "flights": {
                "runs": self.flights.runs,
                "violations": self.flights.violations,
                "lost": self.flights.lost,
                "uncertified": self.flights.uncertified,
                "certified_while_lost": self.flights.certified_while_lost,
                "certificate_broken": self.flights.certificate_broken,
                "worst_distance": self.flights.worst or None,
            },
            "attack": {
                "runs": attacks.runs,
                "combinations": attacks.combinations,
                "violations": attacks.violations,
                "certificate_broken": attacks.broken,
                "kinds": {
                    name: {
                        "runs": one.runs,
                        "certified_while_lost": one.violations,
                        "certificate_broken": one.broken,
                        "lost": one.lost,
                        "uncertified_share": one.uncertified / one.runs,
                    }
                    for name, one in sorted(attacks.kinds.items())
                },
                "lost": attacks.lost,
                "uncertified": attacks.uncertified,
                "worst_distance": None if attacks.worst is None else attacks.worst.worst_distance,
                "again": self.attack_again,
            },
        }


def search(
    found: SearchResult, *, asked: Callable[[], bool], on_run: Callable[[str, float], None]
) -> None:
    """Search until the budget is used up; results are counted as they arrive.

    Args:
        found: Empty result, updated in place.
        asked: Return true to stop the search.
        on_run: Progress callback: name of the engine, used share of its budget.

    Raises:
        PeerLost: If a worker process dies.
    """
    wanted, began = found.wanted, time.monotonic()

    def ends() -> bool:
        return asked()

    try:
        if wanted.flies:
            _fly(found, ends, on_run)
        if wanted.attacks and not ends():
            _attack(found, ends, on_run, began)
    finally:
        found.seconds = time.monotonic() - began


def _fly(
    found: SearchResult, ends: Callable[[], bool], on_run: Callable[[str, float], None]
) -> None:
    wanted = found.wanted
    runs, minutes = wanted.runs, wanted.minutes
    if wanted.attacks:
        runs = None if runs is None else min(runs, max(_LEAST, runs // _SHARE))
        minutes = None if minutes is None else minutes * _SHARE_OF_TIME
    budget = Budget(runs, None if minutes is None else 60.0 * minutes, ends)
    with Workers(wanted.jobs, warm_up_flight) as workers:
        run_search(
            workers,
            budget,
            found.flights,
            base=wanted.base,
            limits=wanted.limits,
            seed=wanted.seed,
            on_run=lambda: on_run("flights", budget.share(found.flights.runs)),
        )


def _attack(
    found: SearchResult,
    ends: Callable[[], bool],
    on_run: Callable[[str, float], None],
    began: float,
) -> None:
    wanted, tally = found.wanted, found.attacks
    runs = None if wanted.runs is None else wanted.runs - found.flights.runs
    if runs == 0:
        return
    budget = Budget(
        runs,
        None if wanted.minutes is None else 60.0 * wanted.minutes - (time.monotonic() - began),
        ends,
    )
    with Workers(wanted.jobs, functools.partial(warm_attack, altitude=wanted.altitude)) as workers:
        run_attack(
            workers,
            budget,
            tally,
            control=wanted.control,
            eps=wanted.eps,
            seed=wanted.seed,
            duration=wanted.attack_duration,
            altitude=wanted.altitude,
            on_task=lambda: on_run("attack", budget.share(tally.runs)),
        )


def save(found: SearchResult) -> None:
    """Simulate the worst violation again, describe it, and save it as a scenario.

    Without a violation nothing is saved.

    Raises:
        OSError: If the file cannot be written.
    """
    wanted = found.wanted
    if not found.flights.violations:
        return
    scenario, flight, _ = flown(found.flights.elite[0][0], wanted.base, wanted.limits)
    found.description, found.sha256 = describe(scenario, flight), flight.recorder.sha256()
    path = wanted.out or create_unused(Path(f"counterexample-{scenario.law.name}.toml"))
    title = (
        f"The law {scenario.law.name} loses sight: found by outrider falsify, seed {wanted.seed}"
    )
    saved = check_scenario(msgspec.structs.replace(scenario, name=path.stem, title=title))
    with writing(path):
        path.write_text(as_toml(saved, found.description), encoding="utf-8")
    found.path = path
