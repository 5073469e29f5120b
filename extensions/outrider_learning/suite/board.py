"""The leaderboard: entries beside each other, task by task."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from bus.registry import LAWS
from outrider.experiments.intervals import interquartile_interval
from outrider_learning.suite.scoring import Entry, Result, evaluate, score_interval
from outrider_learning.suite.tasks import NO_ESCORT, SEEDS, Suite, Task, suite
from sim.compiling.threads import cores
from sim.engine.run_keys import check_secret, new_secret

BASELINES = tuple(law.name for law in LAWS.values() if law.compared)
"""The entries that are always there to beat."""
MISSION_BASELINES = (NO_ESCORT, *BASELINES)
"""Those of missions: what a UGV does alone shows what an escort is worth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """The scores of one entry in all the tasks."""

    entry: str
    score: float
    """Mean over the tasks."""
    low: float
    high: float
    """Its 95 % interval over the seeds; NaN for a single one."""
    middle: float
    """Interquartile mean over the tasks and seeds."""
    middle_low: float
    middle_high: float
    """Its 95 % interval, by the bootstrap stratified by tasks; NaN for a single seed."""
    lost: int
    """Episodes in which sight was lost."""
    episodes: int
    certified_while_lost: int
    """Ticks that the safety filter certified with the UGV out of sight: 0, or the certificate is wrong."""
    certificate_broken: int
    """Ticks that it did not certify although the one before was and all assumptions held: likewise."""
    results: tuple[Result, ...]
    """Task by task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Leaderboard:
    """The entries and their scores."""

    tasks: tuple[str, ...]
    standings: tuple[Standing, ...]
    """The best first."""
    mission: bool
    """True if the tasks were scored by how the UGVs got through."""
    secret: str
    """Of all the flights' random numbers, beside the seeds: with it the same table again."""

    def rows(self) -> list[list[str]]:
        """The table: a head, a row for each task, and one for the mean over the tasks; a column for each entry.

        Missions, some of which an entry never ends, have one more for the interquartile mean.
        """
        table = [["task", *(standing.entry for standing in self.standings)]]
        table += [
            [task, *(_cell(standing.results[k]) for standing in self.standings)]
            for k, task in enumerate(self.tasks)
        ]
        table.append(["**mean**", *(_cell(standing) for standing in self.standings)])
        if self.mission:
            table.append(["**interquartile mean**", *map(middle_cell, self.standings)])
        return table

    def markdown(self) -> str:
        """The table in Markdown."""
        head, *body = self.rows()
        rule = ["---", *("---:" for _ in self.standings)]
        return "".join(f"| {' | '.join(row)} |\n" for row in (head, rule, *body))


def _cell(told: Result | Standing) -> str:
    half, lost = 0.5 * (told.high - told.low), f" ({told.lost} lost)" if told.lost else ""
    about = "" if math.isnan(half) else f" ± {half:.1f}"
    return f"{told.score:.1f}{about}{lost}"


def middle_cell(told: Standing) -> str:
    """The interquartile mean with its interval, where there is one, as tables have it."""
    low, high = told.middle_low, told.middle_high
    return f"{told.middle:.1f}" + ("" if math.isnan(low) else f" [{low:.1f}, {high:.1f}]")


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


def leaderboard(
    entries: Mapping[str, Entry] | Sequence[str] | None = None,
    *,
    tasks: Sequence[Task] | None = None,
    seeds: Sequence[int] = SEEDS,
    secret: str | None = None,
    on_progress: Callable[[str, float], object] | None = None,
    **settings: Any,  # noqa: ANN401 - those of evaluate
) -> Leaderboard:
    """Fly every entry over every task, laws on all cores; the same secret gives the same table.

    Args:
        entries: Laws by name, or a mapping from names to laws and policies; by default `BASELINES`, and for missions
            `MISSION_BASELINES`.
        tasks: A part of the suite, or tasks of your own; by default the whole suite.
        seeds: Of the episodes.
        secret: As in `outrider_learning.suite.scoring.evaluate`; one for all.
        on_progress: Called with what was flown last and the share of all that is done.
        settings: How the policies among the entries see and act, as in `outrider_learning.suite.scoring.evaluate`.

    Raises:
        ValueError: If there is no entry or no task, a law is unknown, or a policy answers what is no action.
    """
    flown = Suite(suite() if tasks is None else tasks)
    if entries is None:
        entries = MISSION_BASELINES if all(task.mission for task in flown) else BASELINES
    field = dict(entries) if isinstance(entries, Mapping) else {name: name for name in entries}
    if len({task.mission for task in flown}) > 1:
        raise ValueError("tasks: missions and others have scores of their own; allowed: one kind")
    if not field or not flown:
        raise ValueError(
            f"{len(field)} entries and {len(flown)} tasks: allowed is one or more of each"
        )
    if len(set(flown.names)) < len(flown):
        raise ValueError(f"tasks: {', '.join(flown.names)}: two have one name")
    kept = new_secret() if secret is None else check_secret(secret)
    jobs = [(name, entry, task) for task in flown for name, entry in field.items()]

    def fly(job: tuple[str, Entry, Task]) -> Result:
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

    def note(result: Result) -> None:
        results[result.entry, result.task] = result
        if on_progress is not None:
            on_progress(f"{result.entry} in {result.task}", len(results) / len(jobs))

    for job in jobs:
        if not isinstance(job[1], str):  # a policy of the user's own need not bear threads
            note(fly(job))
    with ThreadPoolExecutor(cores()) as pool:
        try:
            for result in pool.map(fly, (job for job in jobs if isinstance(job[1], str))):
                note(result)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    standings = [_standing(name, [results[name, task.name] for task in flown]) for name in field]
    return Leaderboard(
        tasks=flown.names,
        mission=flown[0].mission,
        standings=tuple(sorted(standings, key=lambda standing: -standing.score)),
        secret=kept,
    )
