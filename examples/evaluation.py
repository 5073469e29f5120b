"""Comparison of a learned UAV with the paper's laws, in runs outside its training."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec
import numpy as np

from bus.registry import DEFAULT_LAW, LAWS
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.envs.worlds import Worlds
from outrider.experiments.intervals import mean_interval
from outrider_learning.learned import LearnedPolicy
from sim.compiling.compile import FloatArray
from sim.env.rewards import RewardWeights
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

BASELINES = tuple(law.name for law in LAWS.values() if law.compared and law.name != "tracking")
"""Laws for comparison: all that take coverage into account."""
VARIANTS: Mapping[str, Mapping[str, float]] = {
    "lookahead, one step": {"horizon": 0.5},
    "lookahead, at random": {"candidates": 1},
}
"""Variants of the law `lookahead`: without its horizon, and without comparing trajectories."""
LEARNED, UNSHIELDED = "learned, in the filter", "learned, without it"
FIRST_SEED = 900_001
"""First seed of the evaluation runs. Training uses far smaller seeds, then seeds drawn from 2**53."""
VALIDATION_SEEDS = tuple(range(800_001, 800_017))
"""Seeds of the learning curve, used neither in training nor in the table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """Scenario with a UGV driver."""

    title: str
    scenario: str
    driver: str
    """Driver of the UGV."""
    overrides: Sequence[str] = ()
    """Overrides of the scenario."""

    def load(self, duration: float | None = None) -> Scenario:
        """Return the scenario, with another duration [s] if given."""
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
        # Without noise all runs would be identical.
        overrides=("detections.noise=0.1", "detections.dropout=0.1", "estimator.enabled=true"),
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Result of one pilot in one case, over all runs."""

    case: str
    pilot: str
    flights: int
    mean_error: float
    """Mean over the runs of the mean of e(t) [m²]."""
    half_width: float
    """Half width of its 95 % interval [m²]; NaN for a single run."""
    difference: float
    """Mean difference to the logarithmic law in the same run [m²]."""
    difference_half_width: float
    """Half width of its 95 % interval [m²]."""
    max_distance: float
    """Largest distance of all runs [m]."""
    overridden: float | None
    """Share of ticks overridden by the filter; None without one."""
    lost: int
    """Runs with loss of sight."""
    violations: int
    """Ticks out of sight in all runs."""


Metrics = Mapping[str, FloatArray]


def fly_law(
    case: Case,
    law: str,
    seeds: Sequence[int],
    *,
    parameters: Mapping[str, float] | None = None,
    duration: float | None = None,
) -> Metrics:
    """Run a law once per seed, with its own or the given parameters."""
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
    """Run a learned policy once per seed, with or without the safety filter."""
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
    while not ended.any():  # only time ends an episode, so all end together
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
    """Evaluate all pilots in these cases; the same file gives the same results.

    Args:
        path: File of `examples/train_uav.py`.
        flights: Runs per pilot and case, with seeds from `FIRST_SEED` on.
        cases: Names in `CASES`.
        duration: Duration of a run instead of the scenario's [s].

    Raises:
        ValueError: If the file is missing or is not such a policy, or another argument is invalid.
    """
    LearnedPolicy.load(path)
    if flights < 1:
        raise ValueError(f"flights = {flights}: too few; allowed: 1 or more")
    seeds = list(range(FIRST_SEED, FIRST_SEED + flights))
    results: list[Result] = []
    for name in cases:
        if name not in CASES:
            raise ValueError(f"case = {name!r}: unknown case; allowed: {', '.join(CASES)}")
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
        overridden=float(metrics["overridden"].mean()) if filtered else None,
        lost=int(np.count_nonzero(violations)),
        violations=int(violations.sum()),
    )


def as_dicts(results: Sequence[Result]) -> list[dict[str, object]]:
    """Return the results as JSON data."""
    return [asdict(result) for result in results]


def markdown(results: Sequence[Result]) -> str:
    """Return a Markdown table for each case."""
    tables = []
    for case in dict.fromkeys(result.case for result in results):
        lines = [
            f"**{CASES[case].title}**",
            "",
            "| pilot | mean e(t) [m²] | difference to logarithmic [m²] | largest distance [m] | overridden "
            "| runs with loss of sight | ticks out of sight |",
            "|---|---|---|---|---|---|---|",
        ]
        lines += [_line(result) for result in results if result.case == case]
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def _about(half_width: float) -> str:
    return "" if math.isnan(half_width) else f" ± {half_width:.1f}"


def _line(result: Result) -> str:
    overridden = "no filter" if result.overridden is None else f"{100.0 * result.overridden:.1f} %"
    more = (
        "-"
        if result.pilot == DEFAULT_LAW
        else f"{result.difference:+.1f}{_about(result.difference_half_width)}"
    )
    return (
        f"| {result.pilot} | {result.mean_error:.1f}{_about(result.half_width)} | {more} "
        f"| {result.max_distance:.2f} | {overridden} | {result.lost} of {result.flights} "
        f"| {result.violations} |"
    )
