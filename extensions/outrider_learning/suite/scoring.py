"""Score of an episode: covered share of the ground around the UGV, averaged over the requested duration."""

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from outrider.envs.closed_loop import ClosedLoop
from outrider.envs.closed_loop_pilots import pilot_names
from outrider.envs.worlds import Worlds
from outrider.experiments.intervals import mean_interval
from outrider_learning.suite.tasks import SEEDS, Task
from sim.compiling.compile import FloatArray
from sim.engine.run_keys import check_secret, derive_secret, new_secret
from sim.engine.world_state import first_coverage
from sim.env.seeds import Seeds
from sim.env.settings import BatchPolicy
from sim.models.field import coverage_error
from sim.scenario.types import Scenario


class Team(NamedTuple):
    """Controllers of both sides in a mission."""

    uav: str | BatchPolicy | None = None
    """Law by name, or a policy for all worlds; None: the scenario's law."""
    ugv: str | BatchPolicy | None = None
    """Driver by name, or a policy; None: the scenario's driver."""


Entry = str | BatchPolicy | Team
"""Controller of the UAVs: a law by name, or a policy for all worlds; in a mission also a team."""

SETTINGS = (
    *("estimate", "gradient", "omit", "safety_filter", "coverage_patch", "dtype"),
    "threads",
)
"""Observation and action settings of a policy. Everything else belongs to the task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Score of one entry in one task."""

    task: str
    entry: str
    score: float
    """Mean over the episodes, 0 to 100."""
    low: float
    high: float
    """95 % interval of the mean; NaN for a single episode."""
    scores: tuple[float, ...]
    """Scores of the episodes, in the order of the seeds."""
    mean_error: float
    """Mean of e(t) [m²] over UAVs, ticks before sight was lost, and episodes."""
    lost: int
    """Episodes with loss of sight."""
    episodes: int
    secret: str
    """Secret of the episodes' random numbers; with the seeds it reproduces the score."""
    certified_while_lost: int = 0
    """Ticks of all UAVs certified while the UGV was out of sight: zero if the certificate is correct."""
    certificate_broken: int = 0
    """Ticks that lost the certificate although all assumptions held: zero if it is correct."""


_Scored = TypeVar("_Scored", bound=Result)


class _Meter:
    """Counters of a closed loop, updated at every tick."""

    def __init__(self, loop: ClosedLoop) -> None:
        scenario = loop.scenario
        self._loop = loop
        self._untouched = first_coverage(scenario)
        self._r_o = float(scenario.visibility.radius + scenario.sensor.range)
        self._desired, self._cell = float(scenario.coverage.desired), float(scenario.area.cell)
        self._known: dict[tuple[float, float], float] = {}
        self.in_sight: npt.NDArray[np.bool_] = np.ones(loop.worlds, dtype=np.bool_)
        """True in worlds without loss of sight so far."""
        self.seen: FloatArray = np.zeros(loop.worlds)
        """Sum of the covered share over the ticks."""
        self.errors: FloatArray = np.zeros(loop.worlds)
        """Sum of e(t) over the ticks in sight [m²], averaged over the UAVs."""
        self.ticks: npt.NDArray[np.int64] = np.zeros(loop.worlds, dtype=np.int64)
        """Ticks in sight."""

    def update(self) -> None:
        """Add the current tick of all worlds."""
        state = self._loop.state
        uavs, ugvs = self._loop.tables.batch.escorts.T
        standings = state.rows.standings[:, uavs]
        self.in_sight &= ~standings["lost"].any(axis=1)
        positions = state.batch.vehicles["position"][:, ugvs]
        which = np.flatnonzero(self.in_sight)
        if which.size == 0:
            return
        error = standings["error"][which]
        most = np.array(
            [[self._uncovered(x, y) for x, y in of_world] for of_world in positions[which].tolist()]
        )
        share = np.ones_like(error)  # without any ground to cover, the share is 1
        np.divide(most - error, most, out=share, where=most > 0.0)
        self.seen[which] += share.mean(axis=1)
        self.errors[which] += error.mean(axis=1)
        self.ticks[which] += 1

    def _uncovered(self, x: float, y: float) -> float:
        """Return e(t) [m²] with the UGV at (x, y) [m] and no coverage by any UAV.

        It is cached, because the UGVs of many worlds often share a position.
        """
        found = self._known.get((x, y))
        if found is None:
            found = self._known[x, y] = coverage_error(
                self._untouched, x, y, self._r_o, self._desired, self._cell
            )
        return found


@contextmanager
def started_worlds(
    scenario: Scenario,
    pilots: Mapping[str, str | BatchPolicy | None],
    seeds: Sequence[int],
    secret: str,
    settings: dict[str, Any],
) -> Iterator[Worlds]:
    """Yield one world per seed, at its start; each policy is copied, because it may have a memory.

    Args:
        scenario: Scenario of all worlds.
        pilots: Laws, drivers and policies by vehicle; None: the scenario's own.
        seeds, secret: Seeds and secret of the random numbers.
        settings: Settings of `outrider.vector_env`.
    """
    others = {name: copy.deepcopy(pilot) for name, pilot in pilots.items() if pilot is not None}
    worlds = Worlds(scenario, len(seeds), [], others=others, secret=secret, **settings)
    try:
        worlds.reset(list(seeds), None)
        yield worlds
    finally:
        worlds.loop.close()


def _fly(worlds: Worlds) -> _Meter:
    """Simulate each world until it loses sight, or to the end."""
    meter = _Meter(worlds.loop)
    meter.update()
    for _ in range(worlds.scenario.ticks):
        if not meter.in_sight.any():
            break
        worlds.step({}, np.flatnonzero(meter.in_sight))
        meter.update()
    return meter


