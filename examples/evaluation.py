"""Compares a learned UAV with the paper's laws, on flights that its training never saw."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import numpy as np

from bus.registry import DEFAULT_LAW, LAWS
from outrider.envs.closed_loop import ClosedLoop
from outrider.envs.worlds import Worlds
from outrider.experiments.intervals import mean_interval
from outrider_learning.learned import LearnedPolicy
from sim.compiling.compile import FloatArray
from sim.env.rewards import RewardWeights
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

BASELINES = tuple(law.name for law in LAWS.values() if law.compared and law.name != "tracking")
"""The laws beside which a learned UAV is put: all that look at the ground."""
VARIANTS: Mapping[str, Mapping[str, float]] = {
    "lookahead, one step": {"horizon": 0.5},
    "lookahead, at random": {"candidates": 1},
}
"""The law `lookahead` with other parameters: without its horizon, and without comparing motions."""
LEARNED, UNSHIELDED = "learned, in the filter", "learned, without it"
FIRST_SEED = 900_001
"""Of the flights. Training begins with seeds far below, and goes on with seeds that are drawn from 2**53."""
VALIDATION_SEEDS = tuple(range(800_001, 800_017))
"""Of the flights of the learning curve, which are neither trained on nor in the table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A scenario and a driver to be flown."""

    title: str
    scenario: str
    driver: str
    """Of the UGV."""
    overrides: Sequence[str] = ()
    """Of the scenario."""

    def load(self, duration: float | None = None) -> Scenario:
        """The scenario, with a duration of its own [s] where one is given."""
        length = () if duration is None else (f"duration={duration}",)
        return load_scenario(self.scenario, overrides=(*self.overrides, *length))


CASES = {
    "escort": Case(title="`escort`: waypoints, 200 s", scenario="escort", driver="waypoints"),
    "wander": Case(
        title="`escort` with a UGV that wanders, 200 s", scenario="escort", driver="wander"
    ),
    "evade": Case(
        title="`escort` with a UGV that evades, 200 s", scenario="escort", driver="evade"
    ),
    "covered": Case(
        title="`scenario-2` with the detections of `escort`: waypoints past covered ground, 200 s",
        scenario="scenario-2",
        driver="waypoints",
        # Without noise all flights would be the same.
        overrides=("detections.noise=0.1", "detections.dropout=0.1", "estimator.enabled=true"),
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """One pilot in one case, over all flights."""

    case: str
    pilot: str
    flights: int
    mean_error: float
    """Mean over flights of the mean of e(t) [m²]."""
    half_width: float
    """Of its 95 % interval [m²]; NaN for a single flight."""
    difference: float
    """Mean over flights of what it has more than the logarithmic law on the same flight [m²]."""
    difference_half_width: float
    """Of its 95 % interval [m²]."""
    max_distance: float
    """Largest of all flights [m]."""
    intervened: float | None
    """Share of ticks in which the filter acted; None without one."""
    lost: int
    """Flights that lost sight."""
    violations: int
    """Ticks out of sight in all flights."""


Metrics = Mapping[str, FloatArray]


def fly_law(
    case: Case,
    law: str,
    seeds: Sequence[int],
    *,
    parameters: Mapping[str, float] | None = None,
    duration: float | None = None,
) -> Metrics:
    """A law, with parameters other than its own where they are given, in one flight for each seed."""
    scenario = case.load(duration)
    chosen = {**scenario.law.parameters, **(parameters or {})}
    chosen_law = msgspec.structs.replace(scenario.law, parameters=chosen)
    scenario = msgspec.structs.replace(scenario, law=chosen_law)
    (uav,), (ugv,) = scenario.uav, scenario.ugv
    pilots = {uav.name: law, ugv.name: case.driver}
    loop = ClosedLoop(scenario, len(seeds), pilots=pilots, error=True, end_on_sight_lost=False)
    loop.begin(seeds)
    loop.fly()
    metrics = loop.metrics(uav.name)
    loop.close()
    return metrics


def fly_policy(
    case: Case,
    policy: LearnedPolicy,
    seeds: Sequence[int],
    *,
    shielded: bool,
    duration: float | None = None,
) -> Metrics:
    """A learned policy in one flight for each seed, with the safety filter around it or without."""
    scenario = case.load(duration)
    policy.check(scenario)
    (uav,), (ugv,) = scenario.uav, scenario.ugv
    worlds = Worlds(
        scenario,
        len(seeds),
        [uav.name],
        others={ugv.name: case.driver},
        rewards=RewardWeights(),
        end_on_sight_lost=False,
        safety_filter=shielded,
        **policy.setup,
    )
    worlds.reset(list(seeds), None)
    ended = np.zeros(len(seeds), dtype=np.bool_)
    while not ended.any():  # nothing but time ends an episode, so all end together
        ended = worlds.step({uav.name: policy(worlds.observe(uav.name))})
    metrics = worlds.metrics()[uav.name]
    worlds.loop.close()
    return metrics


def evaluate(
    path: str | Path,
    *,
    flights: int = 20,
    cases: Sequence[str] = tuple(CASES),
    duration: float | None = None,
) -> list[Result]:
    """All pilots in these cases; the same file gives the same results.

    Args:
        path: A file of `examples/train_uav.py`.
        flights: For each pilot and case, with the seeds from `FIRST_SEED` on.
        cases: Of `CASES`.
        duration: Of a flight, instead of the scenario's [s].

    Raises:
        ValueError: If the file is not there or no such policy, or another argument is not allowed.
    """
    LearnedPolicy.load(path)
    if flights < 1:
        raise ValueError(f"flights = {flights}: must be 1 or more")
    seeds = list(range(FIRST_SEED, FIRST_SEED + flights))
    results: list[Result] = []
    for name in cases:
        if name not in CASES:
            raise ValueError(f"case = {name!r}; allowed: {', '.join(CASES)}")
        flown: dict[str, Metrics] = {
            law: fly_law(CASES[name], law, seeds, duration=duration) for law in BASELINES
        }
        for pilot, parameters in VARIANTS.items():
            flown[pilot] = fly_law(
                CASES[name], "lookahead", seeds, parameters=parameters, duration=duration
            )
        for pilot, shielded in ((LEARNED, True), (UNSHIELDED, False)):
            flown[pilot] = fly_policy(
                CASES[name], LearnedPolicy.load(path), seeds, shielded=shielded, duration=duration
            )
        guarded = {LEARNED, *VARIANTS, *(law.name for law in LAWS.values() if law.watched)}
        results += [
            _result(name, pilot, m, flown[DEFAULT_LAW], filtered=pilot in guarded)
            for pilot, m in flown.items()
        ]
    return results


def _result(
    case: str, pilot: str, metrics: Metrics, logarithmic: Metrics, *, filtered: bool
) -> Result:
    errors = metrics["mean_error"]
    mean, _, high = mean_interval(errors.tolist())
    difference, _, difference_high = mean_interval((errors - logarithmic["mean_error"]).tolist())
    violations = metrics["visibility_violations"]
    return Result(
        case=case,
        pilot=pilot,
        flights=len(errors),
        mean_error=mean,
        half_width=high - mean,
        difference=difference,
        difference_half_width=difference_high - difference,
        max_distance=float(metrics["max_distance"].max()),
        intervened=float(metrics["overridden"].mean()) if filtered else None,
        lost=int(np.count_nonzero(violations)),
        violations=int(violations.sum()),
    )


def as_dicts(results: Sequence[Result]) -> list[dict[str, object]]:
    """The results for JSON."""
    return [asdict(result) for result in results]


def markdown(results: Sequence[Result]) -> str:
    """The results as a Markdown table for each case."""
    tables = []
    for case in dict.fromkeys(result.case for result in results):
        lines = [
            f"**{CASES[case].title}**",
            "",
            "| pilot | mean e(t) [m²] | more than logarithmic [m²] | largest distance [m] | filter acts "
            "| flights that lose sight | ticks out of sight |",
            "|---|---|---|---|---|---|---|",
        ]
        lines += [_line(result) for result in results if result.case == case]
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def _about(half_width: float) -> str:
    return "" if math.isnan(half_width) else f" ± {half_width:.1f}"


def _line(result: Result) -> str:
    acts = "no filter" if result.intervened is None else f"{100.0 * result.intervened:.1f} %"
    more = (
        "-"
        if result.pilot == DEFAULT_LAW
        else f"{result.difference:+.1f}{_about(result.difference_half_width)}"
    )
    return (
        f"| {result.pilot} | {result.mean_error:.1f}{_about(result.half_width)} | {more} "
        f"| {result.max_distance:.2f} | {acts} | {result.lost} of {result.flights} "
        f"| {result.violations} |"
    )
