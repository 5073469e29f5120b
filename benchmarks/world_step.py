"""The cost of a world-step, by leaving one thing after the other out, and the least that it can be.

python benchmarks/world_step.py --seconds 15
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from markdown_tables import head

from outrider.bench.kernels import ground
from outrider.bench.many import RATE, WORLDS
from outrider.envs.closed_loop import ClosedLoop
from outrider.envs.vector import vector_env
from sim.env.rewards import RewardWeights
from sim.kernels.compile import FloatArray, compiled
from sim.models.field import (
    accumulate,
    accumulate_with_gain,
    coverage_error,
    coverage_gradient,
    disc_chords,
)
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

_PASSES = 200
_ANEW = 60
"""After so many steps the worlds begin anew: later some would be at the border, which cuts the discs, and cost less."""
_FEW = 16
"""Worlds whose grids stay in the second-level cache."""
_LINE = 64
"""Bytes of a cache line."""
FLOPS = {
    "accumulate": 13,
    "accumulate_with_gain": 45,
    "coverage_error": 30,
    "coverage_gradient": 42,
}
"""Operations of each cell, divisions and comparisons included, counted in sim/models/field.py with the sensor `hill`.
"""


def disc(radius: float, cell: float, width: float) -> tuple[int, float]:
    """Cells of a disc in the middle of the area, and their cache lines, on average over where a line begins.

    Args:
        radius: [m].
        cell: Width of a cell [m].
        width: Of the area, a square [m].
    """
    count = round(width / cell)
    _, (firsts, ends) = disc_chords(0.5 * width, 0.5 * width, radius, cell, count, count)
    lengths = ends - firsts
    return int(lengths.sum()), float(((8 * lengths + _LINE - 8) / _LINE).sum())


def floor(scenario: Scenario) -> dict[str, Any]:
    """Counts what a world-step has to compute and to move, with e(t) at every tick and with only the fall of it.

    The sensor's disc lies within the density's as long as the UGV is in sight, so its lines are counted once.
    """
    cell, width, reach = scenario.area.cell, scenario.area.width, scenario.sensor.range
    seen, seen_lines = disc(reach, cell, width)
    around, around_lines = disc(scenario.visibility.radius + reach, cell, width)
    full = (
        seen * (FLOPS["accumulate"] + FLOPS["coverage_gradient"]) + around * FLOPS["coverage_error"]
    )
    rate = seen * (FLOPS["accumulate_with_gain"] + FLOPS["coverage_gradient"])
    return {
        "cells_sensor": seen,
        "cells_density": around,
        "flops_full": full,
        "flops_rate": rate,
        # read all, write back what was seen
        "bytes_full": math.ceil(_LINE * (around_lines + seen_lines)),
        "bytes_rate": math.ceil(_LINE * 2 * seen_lines),
    }


@compiled
def _again(kernel: int, grid: FloatArray, count: int) -> float:
    """One of the kernels, in the order of `FLOPS`, so many times at about one place."""
    total = 0.0
    for k in range(count):
        x = 20.0 + 1e-4 * k
        if kernel == 0:
            accumulate(grid, x, 20.0, 0, 1.0, 5.0, 0.25, 0.0)
        elif kernel == 1:
            total += accumulate_with_gain(grid, x, 20.0, x, 21.0, 9.75, 2.0, 0, 1.0, 5.0, 0.25, 0.0)
        elif kernel == 2:
            total += coverage_error(grid, x, 21.0, 9.75, 2.0, 0.25)
        else:
            total += coverage_gradient(grid, x, 20.0, x, 21.0, 9.75, 2.0, 0, 1.0, 5.0, 0.25)[0]
    return total


def _loop(
    scenario: Scenario,
    worlds: int,
    threads: int | None,
    **settings: Any,  # noqa: ANN401
) -> Callable[[], None]:
    external = () if "pilots" in settings else ("uav_0",)
    loop = ClosedLoop(scenario, worlds, external=external, threads=threads, **settings)
    actions = np.random.default_rng(1).uniform(-0.05, 0.05, (worlds, len(external), 2))
    done = 0

    def step() -> None:
        nonlocal done
        if done % _ANEW == 0:
            loop.begin(np.arange(worlds))
        done += 1
        if external:
            loop.step(actions)
        else:
            loop.fly(1)

    return step


def _env(
    scenario: Scenario,
    worlds: int,
    threads: int | None,
    **settings: Any,  # noqa: ANN401
) -> Callable[[], object]:
    env = vector_env(scenario, num_envs=worlds, agent="uav_0", threads=threads, **settings)
    env.reset(seed=1)
    actions = np.random.default_rng(1).uniform(-0.05, 0.05, (worlds, 2))
    return lambda: env.step(actions)


def profile(*, seconds: float = 15.0, worlds: int = WORLDS) -> dict[str, float]:
    """The least time [µs] of a world-step in each arrangement.

    Of one core's own time, or the clock's where it says all cores.

    The least, and the core's own: what other programs take is not ours.
    """
    scenario = load_scenario("escort")
    nothing, seen = RewardWeights(uncovered=0.0), {"estimate": True, "gradient": True}
    cases: dict[str, tuple[int, Callable[[], object]]] = {
        "world, links, driver, coverage": (worlds, _loop(scenario, worlds, 1, rewards=nothing)),
        "and Kalman filter": (worlds, _loop(scenario, worlds, 1, rewards=nothing, estimate=True)),
        "and gradient": (worlds, _loop(scenario, worlds, 1, rewards=nothing, **seen)),
        "and fall of the error": (worlds, _loop(scenario, worlds, 1, rewards=RATE, **seen)),
        "and whole error instead": (worlds, _loop(scenario, worlds, 1, **seen)),
        "fall, as vector_env": (worlds, _env(scenario, worlds, 1, rewards=RATE, **seen)),
        "whole, as vector_env": (worlds, _env(scenario, worlds, 1, **seen)),
        "fall, 16 worlds, in cache": (_FEW, _loop(scenario, _FEW, 1, rewards=RATE, **seen)),
        "whole, 16 worlds, in cache": (_FEW, _loop(scenario, _FEW, 1, **seen)),
        "fall, as vector_env, all cores": (
            worlds,
            _env(scenario, worlds, None, rewards=RATE, **seen),
        ),
        "whole, as vector_env, all cores": (worlds, _env(scenario, worlds, None, **seen)),
        "law certified, no error": (
            worlds,
            _loop(scenario, worlds, 1, rewards=nothing, pilots={"uav_0": "certified"}),
        ),
        "law logarithmic, no error": (
            worlds,
            _loop(scenario, worlds, 1, rewards=nothing, pilots={"uav_0": "logarithmic"}),
        ),
    }
    grid = ground()
    for kernel, name in enumerate(FLOPS):
        cases[f"kernel {name}"] = (_PASSES, partial(_again, kernel, grid, _PASSES))
    best = dict.fromkeys(cases, math.inf)
    for _, step in cases.values():
        for _ in range(10):
            step()
    began = time.perf_counter()
    while time.perf_counter() - began < seconds:
        for name, (count, step) in cases.items():
            clock = time.perf_counter if name.endswith("all cores") else time.thread_time
            for _ in range(60 if count == _FEW else 3):
                started = clock()
                step()
                best[name] = min(best[name], 1e6 * (clock() - started) / count)
    return best


def main(words: list[str] | None = None) -> None:
    """Print both as Markdown, or as JSON."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument(
        "--seconds", type=float, default=15.0, help="how long to measure [s] (%(default)s)"
    )
    parser.add_argument("--worlds", type=int, default=WORLDS, help="how many worlds (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args(words)
    least = floor(load_scenario("escort"))
    found = profile(seconds=given.seconds, worlds=given.worlds)
    if given.json:
        sys.stdout.write(json.dumps({"floor": least, "microseconds": found}) + "\n")
        return
    lines = [head("arrangement | µs a world-step | world-steps/s")]
    lines += [f"| {name} | {us:.2f} | {1e6 / us:,.0f} |" for name, us in found.items()]
    lines += ["", "| floor | |", "|---|---|"]
    lines += [f"| {name} | {value:,} |" for name, value in least.items()]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
