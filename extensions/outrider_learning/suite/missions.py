"""Score of a mission: duration, hazards hit, and finds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import msgspec
import numpy as np

from bus.messages.telemetry import MissionResult
from outrider.closed_loop.pilots import pilot_names
from outrider.envs.worlds import Worlds
from outrider_learning.suite.scoring import (
    Entry,
    Result,
    Team,
    check_law,
    result_of,
    started_worlds,
)
from outrider_learning.suite.tasks import NO_ESCORT, Task
from sim.engine.run_keys import derive_secret
from sim.env.rewards import RewardWeights
from sim.scenario.types import Scenario

_MISSION = {
    "rewards": RewardWeights(uncovered=0.0),  # e(t) is unused, and skipping it is faster
    "end_on_sight_lost": False,
    "end_on_goals_reached": True,
}
"""Settings of the worlds in missions."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionScore(Result):
    """Score of one entry in one mission."""

    arrived: int
    """Episodes in which every UGV reached all its goals."""
    mission_time: float
    """Mean mission time of these episodes [s]; NaN without any."""
    hazards_hit: int
    """Hazards hit in all episodes."""
    found: float
    """Share of the finds that were detected; NaN without any."""
    mean_warning_time: float
    """Mean time from learning of a hazard on the path to approaching it [s]; NaN without any."""
    reported_share: float
    """Share of the path on ground reported by radio beforehand."""


def shortest_time(scenario: Scenario) -> float:
    """Return the time of the slowest UGV along straight lines at full speed [s], without hazards."""
    times = [
        sum(map(math.dist, (ugv.position, *ugv.goals), ugv.goals)) / ugv.max_speed
        for ugv in scenario.ugv
    ]
    return max(times)


def mission_score(mission: MissionResult, shortest: float) -> float:
    r"""Return the score of one mission, 0 to 100.

    $$ S = 100 \, a \, \min\left(1, \frac{T^*}{T}\right) \frac{n}{n^*} \frac{1}{1 + h} $$

    a is 1 if every UGV arrived and 0 otherwise, T is the mission time and T* the shortest. n of n* finds were detected
    (the factor is 1 without finds), and h hazards were hit.

    Args:
        mission: Result of the mission.
        shortest: T* [s].
    """
    if mission.mission_time is None:
        return 0.0
    found = mission.found / mission.finds if mission.finds else 1.0
    pace = min(1.0, shortest / max(mission.mission_time, 1e-9))
    return 100.0 * pace * found / (1.0 + mission.hazards_hit)


def _fly(worlds: Worlds) -> None:
    """Simulate each world until its mission ends."""
    flying = np.arange(worlds.num_envs)
    while flying.size:
        ended = worlds.step({}, flying)
        flying = np.flatnonzero(~ended)


def evaluate_mission(
    task: Task,
    entry: Entry,
    seeds: Sequence[int],
    *,
    name: str,
    secret: str,
    settings: dict[str, Any],
) -> MissionScore:
    """Run a mission with all seeds at once, and score it; arguments as of `scoring.evaluate`.

    Raises:
        ValueError: If the law is unknown, or a policy returns an invalid action.
    """
    scenario = task.scenario
    if isinstance(entry, str):
        check_law(entry, (NO_ESCORT, *pilot_names(scenario, scenario.uav[0].name)))
        if entry == NO_ESCORT:
            scenario = msgspec.structs.replace(scenario, uav=())
    team = entry if isinstance(entry, Team) else Team(uav=entry)
    pilots = {uav.name: team.uav for uav in scenario.uav}
    pilots |= {ugv.name: team.ugv for ugv in scenario.ugv}
    own = derive_secret(secret, task.name)
    with started_worlds(scenario, pilots, seeds, own, settings | _MISSION) as worlds:
        if isinstance(entry, str):
            worlds.loop.fly()
        else:
            _fly(worlds)
        missions = [worlds.loop.mission(k) for k in range(len(seeds))]
        flown = {uav: worlds.loop.metrics(uav) for uav in worlds.loop.uavs}
    shortest = shortest_time(scenario)
    finds = sum(mission.finds for mission in missions)
    return result_of(
        MissionScore,
        task,
        entry,
        [mission_score(mission, shortest) for mission in missions],
        flown,
        name=name,
        secret=secret,
        mean_error=math.nan,
        lost=int(
            np.any(
                [
                    one.get("team_out_of_sight", one["visibility_violations"]) > 0.0
                    for one in flown.values()
                ],
                axis=0,
            ).sum()
        ),
        arrived=sum(mission.arrived for mission in missions),
        mission_time=_mean([mission.mission_time for mission in missions]),
        hazards_hit=sum(mission.hazards_hit for mission in missions),
        found=sum(mission.found for mission in missions) / finds if finds else math.nan,
        mean_warning_time=_mean([mission.mean_warning_time for mission in missions]),
        reported_share=_mean([mission.reported_share for mission in missions]),
    )


def _mean(values: Sequence[float | None]) -> float:
    known = [value for value in values if value is not None]
    return fmean(known) if known else math.nan
