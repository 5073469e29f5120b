"""The score of a mission: how soon the UGVs are through, what they have run into, and what was found."""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import msgspec
import numpy as np

from bus.messages import Mission
from outrider.envs.closed_loop import ClosedLoop, pilot_names
from outrider.envs.vector import Policy, Worlds
from outrider.experiments.suite.scoring import Entry, Result, Team, check_law, result_of
from outrider.experiments.suite.tasks import NO_ESCORT, Task
from sim.engine.mission import mission_of
from sim.env.rewards import RewardWeights
from sim.scenario.types import Scenario

_UNPAID = RewardWeights(uncovered=0.0)
"""Nobody looks at e(t), which is faster."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionResult(Result):
    """The score of one entry in one mission."""

    arrived: int
    """Episodes in which every UGV has reached all its goals."""
    mission_time: float
    """Mean of the time that those took [s]; NaN if there are none."""
    hazards_hit: int
    """In all episodes."""
    found: float
    """Share of the things to be found that were; NaN where there are none."""
    warned_before: float
    """Time between knowing of a hazard on the way and coming near it, in the mean [s]; NaN: of none."""
    seen_ahead: float
    """Share of the way that led over ground which had come by radio before."""


def shortest_time(scenario: Scenario) -> float:
    """The time that straight ways at full speed would take the slowest UGV [s], as if there were no hazards."""
    times = [
        sum(map(math.dist, (ugv.position, *ugv.goals), ugv.goals)) / ugv.max_speed
        for ugv in scenario.ugv
    ]
    return max(times)


def mission_score(mission: Mission, shortest: float) -> float:
    r"""The score of one flight, 0 to 100.

    $$ S = 100 \, a \, \min\left(1, \frac{T^*}{T}\right) \frac{n}{n^*} \frac{1}{1 + h} $$

    a is 1 if every UGV arrived and 0 else, T the time that it took and T* the shortest, n of n* things were found (the
    factor is 1 where there are none), and h hazards were run into.

    Args:
        mission: What happened.
        shortest: T* [s].
    """
    if mission.mission_time is None:
        return 0.0
    found = mission.found / mission.finds if mission.finds else 1.0
    pace = min(1.0, shortest / max(mission.mission_time, 1e-9))
    return 100.0 * pace * found / (1.0 + mission.hazards_hit)


def mission_in(loop: ClosedLoop, k: int) -> Mission:
    """The mission of world k."""
    tables, state = loop.tables.batch, loop.state.batch
    return mission_of(tables.mission, state.ground, state.mission, k, loop.scenario.dt)


def _fly_law(
    task: Task, law: str, seeds: Sequence[int], secret: str
) -> tuple[list[Mission], ClosedLoop]:
    scenario = task.scenario
    check_law(law, (NO_ESCORT, *pilot_names(scenario, scenario.uav[0].name)))
    if law == NO_ESCORT:
        scenario = msgspec.structs.replace(scenario, uav=())
    loop = ClosedLoop(
        scenario,
        len(seeds),
        pilots={uav.name: law for uav in scenario.uav},
        rewards=_UNPAID,
        end_on_sight_lost=False,
        end_on_goals_reached=True,
        secret=secret,
    )
    try:
        loop.begin(seeds)
        loop.fly()
    finally:
        loop.close()
    return [mission_in(loop, k) for k in range(len(seeds))], loop


def _fly_policies(
    task: Task, team: Team, seeds: Sequence[int], secret: str, settings: dict[str, Any]
) -> tuple[list[Mission], ClosedLoop]:
    scenario = task.scenario
    chosen: dict[str, str | Policy | None] = {uav.name: team.uav for uav in scenario.uav}
    chosen |= {ugv.name: team.ugv for ugv in scenario.ugv}
    named = {name: pilot for name, pilot in chosen.items() if isinstance(pilot, str)}
    pilots = {  # each has a memory of its own
        name: copy.deepcopy(pilot)
        for name, pilot in chosen.items()
        if pilot is not None and not isinstance(pilot, str)
    }
    worlds = Worlds(
        scenario,
        len(seeds),
        list(pilots),
        others=dict(named),
        rewards=_UNPAID,
        end_on_sight_lost=False,
        end_on_goals_reached=True,
        secret=secret,
        **settings,
    )
    told: dict[int, Mission] = {}
    try:
        worlds.reset(list(seeds), None)
        while len(told) < len(seeds):
            ended = worlds.step(
                {name: pilot(worlds.observe(name)) for name, pilot in pilots.items()}
            )
            for k in np.flatnonzero(ended).tolist():
                told.setdefault(k, mission_in(worlds.loop, k))
    finally:
        worlds.loop.close()
    return [told[k] for k in range(len(seeds))], worlds.loop


def evaluate_mission(
    task: Task,
    entry: Entry,
    seeds: Sequence[int],
    *,
    name: str,
    secret: str,
    settings: dict[str, Any],
) -> MissionResult:
    """Fly a mission with all seeds at once, and score it; arguments as of `scoring.evaluate`.

    Raises:
        ValueError: If the law is unknown, or a policy answers what is no action.
    """
    if isinstance(entry, str):
        missions, loop = _fly_law(task, entry, seeds, secret)
    else:
        team = entry if isinstance(entry, Team) else Team(uav=entry)
        missions, loop = _fly_policies(task, team, seeds, secret, settings)
    shortest, flown = shortest_time(task.scenario), [loop.metrics(uav) for uav in loop.uavs]
    finds = sum(mission.finds for mission in missions)
    return result_of(
        MissionResult,
        task,
        entry,
        [mission_score(mission, shortest) for mission in missions],
        name=name,
        secret=secret,
        mean_error=math.nan,
        lost=int(np.any([one["visibility_violations"] > 0.0 for one in flown], axis=0).sum()),
        certified_while_lost=sum(int(one["certified_while_lost"].sum()) for one in flown),
        certificate_broken=sum(int(one["certificate_broken"].sum()) for one in flown),
        arrived=sum(mission.arrived for mission in missions),
        mission_time=_mean([mission.mission_time for mission in missions]),
        hazards_hit=sum(mission.hazards_hit for mission in missions),
        found=sum(mission.found for mission in missions) / finds if finds else math.nan,
        warned_before=_mean([mission.warned_before for mission in missions]),
        seen_ahead=_mean([mission.seen_ahead for mission in missions]),
    )


def _mean(values: Sequence[float | None]) -> float:
    known = [value for value in values if value is not None]
    return fmean(known) if known else math.nan
