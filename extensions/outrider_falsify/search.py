"""Search over scenarios: critical cases of the proofs, random samples, then CMA-ES on the largest distance.

Candidates depend on the seed and on the ordered results, not on the number of processes.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import count, islice
from typing import Any, NamedTuple

import numpy as np

from outrider_falsify.candidate import CandidateResult, fly_candidate
from outrider_falsify.genome import SIZES, Candidate, proof_cases
from outrider_falsify.limits import SearchLimits
from outrider_falsify.pool import Workers
from sim.scenario.types import Scenario

_EXPLORED = 0.35
"""Share of the budget after which the best candidates are improved."""
_ISLANDS, _POPULATION = 2, 16
_SPREAD, _NEW_SPREAD = 0.15, 0.3
"""Standard deviation of the first generation, and of the first generation after a restart."""
_ELITE = 8


class SearchSpace(NamedTuple):
    """Candidates that are searched."""

    sizes: dict[str, int]
    """Number of parameters of each kind; the critical cases are of the first kind."""
    cases: list[list[float]]
    """Critical cases."""
    fly: Callable[[Candidate, Scenario, SearchLimits], CandidateResult]
    """Simulation of a candidate in a worker: a function of a module."""


PAIRS = SearchSpace(SIZES, proof_cases(), fly_candidate)
"""Flights of one UAV and one UGV."""


class Budget:
    """Limit on runs and time; the search stops at the first one reached.

    Args:
        runs: Number of runs; None: unlimited.
        seconds: Wall time; None: unlimited.
        asked: Return true to stop early.
    """

    def __init__(
        self, runs: int | None, seconds: float | None, asked: Callable[[], bool] = lambda: False
    ) -> None:
        self.runs, self._seconds, self._asked = runs, seconds, asked
        self._began = time.monotonic()

    @property
    def elapsed(self) -> float:
        """Return the time since the start [s]."""
        return time.monotonic() - self._began

    def share(self, runs: int) -> float:
        """Return the share of the budget used after this number of runs."""
        of_runs = runs / self.runs if self.runs else 0.0
        return max(of_runs, self.elapsed / self._seconds if self._seconds else 0.0)

    def ends(self) -> bool:
        """Return true if the search must stop: time is up, or a stop was requested."""
        return self._asked() or (self._seconds is not None and self.elapsed >= self._seconds)

    def left(self, runs: int) -> int | None:
        """Return the remaining runs; None: unlimited."""
        return None if self.runs is None else max(0, self.runs - runs)


@dataclass(slots=True)
class Tally:
    """Running counters of a search."""

    runs: int = 0
    violations: int = 0
    """Runs that lost the UGV at a state with guaranteed visibility."""
    lost: int = 0
    """Runs that lost the UGV at any state."""
    uncertified: int = 0
    """Runs with a gap in the certificate."""
    certified_while_lost: int = 0
    """Ticks certified while the UGV was out of sight, summed over the runs."""
    certificate_broken: int = 0
    """Ticks that lost the certificate although all assumptions held, summed over the runs."""
    elite: list[tuple[Candidate, CandidateResult]] = field(default_factory=list)
    """Best candidates, by the largest distance with guaranteed visibility."""

    @property
    def worst(self) -> float:
        """Return the largest distance with guaranteed visibility [m]; 0 before the first run."""
        return self.elite[0][1].score if self.elite else 0.0

    def take(self, candidate: Candidate, result: CandidateResult) -> None:
        """Add the result of a run."""
        self.runs += 1
        self.violations += result.violated
        self.lost += result.lost
        self.uncertified += result.uncertified
        self.certified_while_lost += result.certified_while_lost
        self.certificate_broken += result.certificate_broken
        self.elite.append((candidate, result))
        self.elite.sort(key=lambda pair: (-pair[1].score, pair[0].number))
        del self.elite[_ELITE:]


def _chances(seed: int, space: SearchSpace = PAIRS) -> Iterator[tuple[str, tuple[float, ...], int]]:
    """Yield kind, vector and seed: the critical cases of the proofs, then random vectors of alternating kinds."""
    random = np.random.default_rng((seed, 0))
    for case in space.cases:
        yield next(iter(space.sizes)), tuple(case), int(random.integers(2**31))
    while True:
        for kind, size in space.sizes.items():
            yield kind, tuple(random.random(size).tolist()), int(random.integers(2**31))


class _Island:
    """CMA-ES around one candidate; its runs share the noise seed, so that their scores are comparable."""

    def __init__(self, parent: Candidate, seed: int, number: int, spread: float) -> None:
        import cma  # noqa: PLC0415 - an extra

        self._random = np.random.default_rng((seed, 1, number))
        self.kind = parent.kind
        self.seed = parent.seed if spread == _SPREAD else int(self._random.integers(2**31))
        options = {
            "bounds": [0.0, 1.0],
            "popsize": _POPULATION,
            "randn": lambda *shape: self._random.standard_normal(shape),
            "seed": math.nan,  # leaves NumPy's own random numbers alone
            "verbose": -9,
            "verb_log": 0,
        }
        self._strategy: Any = cma.CMAEvolutionStrategy(list(parent.vector), spread, options)

    @property
    def over(self) -> bool:
        """Return true if the strategy has converged."""
        return bool(self._strategy.stop())

    def ask(self) -> list[tuple[str, tuple[float, ...], int]]:
        """Return the next generation."""
        self._asked = self._strategy.ask()
        return [
            (self.kind, tuple(float(min(max(x, 0.0), 1.0)) for x in vector), self.seed)
            for vector in self._asked
        ]

    def tell(self, scores: list[float]) -> None:
        """Report the largest distance of each candidate [m]."""
        self._strategy.tell(self._asked, [-score for score in scores])


def run_search(
    workers: Workers,
    budget: Budget,
    tally: Tally,
    *,
    base: Scenario,
    limits: SearchLimits,
    seed: int,
    on_run: Callable[[], None],
    space: SearchSpace = PAIRS,
) -> None:
    """Search until the budget is used up.

    Args:
        workers: Worker processes.
        budget: Limit on runs and time.
        tally: Counters, updated with each result.
        base: Scenario shared by all candidates.
        limits: Limits of the search.
        seed: Seed of the search.
        on_run: Callback after every run.
        space: Candidates to search.
    """
    chances, cases, size = _chances(seed, space), len(space.cases), _ISLANDS * _POPULATION
    numbers, island_numbers = count(), count(1)
    islands: list[_Island] = []

    def island(rank: int, spread: float) -> _Island:
        return _Island(tally.elite[rank][0], seed, next(island_numbers), spread)

    while not budget.ends() and budget.left(tally.runs) != 0:
        explores = tally.runs < cases or budget.share(tally.runs) < _EXPLORED
        if explores:
            wanted = list(islice(chances, size))
        else:  # restart islands that have converged
            islands = [island(0, _NEW_SPREAD) if one.over else one for one in islands] or [
                island(min(k, len(tally.elite) - 1), _SPREAD) for k in range(_ISLANDS)
            ]
            wanted = [one for every in islands for one in every.ask()]
        batch = [
            Candidate(number=next(numbers), kind=kind, vector=vector, seed=own)
            for kind, vector, own in wanted
        ][: budget.left(tally.runs)]
        flown = {candidate.number: candidate for candidate in batch}
        results: list[CandidateResult] = []
        calls = ((one, base, limits) for one in batch)
        for result in workers.stream(space.fly, calls, budget.ends):
            tally.take(flown[result.number], result)
            results.append(result)
            on_run()
        if not explores and len(results) == size:
            for k, one in enumerate(islands):
                own_results = results[k * _POPULATION : (k + 1) * _POPULATION]
                one.tell([result.score for result in own_results])
