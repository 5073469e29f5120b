"""Score of an episode: covered share of the ground around the UGV, averaged over the requested duration."""

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from outrider.envs.worlds import Worlds
from outrider.experiments.intervals import mean_interval
from outrider_learning.suite.tasks import Task
from sim.compiling.compile import FloatArray
from sim.env.settings import BatchPolicy
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
    *("roles", "threads"),
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


def _sum(flown: Mapping[str, Mapping[str, FloatArray]], *counts: str) -> int:
    """Return the sum of these counts over UAVs and episodes."""
    return sum(int(one[count].sum()) for one in flown.values() for count in counts if count in one)


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
        certified_while_lost=_sum(flown, "certified_while_lost", "team_certified_while_lost"),
        certificate_broken=_sum(flown, "certificate_broken", "team_certificate_broken"),
        **fields,
    )
