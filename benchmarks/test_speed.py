"""Speed of each layer beside its limit in the same run, and the duration of two starts: `make bench`.

Each test is a row of the results. `docs/explanation/performance.md` says what a row measures.
"""

import json
import os
import resource
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import bare_exchange
import numba
import numpy as np
import numpy.typing as npt
import pytest

from outrider import parallel_env, vector_env
from sim.engine.batch import Batch
from sim.models.field import accumulate, coverage_error, coverage_gradient
from sim.models.sensor import SensorParameters
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.world import World

WORLDS = 1024
_PASSES = 50
"""Passes of the kernels in one call: many, so that the call costs little; short, so that few are preempted."""
_PART = 64
"""Worlds that a thread takes at once."""
_PEERS = Path(__file__).parent / "peers" / "peers.py"

FloatArray = npt.NDArray[np.float64]
Work = AbstractContextManager[tuple[Callable[[], object], int]]
"""A function to be timed, and the world-steps in one call of it."""


def beside(value: Callable[..., Any], limit: Callable[..., Any]) -> pytest.MarkDecorator:
    """Measure the value of a row and, right after it, its limit."""
    return pytest.mark.parametrize("side", [value, limit], ids=["value", "limit"])


def time_steps(benchmark: Any, work: Work) -> None:
    """Measure world-steps per second."""
    with work as (call, steps):
        benchmark.extra_info.update(unit="steps/s", steps=steps)
        for _ in range(5):
            call()
        benchmark(call)


def time_runs(benchmark: Any, run: Callable[[], float], unit: str, rounds: int) -> None:
    """Take the median of the rates reported by the runs, without their start."""
    rates: list[float] = []
    benchmark.pedantic(lambda: rates.append(run()), rounds=rounds)
    benchmark.extra_info.update(unit=unit, rate=statistics.median(rates))


# One world


def random_coverage(worlds: int) -> FloatArray:
    """Return coverage grids of `escort` with some cells covered (C* = 2)."""
    return np.random.default_rng(0).uniform(0.0, 2.5, (worlds, 160, 160))


_SENSOR = SensorParameters(0, 1.0, 5.0)
"""Numbers of `escort`."""


def start_positions(count: int) -> FloatArray:
    """Return the positions of UAV and UGV at the start of `escort`, repeated. Shape (count, 4)."""
    return np.tile(World(load_scenario("escort"), 1).position.ravel(), (count, 1))


@numba.njit(error_model="numpy", nogil=True)
def _kernels(grids: FloatArray, positions: FloatArray, begin: int, end: int) -> float:
    """Apply (3), (4) and (6) with the parameters of `escort`, one grid after the other."""
    total = 0.0
    for k in range(begin, end):
        grid = grids[k % len(grids)]
        a_x, a_y, g_x, g_y = positions[k, 0], positions[k, 1], positions[k, 2], positions[k, 3]
        accumulate(grid, a_x, a_y, _SENSOR, 0.25, 0.05)
        total += coverage_error(grid, g_x, g_y, 9.75, 2.0, 0.25)
        total += coverage_gradient(grid, a_x, a_y, g_x, g_y, 9.75, 2.0, _SENSOR, 0.25)[0]
    return total


@contextmanager
def kernels() -> Iterator[tuple[Callable[[], object], int]]:
    """Yield the three coverage kernels on one grid."""
    grids, positions = random_coverage(1), start_positions(_PASSES)
    yield lambda: _kernels(grids, positions, 0, _PASSES), _PASSES


@contextmanager
def engine_step() -> Iterator[tuple[Callable[[], object], int]]:
    """Yield one `World.step` with detections, coverage, error (4) and gradient (6)."""
    world = World(load_scenario("escort"), 1)
    world.coverage[:] = random_coverage(1)[0]
    commands = np.zeros((2, 2))

    def step() -> None:
        world.step(commands)
        world.received(0)
        world.measure()
        (a_x, a_y), (g_x, g_y) = world.position.tolist()
        coverage_gradient(world.coverage, a_x, a_y, g_x, g_y, 9.75, 2.0, _SENSOR, 0.25)

    yield step, 1


