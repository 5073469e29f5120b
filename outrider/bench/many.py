"""Many worlds at once: all cores, beside the same kernels alone on as many grids.

Their memory, and that of the machine.
"""

import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from outrider.bench.timing import Pair, rate
from outrider.envs.closed_loop import ClosedLoop
from outrider.envs.vector import vector_env
from sim.engine.world_state import WorldParameters
from sim.env.rewards import RewardWeights
from sim.kernels.compile import FloatArray, IntArray, released
from sim.kernels.prefetch import fetch_disc
from sim.kernels.threads import WorkerThreads
from sim.models.field import accumulate, accumulate_with_gain, coverage_error, coverage_gradient
from sim.scenario.loading import load_scenario
from sim.scenario.types import HazardField, Scenario

WORLDS = 1024
RATE = RewardWeights(uncovered=0.0, seen=1.0)
"""Paid is how far e(t) falls by what is seen: e(t) itself is not needed."""
_STEPS = 60
_TRIAD = 1 << 24
"""Numbers in each of the triad's three arrays, 128 MiB: far more than any cache."""


@released
def _kernels_alone(
    parameters: WorldParameters,
    full: bool,
    widths: IntArray,
    grids: FloatArray,
    places: FloatArray,
    out: FloatArray,
    ticks: int,
    begin: int,
    end: int,
) -> None:
    """The kernels of so many ticks of each world, and nothing else but the hint which cells come next."""
    r_o, desired, cell, dt = parameters.r_o, parameters.desired, parameters.cell, parameters.dt
    sensor, peak, reach = parameters.sensor, parameters.peak, parameters.reach
    for k in range(begin, end):
        if k + 1 < end:
            n = k + 1
            of = 2 if full else 0
            fetch_disc(grids[n], places[n, of], places[n, of + 1], cell, widths)
        a_x, a_y, g_x, g_y, grid = places[k, 0], places[k, 1], places[k, 2], places[k, 3], grids[k]
        for _ in range(ticks):
            if full:
                accumulate(grid, a_x, a_y, sensor, peak, reach, cell, dt)
                out[k] += coverage_error(grid, g_x, g_y, r_o, desired, cell)
            else:
                out[k] += accumulate_with_gain(
                    grid, a_x, a_y, g_x, g_y, r_o, desired, sensor, peak, reach, cell, dt
                )
            out[k] += coverage_gradient(
                grid, a_x, a_y, g_x, g_y, r_o, desired, sensor, peak, reach, cell
            )[0]


def _limit(loop: ClosedLoop, *, full: bool, ticks: int, calls: int) -> float:
    """World-steps a second of the kernels alone, at the same places and on the same ground and threads."""
    truth, w = loop.batch.state.truth, loop.batch.parameters
    a, g = loop.batch.tables.escorts[0]
    widths = loop.tables.around if full else loop.tables.seen
    places = np.concatenate([truth.position[:, a], truth.position[:, g]], axis=1)
    out = np.zeros(loop.worlds)

    def call() -> None:
        loop.batch.workers.share(
            _kernels_alone, loop.worlds, w, full, widths, truth.coverage, places, out, ticks
        )

    call()
    return rate(call, calls) * loop.worlds * ticks


def stepped(
    scenario: str | Scenario = "escort",
    *,
    rewards: RewardWeights | None = None,
    worlds: int = WORLDS,
    steps: int = _STEPS,
    limit: bool = True,
) -> Pair:
    """World-steps a second of `vector_env` with estimate and gradient, and beside it of the kernels alone.

    Args:
        scenario: What is flown in each world.
        rewards: Full error (4) at every tick by default; `RATE` needs only the fall of it.
        worlds: How many.
        steps: Of all worlds, that are timed.
        limit: Whether the kernels alone are measured, too; only for one pair of vehicles.
    """
    env = vector_env(
        scenario,
        num_envs=worlds,
        agent="uav_0",
        estimate=True,
        gradient=True,
        rewards=rewards,
    )
    try:
        env.reset(seed=1)
        space: Any = env.single_action_space
        rng = np.random.default_rng(1)
        actions = rng.uniform(space.low, space.high, (16, worlds, *space.shape))
        done = 0

        def step() -> None:
            nonlocal done
            env.step(actions[done % 16])
            done += 1

        rate(step, max(3, steps // 10))
        found = rate(step, steps) * worlds
        return found, _limit(
            env.worlds.loop, full=rewards is None, ticks=1, calls=steps
        ) if limit else None
    finally:
        env.close()


def on_ground() -> Pair:
    """`stepped` with 50 hazards in each world, other ones in each."""
    field = HazardField(kind="block", count=50, radius=(0.3, 0.6), clear=1.5)
    return stepped(msgspec.structs.replace(load_scenario("escort"), hazard_field=(field,)))


def pilots(*, worlds: int = WORLDS, ticks: int = 40) -> Pair:
    """World-steps a second of flights under the law `certified`, error included, beside the kernels alone.

    Args:
        worlds: How many.
        ticks: Of each, one after the other, as in a sweep: a grid stays near its core.
    """
    loop = ClosedLoop(load_scenario("escort"), worlds, pilots={"uav_0": "certified"}, error=True)
    try:
        loop.begin(np.arange(worlds))
        loop.fly(2)
        found = rate(lambda: loop.fly(ticks), 1) * worlds * ticks
        return found, _limit(loop, full=True, ticks=ticks, calls=1)
    finally:
        loop.close()


def _resident() -> float:
    """Memory that this process holds [bytes]; where the system does not say, the most that it has held."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
        return 1024.0 * next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:"))
    except OSError:
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return float(most if sys.platform == "darwin" else 1024 * most)


def growth(worlds: int = WORLDS) -> tuple[float, float]:
    """Bytes per world as counted, and as the process grows by them; in a process that does nothing else."""
    scenario = load_scenario("escort")
    settings = {"external": ("uav_0",), "estimate": True, "gradient": True}
    small = ClosedLoop(scenario, 2, **settings)  # type: ignore[arg-type]
    small.begin([1, 2])
    small.step(np.zeros((2, 1, 2)))
    before = _resident()
    many = ClosedLoop(scenario, worlds, **settings)  # type: ignore[arg-type]
    many.begin(np.arange(worlds))
    many.step(np.zeros((worlds, 1, 2)))
    return float(many.bytes_per_world()), (_resident() - before) / worlds


def memory() -> Pair:
    """Bytes that one more world needs, beside the growth of a process that makes 1,024."""
    told = "import json; from outrider.bench.many import growth; print(json.dumps(growth()))"
    done = subprocess.run(
        [sys.executable, "-P", "-c", told],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=True,
    )
    counted, grown = json.loads(done.stdout)
    return counted, grown


@released
def _triad(a: FloatArray, b: FloatArray, c: FloatArray, begin: int, end: int) -> None:
    for i in range(begin, end):
        a[i] = b[i] + 3.0 * c[i]


def bandwidth() -> Pair:
    """Memory bandwidth [GB/s] of a <- b + 3 c, 24 bytes a number, on all cores, beside one core."""
    arrays = [np.full(_TRIAD, value) for value in (0.0, 1.0, 2.0)]
    found = []
    for threads in (None, 1):
        workers = WorkerThreads(threads)
        workers.share(_triad, _TRIAD, *arrays)
        best = 0.0
        for _ in range(5):
            started = time.perf_counter()
            workers.share(_triad, _TRIAD, *arrays)
            best = max(best, 24e-9 * _TRIAD / (time.perf_counter() - started))
        workers.close()
        found.append(best)
    return found[0], found[1]