def check_law(law: str, allowed: Sequence[str]) -> None:
    """Reject an unknown law.

    Raises:
        ValueError: If the law is not in `allowed`.
    """
    if law not in allowed:
        raise ValueError(
            f"law = {law!r}: unknown law; allowed: {', '.join(allowed)}, or a policy for all worlds"
        )


def score_interval(scores: Sequence[float]) -> tuple[float, float, float]:
    """Return the mean score and its 95 % interval, clipped to 0 to 100; NaN for a single score."""
    score, low, high = mean_interval(scores)
    return score, max(low, 0.0), min(high, 100.0)  # this argument order keeps NaN


def result_of(
    kind: type[_Scored],
    task: Task,
    entry: Entry,
    scores: Sequence[float],
    flown: Mapping[str, Mapping[str, FloatArray]],
    *,
    name: str,
    secret: str,
    **fields: Any,  # noqa: ANN401 - the other fields of that kind
) -> _Scored:
    """Return the result of an entry from the scores of its episodes.

    Args:
        kind: Class of the result.
        task, entry: Task and entry.
        scores: Scores in the order of the seeds.
        flown: Final metrics of each UAV.
        name: Name of the entry in tables; empty: its own.
        secret: Secret of the episodes' random numbers.
        fields: Further fields of this class.
    """
    score, low, high = score_interval(scores)
    own = entry if isinstance(entry, str) else getattr(entry, "__name__", type(entry).__name__)
    return kind(
        task=task.name,
        entry=name or own,
        score=score,
        low=low,
        high=high,
        scores=tuple(scores),
        episodes=len(scores),
        secret=secret,
        certified_while_lost=sum(int(one["certified_while_lost"].sum()) for one in flown.values()),
        certificate_broken=sum(int(one["certificate_broken"].sum()) for one in flown.values()),
        **fields,
    )


def _with_setup(entry: Entry, settings: dict[str, Any]) -> dict[str, Any]:
    """Return the settings, completed by the policy's own training settings.

    Raises:
        ValueError: If a setting contradicts the policy's own: its observations would differ.
    """
    policy = entry.uav if isinstance(entry, Team) else entry
    setup = getattr(policy, "setup", {})
    for setting, value in settings.items():
        if setup.get(setting, value) != value:
            raise ValueError(
                f"{setting} = {value!r}: the policy was trained with {setup[setting]!r}; leave it out"
            )
    return {key: value for key, value in setup.items() if key in SETTINGS} | settings


def evaluate(
    task: Task,
    entry: Entry,
    *,
    name: str = "",
    seeds: Sequence[int] = SEEDS,
    secret: str | None = None,
    **settings: Any,  # noqa: ANN401 - settings of Worlds
) -> Result:
    r"""Run a task with all seeds at once, and score it.

    $$ S = \frac{100}{N + 1} \sum_{k < k_{lost}} \left( 1 - \frac{e(t_k)}{e_0(t_k)} \right) $$

    e is the paper's (4), and e_0 is its value at the same tick without any coverage. N is the number of ticks of the
    task, and k_lost the tick at which any UAV loses sight: later ticks score zero.

    Args:
        task: Task to run.
        entry: Law by name, or a policy from the observations of one UAV in all worlds to its accelerations [m/s²],
            shape (worlds, 2). In a task with several UAVs each has a copy of the policy and observes its own row.
        name: Name of the entry in tables.
        seeds: Seeds of the episodes.
        secret: Secret of the random numbers: 32 to 128 hexadecimal digits. None: a new one, so that no entry can
            prepare for it; empty: none, so that the noise of the seeds is public.
        settings: Observation and action settings of a policy, `SETTINGS` of `outrider.vector_env`; the `setup` of a
            saved policy completes them.

    Raises:
        ValueError: If the law is unknown, a seed, the secret or a setting is invalid, or the policy returns an
            invalid action.
    """
    if entry is None:
        raise ValueError("entry = None; allowed: a law by name, a policy or a team")
    if not seeds:
        raise ValueError("seeds: empty; allowed: one or more")
    for seed in seeds:
        Seeds.check(seed)
    kept = new_secret() if secret is None else check_secret(secret)
    if isinstance(entry, str) and settings:
        raise ValueError(
            f"{', '.join(settings)}: not supported for the law {entry!r}; allowed: for policies"
        )
    for setting in settings:
        if setting not in SETTINGS:
            raise ValueError(f"{setting}: fixed by the task; allowed: {', '.join(SETTINGS)}")
    settings = _with_setup(entry, settings)
    if task.mission:
        from outrider_learning.suite.missions import evaluate_mission  # noqa: PLC0415 - it imports this file

        return evaluate_mission(task, entry, seeds, name=name, secret=kept, settings=settings)
    if isinstance(entry, Team):
        raise ValueError("entry: a team needs a mission; allowed: a law by name, or a policy")
    scenario = task.scenario
    uavs = [uav.name for uav in scenario.uav]
    if isinstance(entry, str):
        check_law(entry, pilot_names(scenario, uavs[0]))
    own = derive_secret(kept, task.name)
    with started_worlds(scenario, dict.fromkeys(uavs, entry), seeds, own, settings) as worlds:
        meter = _fly(worlds)
        flown = {uav: worlds.loop.metrics(uav) for uav in worlds.loop.uavs}
    scores = (100.0 * meter.seen / (scenario.ticks + 1)).tolist()
    return result_of(
        Result,
        task,
        entry,
        scores,
        flown,
        name=name,
        secret=kept,
        mean_error=math.fsum((meter.errors / meter.ticks).tolist()) / len(seeds),
        lost=int((~meter.in_sight).sum()),
    )
