"""Evaluation of an entry in a task."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.closed_loop.pilots import pilot_names
from outrider.envs.worlds import Worlds
from outrider_learning.suite.missions import evaluate_mission
from outrider_learning.suite.scoring import (
    SETTINGS,
    Entry,
    Result,
    Team,
    check_law,
    result_of,
    started_worlds,
)
from outrider_learning.suite.tasks import SEEDS, Task
from sim.compiling.compile import FloatArray
from sim.engine.run_keys import check_secret, derive_secret, new_secret
from sim.engine.world_state import first_coverage
from sim.env.seeds import Seeds
from sim.models.field import coverage_error


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
        self.in_sight &= ~standings["unseen"].any(axis=1)
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
    task, and k_lost the tick at which any UAV loses sight: later ticks score zero. A team loses sight when none of its
    UAVs sees the UGV; then the whole episode scores zero.

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
    counted = np.where(meter.in_sight, meter.seen, 0.0) if task.team else meter.seen
    scores = (100.0 * counted / (scenario.ticks + 1)).tolist()
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
