"""The speed of each layer, and in the same run the limit that it stands beside."""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from bus.errors import BusError, ScenarioError
from outrider import reference
from outrider.launch import NOBODY, Outcome, launch
from outrider.pairs import pairs_toml
from outrider.raw_lockstep import ticks_per_second
from outrider.run import InProcess, fly, make_pilots
from sim.compile import FloatArray, compiled
from sim.field import accumulate, coverage_error, coverage_gradient
from sim.flight import Flight
from sim.scenario import Scenario, load_scenario
from sim.world import World

Progress = Callable[[str, float], None]
Pair = tuple[float, float | None]
"""A value, and the reference measured right after it."""


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One measurement and what it stands beside; medians over the repeats."""

    name: str
    value: float
    unit: str
    reference: str
    reference_value: float | None
    ratio: float | None
    """Median of the ratios value / reference, pair by pair; for times reference / value."""


def _rate(work: Callable[[], object], count: int) -> float:
    started = time.perf_counter()
    for _ in range(count):
        work()
    return count / (time.perf_counter() - started)


def _payloads(scenario: Scenario) -> tuple[bytes, bytes]:
    """An observation and a command as they are in the middle of a flight."""
    flight = Flight(scenario, scenario.seed)
    exchange = InProcess(make_pilots(scenario, scenario.seed))
    for _ in range(51):
        observations = flight.observations()
        exchange.publish(observations)
        commands = exchange.collect(flight.world.tick)
        flight.apply(commands)
    return msgspec.json.encode(observations["uav_0"]), msgspec.json.encode(commands["uav_0"])


def _flown(outcome: Outcome) -> float:
    """Ticks a second of a run that has come to its end; a rate of half a run would be no measurement.

    Raises:
        BusError: If it has not.
    """
    if outcome.summary is None or not outcome.summary.complete or outcome.fault:
        raise BusError(f"the run that was to be measured failed: {outcome.fault or 'it was cut short'}")
    return outcome.summary.ticks_per_second


def lockstep() -> Pair:
    """Three processes with everything computed, beside a bare exchange of the same payloads."""
    scenario = load_scenario("escort")
    rate = _flown(launch(scenario, "escort", (), NOBODY, out=None))
    return rate, ticks_per_second(*_payloads(scenario), scenario.ticks)


def access_control() -> Pair:
    """Lockstep with credentials and access control, beside the same without."""
    scenario = load_scenario("escort")
    closed, opened = (_flown(launch(scenario, "escort", (), NOBODY, out=None, secured=secured)) for secured in (True, False))
    return closed, opened


def pairs(count: int) -> Pair:
    """So many UAVs with their UGVs in lockstep, each in a process of its own, beside a bare exchange among as many peers."""
    with tempfile.TemporaryDirectory(prefix="outrider-pairs-") as folder:
        path = Path(folder) / f"pairs-{count}.toml"
        path.write_text(pairs_toml(count, seconds=round(max(10.0, 200.0 / count))), encoding="utf-8")
        scenario = load_scenario(path)
        outcome = launch(scenario, str(path), (), NOBODY, out=None, deadline=120.0, join_timeout=900.0)
    escort = load_scenario("escort")
    return _flown(outcome), ticks_per_second(*_payloads(escort), scenario.ticks, peers=2 * count)


def run_in_process() -> Pair:
    """Both pilots, the filter and the world in one process, beside the world alone."""
    scenario = load_scenario("escort")
    summary = fly(scenario, scenario.seed)[1]
    return summary.ticks_per_second, world_step()[0]


def env_step() -> Pair:
    """`parallel_env().step` with random actions, beside the world alone."""
    from sim.env.parallel import parallel_env  # noqa: PLC0415 - pettingzoo is loaded only where it is used

    env = parallel_env("escort")
    env.reset(seed=1)
    rng = np.random.default_rng(1)
    actions = [{name: rng.uniform(-0.05, 0.05, 2) for name in env.possible_agents} for _ in range(64)]
    steps = 0

    def step() -> None:
        nonlocal steps
        if not env.agents:
            env.reset()
        env.step({name: actions[steps % 64][name] for name in env.agents})
        steps += 1

    _rate(step, 200)
    return _rate(step, 20_000), world_step()[0]


@compiled
def _kernels(coverage: FloatArray, count: int) -> float:
    """The three kernels in a compiled loop: what is left when nothing else is done."""
    total = 0.0
    for k in range(count):
        x = 20.0 + 1e-4 * k
        accumulate(coverage, x, 20.0, 0, 1.0, 5.0, 0.25, 0.0)
        total += coverage_error(coverage, x, 21.0, 9.75, 2.0, 0.25)
        total += coverage_gradient(coverage, x, 20.0, x, 21.0, 9.75, 2.0, 0, 1.0, 5.0, 0.25)[0]
    return total


def _ground() -> FloatArray:
    return np.random.default_rng(0).uniform(0.0, 2.5, (160, 160))


def _kernel_rate(ground: FloatArray) -> float:
    """Passes of the three kernels a second."""
    _kernels(ground, 10)
    return _rate(lambda: _kernels(ground, 20_000), 1) * 20_000


def world_step() -> Pair:
    """`World.step` with coverage, detections, error (4) and gradient (6), beside the three kernels alone."""
    world = World(load_scenario("escort"), 1)
    world.coverage[:] = _ground()
    commands = np.zeros((2, 2))
    w = world.parameters

    def step() -> None:
        world.step(commands)
        world.measure()
        (p_ax, p_ay), (p_gx, p_gy) = world.position.tolist()
        coverage_gradient(world.coverage, p_ax, p_ay, p_gx, p_gy, w.r_o, w.desired, w.sensor, w.peak, w.reach, w.cell)

    _rate(step, 200)
    return _rate(step, 20_000), _kernel_rate(_ground())


def kernel_vs_numpy() -> Pair:
    """Coverage, error and gradient once, compiled, beside the plain NumPy reference."""
    ground = _ground()

    def plain() -> None:
        reference.accumulate(ground, 20.0, 20.0, 0, 1.0, 5.0, 0.25, 0.0)
        reference.coverage_error(ground, 20.0, 21.0, 9.75, 2.0, 0.25)
        reference.coverage_gradient(ground, 20.0, 20.0, 20.0, 21.0, 9.75, 2.0, 0, 1.0, 5.0, 0.25)

    return _kernel_rate(ground), _rate(plain, 50)


def _one_tick(cache: str | None) -> float:
    """Wall time [s] of `outrider run` over a single tick: from its start to the end, so more than to its first tick."""
    environment = os.environ | ({"OUTRIDER_CACHE": cache} if cache else {})
    arguments = [sys.executable, "-m", "outrider", "run", "escort", "--duration", "0.05", "--no-files", "--json"]
    started = time.perf_counter()
    done = subprocess.run(arguments, env=environment, stdin=subprocess.DEVNULL, capture_output=True, check=True)
    seconds = time.perf_counter() - started
    json.loads(done.stdout)
    return seconds


def first_tick() -> Pair:
    """Start to first tick with a warm compile cache, beside a cold one."""
    with tempfile.TemporaryDirectory(prefix="outrider-cold-") as empty:
        cold = _one_tick(empty)
    return _one_tick(None), cold


class Layer(NamedTuple):
    """How a layer is measured."""

    work: Callable[[], Pair]
    unit: str
    """Of both numbers."""
    reference: str
    """What the second number is."""
    most: int = 1_000
    """It is measured no more often than this: what takes minutes is measured once."""


BARE = "bare exchange among as many processes"
ROWS: dict[str, Layer] = {
    "lockstep": Layer(lockstep, "ticks/s", "bare three-process exchange"),
    "access_control": Layer(access_control, "ticks/s", "lockstep without credentials"),
    "run_in_process": Layer(run_in_process, "ticks/s", "world_step"),
    "env_step": Layer(env_step, "steps/s", "world_step"),
    "world_step": Layer(world_step, "steps/s", "its kernels alone, compiled"),
    "kernel_vs_numpy": Layer(kernel_vs_numpy, "passes/s", "plain NumPy"),
    "first_tick": Layer(first_tick, "s", "with an empty compile cache"),
    "pairs_1": Layer(partial(pairs, 1), "ticks/s", BARE),
    "pairs_5": Layer(partial(pairs, 5), "ticks/s", BARE),
    "pairs_10": Layer(partial(pairs, 10), "ticks/s", BARE, 2),
    "pairs_50": Layer(partial(pairs, 50), "ticks/s", BARE, 1),
}


def _measure(name: str, repeats: int) -> Iterator[Pair]:
    layer = ROWS[name]
    for _ in range(min(repeats, layer.most)):
        yield layer.work()


def measure(only: list[str], repeats: int, *, on_progress: Progress | None = None) -> list[Row]:
    """Measure the rows.

    Args:
        only: Names of rows; none means all.
        repeats: Measurements of each; value and reference alternate.
        on_progress: Called with a row's name and the share that is done.

    Raises:
        ScenarioError: If a row does not exist.
    """
    unknown = [name for name in only if name not in ROWS]
    if unknown:
        raise ScenarioError(f"--only {unknown[0]}: no such row; allowed: {', '.join(ROWS)}")
    rows: list[Row] = []
    names = only or list(ROWS)
    for done, name in enumerate(names):
        found: list[Pair] = []
        for pair in _measure(name, repeats):
            found.append(pair)
            if on_progress is not None:
                on_progress(name, (done + len(found) / min(repeats, ROWS[name].most)) / len(names))
        rows.append(_row(name, found))
    return rows


def _row(name: str, pairs: list[Pair]) -> Row:
    unit, beside = ROWS[name].unit, ROWS[name].reference
    references = [other for _, other in pairs if other is not None]
    ratios = [(other / value if unit == "s" else value / other) for value, other in pairs if other]
    return Row(
        name=name,
        value=statistics.median(value for value, _ in pairs),
        unit=unit,
        reference=beside,
        reference_value=statistics.median(references) if references else None,
        ratio=statistics.median(ratios) if ratios else None,
    )