@contextmanager
def environment_step() -> Iterator[tuple[Callable[[], object], int]]:
    """Yield one `parallel_env.step` with random actions."""
    env = parallel_env("escort")
    env.reset(seed=1)
    actions = np.random.default_rng(1).uniform(-0.05, 0.05, (64, len(env.possible_agents), 2))
    taken = 0

    def step() -> None:
        nonlocal taken
        if not env.agents:
            env.reset()
        env.step(dict(zip(env.agents, actions[taken % 64], strict=True)))
        taken += 1

    yield step, 1


@beside(engine_step, kernels)
def test_world_step(benchmark: Any, side: Callable[[], Work]) -> None:
    """`World.step` beside its kernels."""
    time_steps(benchmark, side())


@beside(environment_step, engine_step)
def test_env_step(benchmark: Any, side: Callable[[], Work]) -> None:
    """`parallel_env.step` beside `World.step`."""
    time_steps(benchmark, side())


# Buildings

_HAZARD = 'hazard=[{kind="block", center=[39.0, 1.0], radius=0.3}]'
_EPISODE = 400
"""Ticks until a world starts again."""


def _blocks() -> str:
    """Return 30 blocks with sides of 4 m to 6 m and heights of 3 m to 8 m, evenly over an area of 40 m x 40 m."""
    rng, blocks = np.random.default_rng(0), []
    for k in range(30):
        x, y = 1.5 + 7.6 * (k % 5), 1.5 + 6.4 * (k // 5)
        across, deep, height = rng.uniform((4.0, 4.0, 3.0), (6.0, 5.0, 8.0)).round(1).tolist()
        right, top = x + across, y + deep
        corners = f"[[{x}, {y}], [{right}, {y}], [{right}, {top}], [{x}, {top}]]"
        blocks.append(f"{{polygon={corners}, height={height}}}")
    return f"building=[{', '.join(blocks)}]"


def _among(ground: str) -> Scenario:
    """Return a scenario with a UAV at 14 m above a UGV that drives from a corner of the area, on this ground."""
    changes = ["building_field=[]", 'ugv.0.driver="waypoints"', "ugv.0.building_clearance=0"]
    start = ["ugv.0.position=[0.7, 0.7]", "ugv.0.goals=[]"]
    return load_scenario("town", overrides=[*changes, *start, ground])


@contextmanager
def step_in_world(ground: str) -> Iterator[tuple[Callable[[], object], int]]:
    """Yield one `World.step` with detections and e(t) (4) on this ground."""
    scenario = _among(ground)
    accelerations = np.random.default_rng(1).uniform(-0.3, 0.3, (64, 2, 2))
    world = World(scenario, 1)

    def step() -> None:
        nonlocal world
        if world.tick == _EPISODE:
            world = World(scenario, 1)
        world.step(accelerations[world.tick % 64])
        world.received(0)
        world.measure()

    yield step, 1


@contextmanager
def step_in_batch(ground: str) -> Iterator[tuple[Callable[[], object], int]]:
    """Yield one step of many worlds on this ground, with commands and links."""
    batch = Batch(_among(ground), _PART, threads=1)
    batch.begin(list(range(_PART)))
    accelerations = np.random.default_rng(1).uniform(-0.3, 0.3, (64, _PART, 2, 2))
    taken = 0

    def step() -> None:
        nonlocal taken
        if taken % _EPISODE == 0:
            batch.begin(list(range(_PART)))
        vehicles = batch.state.vehicles
        vehicles["outgoing"] = accelerations[taken % 64]
        vehicles["outgoing_tick"] = batch.state.ticks[:, None]
        batch.advance()
        taken += 1

    yield step, _PART


@beside(partial(step_in_world, _blocks()), partial(step_in_world, _HAZARD))
def test_buildings(benchmark: Any, side: Callable[[], Work]) -> None:
    """`World.step` among 30 buildings, of which four are in the UAV's range, beside one with a hazard instead."""
    time_steps(benchmark, side())


@beside(partial(step_in_batch, _blocks()), partial(step_in_batch, _HAZARD))
def test_batch_buildings(benchmark: Any, side: Callable[[], Work]) -> None:
    """The same for the compiled step of a batch without pilots."""
    time_steps(benchmark, side())


# Many worlds


@contextmanager
def _vector_step(**settings: bool) -> Iterator[tuple[Callable[[], object], int]]:
    env = vector_env("escort", num_envs=WORLDS, agent="uav_0", **settings)
    env.reset(seed=1)
    space: Any = env.single_action_space
    actions = np.random.default_rng(1).uniform(space.low, space.high, (16, WORLDS, *space.shape))
    taken = 0

    def step() -> None:
        nonlocal taken
        env.step(actions[taken % 16])
        taken += 1

    yield step, WORLDS
    env.close()


def vector_step() -> Work:
    """Return one step of all worlds with the estimator, the gradient and e(t) (4)."""
    return _vector_step(estimate=True, gradient=True)


@contextmanager
def shared_kernels() -> Iterator[tuple[Callable[[], object], int]]:
    """Yield the three coverage kernels on as many grids, shared by threads on all cores."""
    grids, positions = random_coverage(WORLDS), start_positions(WORLDS)
    _kernels(grids, positions, 0, 1)
    with ThreadPoolExecutor(os.cpu_count()) as threads:

        def step() -> None:
            parts = range(0, WORLDS, _PART)
            list(threads.map(lambda k: _kernels(grids, positions, k, k + _PART), parts))

        yield step, WORLDS


@pytest.mark.benchmark(max_time=5.0)
@beside(vector_step, shared_kernels)
def test_vector_1024(benchmark: Any, side: Callable[[], Work]) -> None:
    """`vector_env.step` with 1,024 worlds beside its kernels."""
    time_steps(benchmark, side())


def time_vector(benchmark: Any, _folder: Path) -> None:
    """Measure one step of all worlds with the default settings."""
    time_steps(benchmark, _vector_step())


def time_vmas(benchmark: Any, folder: Path) -> None:
    """Measure VMAS' scenario `sampling` with as many worlds, in a virtual environment of its own."""

    def run() -> float:
        command = [sys.executable, str(_PEERS), "--only", "vmas", "--seconds", "1", "--json"]
        done = subprocess.run(
            [*command, "--out", str(folder)], capture_output=True, check=False, text=True
        )
        report = json.loads(done.stdout)
        for row in report["rows"]:
            if (row["variant"], row["worlds"]) == ("sampling", WORLDS):
                return float(row["steps_per_second"])
        reasons = [f"{failure['what']}: {failure['reason']}" for failure in report["failures"]]
        pytest.skip(f"VMAS was not measured: {'; '.join(reasons)}")

    time_runs(benchmark, run, "steps/s", rounds=1)


@pytest.mark.benchmark(max_time=5.0)
@beside(time_vector, time_vmas)
def test_vmas_sampling(benchmark: Any, side: Callable[..., None], tmp_path: Path) -> None:
    """`vector_env.step` with 1,024 worlds beside a sampling scenario of another package."""
    side(benchmark, tmp_path)


# Processes


def outrider_run(folder: Path, *options: str, **environment: str) -> dict[str, Any]:
    """Run `escort` over three processes and return the summary."""
    done = subprocess.run(
        [sys.executable, "-P", "-m", "outrider", "run", *options, "--json"],
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        check=True,
    )
    return dict(json.loads(done.stdout))


def lockstep_run(folder: Path) -> float:
    """Return the ticks per second of a run, without its start."""
    return float(outrider_run(folder, "--duration", "100")["ticks_per_second"])


def exchange_run(_folder: Path) -> float:
    """Return the ticks per second of the bare exchange."""
    return bare_exchange.ticks_per_second(2000)


@beside(lockstep_run, exchange_run)
def test_lockstep(benchmark: Any, side: Callable[[Path], float], tmp_path: Path) -> None:
    """`outrider run` beside the bare exchange of the same payloads."""
    time_runs(benchmark, lambda: side(tmp_path), "ticks/s", rounds=5)


def children_cpu_seconds() -> float:
    """Return the processor time of all finished child processes [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


@pytest.mark.benchmark(timer=children_cpu_seconds)
def test_first_start(benchmark: Any, tmp_path: Path) -> None:
    """`outrider run --duration 1` with an empty compile cache, in CPU-seconds of all processes."""
    benchmark.extra_info["unit"] = "CPU-s"
    cache = str(tmp_path / "cache")
    benchmark.pedantic(lambda: outrider_run(tmp_path, "--duration", "1", OUTRIDER_CACHE=cache))


def test_warm_start(benchmark: Any, tmp_path: Path) -> None:
    """`outrider run --duration 1` with a filled compile cache, in seconds of wall time."""
    benchmark.extra_info["unit"] = "s"
    benchmark.pedantic(lambda: outrider_run(tmp_path, "--duration", "1"), rounds=5, warmup_rounds=1)
