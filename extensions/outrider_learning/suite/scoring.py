"""The score of a flight: how much of what there was to see has been seen, averaged over the time that was asked for."""

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from outrider.envs.closed_loop import ClosedLoop
from outrider.envs.pilot_numbers import pilot_names
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
    """The pilots of both sides in a mission."""

    uav: str | BatchPolicy | None = None
    """A law by name, or a policy for all worlds at once; None: the scenario's law."""
    ugv: str | BatchPolicy | None = None
    """A driver by name, or a policy; None: the scenario's driver."""


Entry = str | BatchPolicy | Team
"""The pilot of the UAVs: a law by name, or a policy for all worlds at once; in a mission also a whole team."""

SETTINGS = ("estimate", "gradient", "safety_filter", "coverage_patch", "dtype", "threads")
"""The settings of a policy: how it sees and acts. All else belongs to the task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The score of one entry in one task."""

    task: str
    entry: str
    score: float
    """Mean over the episodes, 0 to 100."""
    low: float
    high: float
    """The 95 % interval of that mean; NaN for a single episode."""
    scores: tuple[float, ...]
    """Of each episode, in the order of the seeds."""
    mean_error: float
    """Mean of e(t) [m²] over UAVs, ticks before sight was lost, and episodes."""
    lost: int
    """Episodes in which sight was lost."""
    episodes: int
    secret: str
    """Of the episodes' random numbers, beside the seeds: with it the same score again."""
    certified_while_lost: int = 0
    """Ticks of all UAVs that the safety filter certified with the UGV out of sight: 0, or the certificate is wrong."""
    certificate_broken: int = 0
    """Ticks that it did not certify although the one before was and all assumptions held: likewise."""


_Scored = TypeVar("_Scored", bound=Result)


class _Meter:
    """Reads a closed loop tick by tick."""

    def __init__(self, loop: ClosedLoop) -> None:
        scenario = loop.scenario
        self._loop = loop
        self._untouched = first_coverage(scenario)
        self._r_o = float(scenario.visibility.radius + scenario.sensor.range)
        self._desired, self._cell = float(scenario.coverage.desired), float(scenario.area.cell)
        self._known: dict[tuple[float, float], float] = {}
        self.in_sight: npt.NDArray[np.bool_] = np.ones(loop.worlds, dtype=np.bool_)
        """True where sight has never been lost."""
        self.seen: FloatArray = np.zeros(loop.worlds)
        """Sum over the ticks of the share that has been seen."""
        self.errors: FloatArray = np.zeros(loop.worlds)
        """Sum of e(t) over the ticks in sight [m²], the mean of the UAVs."""
        self.ticks: npt.NDArray[np.int64] = np.zeros(loop.worlds, dtype=np.int64)
        """In sight."""

    def note(self) -> None:
        """Take in the tick that all worlds are at."""
        state = self._loop.state
        uavs, ugvs = self._loop.tables.batch.escorts.T
        standings = state.rows.standings[:, uavs]
        self.in_sight &= ~standings["lost"].any(axis=1)
        places = state.batch.vehicles["position"][:, ugvs]
        which = np.flatnonzero(self.in_sight)
        if which.size == 0:
            return
        error = standings["error"][which]
        most = np.array(
            [[self._unseen(x, y) for x, y in of_world] for of_world in places[which].tolist()]
        )
        share = np.ones_like(error)  # where there is nothing to see, all of it has been seen
        np.divide(most - error, most, out=share, where=most > 0.0)
        self.seen[which] += share.mean(axis=1)
        self.errors[which] += error.mean(axis=1)
        self.ticks[which] += 1

    def _unseen(self, x: float, y: float) -> float:
        """E(t) [m²] with the UGV at (x, y) [m], had no UAV seen anything.

        UGVs of many worlds often stand there.
        """
        found = self._known.get((x, y))
        if found is None:
            found = self._known[x, y] = coverage_error(
                self._untouched, x, y, self._r_o, self._desired, self._cell
            )
        return found


@contextmanager
def begun(
    scenario: Scenario,
    pilots: Mapping[str, str | BatchPolicy | None],
    seeds: Sequence[int],
    secret: str,
    settings: dict[str, Any],
) -> Iterator[Worlds]:
    """A world for each seed, at its start; each policy is a copy of its own, as it may have a memory.

    Args:
        scenario: What is flown.
        pilots: Laws, drivers and policies by vehicle; None: the scenario's own.
        seeds, secret: Of the random numbers.
        settings: Of `outrider.vector_env`.
    """
    others = {name: copy.deepcopy(pilot) for name, pilot in pilots.items() if pilot is not None}
    worlds = Worlds(scenario, len(seeds), [], others=others, secret=secret, **settings)
    try:
        worlds.reset(list(seeds), None)
        yield worlds
    finally:
        worlds.loop.close()


