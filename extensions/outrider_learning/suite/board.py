"""Leaderboard: entries side by side, task by task."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from statistics import fmean
from typing import Any, NamedTuple

from bus.registry import LAWS
from outrider.experiments.intervals import interquartile_interval
from outrider_learning.suite.evaluation import evaluate
from outrider_learning.suite.scoring import Entry, Result, score_interval
from outrider_learning.suite.tasks import NO_ESCORT, SEEDS, Suite, Task, suite
from sim.compiling.threads import cores
from sim.engine.run_keys import check_secret, new_secret

BASELINES = tuple(law.name for law in LAWS.values() if law.compared)
"""Baseline entries of every leaderboard."""
MISSION_BASELINES = (NO_ESCORT, *BASELINES)
"""Baselines of missions; a UGV without an escort shows what the escort is worth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Scores of one entry in all tasks."""

    entry: str
    score: float
    """Mean over the tasks."""
    low: float
    high: float
    """95 % interval of the score over the seeds; NaN for a single seed."""
    middle: float
    """Interquartile mean over tasks and seeds."""
    middle_low: float
    middle_high: float
    """95 % interval of the interquartile mean, by a bootstrap stratified by task; NaN for a single seed."""
    lost: int
    """Episodes with loss of sight."""
    episodes: int
    certified_while_lost: int
    """Ticks certified while the UGV was out of sight: zero if the certificate is correct."""
    certificate_broken: int
    """Ticks that lost the certificate although all assumptions held: zero if it is correct."""
    results: tuple[Result, ...]
    """Results by task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Leaderboard:
    """Entries and their scores."""

    tasks: tuple[str, ...]
    standings: tuple[Standing, ...]
    """Standings, best first."""
    mission: bool
    """True if the tasks are missions."""
    team: bool
    """True if teams fly the tasks: the table shows the mean e(t), too."""
    secret: str
    """Secret of all random numbers; with the seeds it reproduces the table."""

    def rows(self) -> list[list[str]]:
        """Return the table: a head, one row per task and one for the mean; one column per entry.

        The mean e(t) [m²] follows the score of a team.
        Missions add a row for the interquartile mean, because an entry may fail some of them.
        """
        table = [["task", *(standing.entry for standing in self.standings)]]
        table += [
            [task, *(_cell(standing.results[k], error=self.team) for standing in self.standings)]
            for k, task in enumerate(self.tasks)
        ]
        table.append(["**mean**", *(_cell(standing) for standing in self.standings)])
        if self.mission:
            table.append(["**interquartile mean**", *map(middle_cell, self.standings)])
        return table

    def markdown(self) -> str:
        """Return the table in Markdown."""
        head, *body = self.rows()
        rule = ["---", *("---:" for _ in self.standings)]
        return "".join(f"| {' | '.join(row)} |\n" for row in (head, rule, *body))


def _cell(result: Result | Standing, *, error: bool = False) -> str:
    half, lost = 0.5 * (result.high - result.low), f" ({result.lost} lost)" if result.lost else ""
    about = "" if math.isnan(half) else f" ± {half:.1f}"
    left = f", {result.mean_error:.1f} m²" if error and isinstance(result, Result) else ""
    return f"{result.score:.1f}{about}{left}{lost}"


def middle_cell(standing: Standing) -> str:
    """Return the interquartile mean with its interval, if known, as a table cell."""
    low, high = standing.middle_low, standing.middle_high
    return f"{standing.middle:.1f}" + ("" if math.isnan(low) else f" [{low:.1f}, {high:.1f}]")


def _standing(entry: str, results: Sequence[Result]) -> Standing:
    by_seed = [fmean(scores) for scores in zip(*(result.scores for result in results), strict=True)]
    score, low, high = score_interval(by_seed)
    middle, middle_low, middle_high = interquartile_interval([one.scores for one in results])
    return Standing(
        entry=entry,
        score=score,
        low=low,
        high=high,
        middle=middle,
        middle_low=middle_low,
        middle_high=middle_high,
        lost=sum(result.lost for result in results),
        episodes=sum(result.episodes for result in results),
        certified_while_lost=sum(result.certified_while_lost for result in results),
        certificate_broken=sum(result.certificate_broken for result in results),
        results=tuple(results),
    )


class _Job(NamedTuple):
    """Evaluation of an entry in a task."""

    name: str
    entry: Entry
    task: Task


def leaderboard(
    entries: Mapping[str, Entry] | Sequence[str] | None = None,
    *,
    tasks: Sequence[Task] | None = None,
    seeds: Sequence[int] = SEEDS,
    secret: str | None = None,
    on_progress: Callable[[str, float], object] | None = None,
    **settings: Any,  # noqa: ANN401 - settings of evaluate
) -> Leaderboard:
    """Evaluate every entry on every task, laws on all cores; the same secret reproduces the table.

    Args:
        entries: Laws by name, or a mapping from names to laws and policies; default: `BASELINES`, for missions
            `MISSION_BASELINES`.
        tasks: Tasks to run; default: the whole suite.
        seeds: Seeds of the episodes.
        secret: Secret of `outrider_learning.suite.evaluation.evaluate`, the same for all.
        on_progress: Progress callback: last entry and task, completed share.
        settings: Observation and action settings of the policies, see `outrider_learning.suite.evaluation.evaluate`.

    Raises:
        ValueError: If there is no entry or task, a law is unknown, or a policy returns an invalid action.
    """
    flown = Suite(suite() if tasks is None else tasks)
    if entries is None:
        entries = MISSION_BASELINES if all(task.mission for task in flown) else BASELINES
    field = dict(entries) if isinstance(entries, Mapping) else {name: name for name in entries}
    if len({task.mission for task in flown}) > 1:
        raise ValueError("tasks: missions and other tasks have different scores; allowed: one kind")
    if not field or not flown:
        raise ValueError(
            f"{len(field)} entries and {len(flown)} tasks; allowed: one or more of each"
        )
    if len(set(flown.names)) < len(flown):
        raise ValueError(f"tasks: {', '.join(flown.names)}: duplicate name; allowed: unique names")
    kept = new_secret() if secret is None else check_secret(secret)
    jobs = [_Job(name, entry, task) for task in flown for name, entry in field.items()]

    def fly(job: _Job) -> Result:
        name, entry, task = job
        return evaluate(
            task,
            entry,
            name=name,
            seeds=seeds,
            secret=kept,
            **({} if isinstance(entry, str) else settings),
        )

    results: dict[tuple[str, str], Result] = {}

    def record(result: Result) -> None:
        results[result.entry, result.task] = result
        if on_progress is not None:
            on_progress(f"{result.entry} in {result.task}", len(results) / len(jobs))

    for job in jobs:
        if not isinstance(job[1], str):  # a user's policy may not be thread-safe
            record(fly(job))
    with ThreadPoolExecutor(cores()) as pool:
        try:
            for result in pool.map(fly, (job for job in jobs if isinstance(job[1], str))):
                record(result)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    standings = [_standing(name, [results[name, task.name] for task in flown]) for name in field]
    return Leaderboard(
        tasks=flown.names,
        mission=flown[0].mission,
        team=any(task.team for task in flown),
        standings=tuple(sorted(standings, key=lambda standing: -standing.score)),
        secret=kept,
    )