def _fly(worlds: Worlds) -> _Meter:
    """Fly each world until it has lost sight, or to the end."""
    meter = _Meter(worlds.loop)
    meter.note()
    for _ in range(worlds.scenario.ticks):
        if not meter.in_sight.any():
            break
        worlds.step({}, np.flatnonzero(meter.in_sight))
        meter.note()
    return meter


def check_law(law: str, allowed: Sequence[str]) -> None:
    """Refuse a law that is none of these.

    Raises:
        ValueError: Then.
    """
    if law not in allowed:
        raise ValueError(
            f"law = {law!r}: unknown; allowed: {', '.join(allowed)}, or a policy for all worlds at once"
        )


def score_interval(scores: Sequence[float]) -> tuple[float, float, float]:
    """The mean score and its 95 % interval, cut to 0 to 100; NaN for a single one."""
    score, low, high = mean_interval(scores)
    return score, max(low, 0.0), min(high, 100.0)  # in this order NaN stays


def result_of(
    kind: type[_Scored],
    task: Task,
    entry: Entry,
    scores: Sequence[float],
    flown: Mapping[str, Mapping[str, FloatArray]],
    *,
    name: str,
    secret: str,
    **told: Any,  # noqa: ANN401 - the other fields of that kind
) -> _Scored:
    """The result of an entry from the scores of its episodes.

    Args:
        kind: Of result.
        task, entry: What was flown, and by whom.
        scores: In the order of the seeds.
        flown: What the worlds told of each UAV in the end.
        name: Of the entry, for tables; empty: its own.
        secret: Of the episodes' random numbers.
        told: The other fields of that kind of result.
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
        **told,
    )


def _with_setup(entry: Entry, settings: dict[str, Any]) -> dict[str, Any]:
    """The settings, and those that the policy itself says it was trained with.

    Raises:
        ValueError: If a setting is another than the policy's own: it would observe something else.
    """
    policy = entry.uav if isinstance(entry, Team) else entry
    setup = getattr(policy, "setup", {})
    for setting, value in settings.items():
        if setup.get(setting, value) != value:
            raise ValueError(
                f"{setting} = {value!r}: the policy is made with {setup[setting]!r}; leave it out"
            )
    return {key: value for key, value in setup.items() if key in SETTINGS} | settings


def evaluate(
    task: Task,
    entry: Entry,
    *,
    name: str = "",
    seeds: Sequence[int] = SEEDS,
    secret: str | None = None,
    **settings: Any,  # noqa: ANN401 - those of Worlds
) -> Result:
    r"""Fly a task with all seeds at once, and score it.

    $$ S = \frac{100}{N + 1} \sum_{k < k_{lost}} \left( 1 - \frac{e(t_k)}{e_0(t_k)} \right) $$

    e is the paper's (4); e_0 is what it would be at this tick had no UAV seen anything, with the UGV where it is. N is
    the number of ticks that the task asks for, and k_lost the tick at which any UAV loses sight: from then on nothing
    counts as seen.

    Args:
        task: What is flown.
        entry: A law by name; or a policy: the observations of one UAV in all worlds in, its accelerations [m/s²]
            out, shape (worlds, 2). In a task with several UAVs each has a copy of it, and sees its own row.
        name: Of the entry, for tables.
        seeds: Of the episodes.
        secret: Of the random numbers, with each seed: 32 to 128 hexadecimal digits. None: a new one, which nobody
            can have prepared for; empty: none, and the noise of the seeds is known to whoever looks.
        settings: How a policy sees and acts: `SETTINGS`, as in `outrider.vector_env`; where it has a `setup`, as
            saved policies have, the settings of that.

    Raises:
        ValueError: If the law is unknown, a seed, the secret or a setting is not allowed, or the policy answers
            what is no action.
    """
    if entry is None:
        raise ValueError("entry = None: allowed is a law by name, a policy or a team")
    if not seeds:
        raise ValueError("seeds: none are given; allowed is one or more")
    for seed in seeds:
        Seeds.check(seed)
    kept = new_secret() if secret is None else check_secret(secret)
    if isinstance(entry, str) and settings:
        raise ValueError(f"{', '.join(settings)}: for policies alone, not for the law {entry!r}")
    for setting in settings:
        if setting not in SETTINGS:
            raise ValueError(
                f"{setting}: cannot be set, it belongs to the task; allowed: {', '.join(SETTINGS)}"
            )
    settings = _with_setup(entry, settings)
    if task.mission:
        from outrider_learning.suite.missions import evaluate_mission  # noqa: PLC0415 - it stands on this file

        return evaluate_mission(task, entry, seeds, name=name, secret=kept, settings=settings)
    if isinstance(entry, Team):
        raise ValueError("a team: for missions alone; allowed: a law by name, or a policy")
    scenario = task.scenario
    uavs = [uav.name for uav in scenario.uav]
    if isinstance(entry, str):
        check_law(entry, pilot_names(scenario, uavs[0]))
    own = derive_secret(kept, task.name)
    with begun(scenario, dict.fromkeys(uavs, entry), seeds, own, settings) as worlds:
        meter, flown = _fly(worlds), worlds.metrics()
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
