"""Counting and printing, common to all runners.

Standard library only, since it runs in every environment.
"""

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

Step = Callable[[], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """Row of the table."""

    name: str
    worlds: int
    """Worlds that step together."""
    agents: int
    """Agents in each world."""
    field: bool
    """True if the world holds a field over the ground, such as coverage."""
    make: Callable[[], Step]
    """Constructor of the environment and its random actions; its result is timed."""
    steps: int = 1
    """Steps of each world in one call of what `make` returns."""


class Watch:
    """Monitor of the load by other programs."""

    def __init__(self) -> None:
        self._busy, self._total = _cores()
        self._own = time.process_time()

    def others(self) -> float | None:
        """Return the share of the cores used by other programs since the start; None if unknown."""
        busy, total = _cores()
        if total <= self._total:
            return None
        own = (time.process_time() - self._own) * os.sysconf("SC_CLK_TCK")
        return max(0.0, (busy - self._busy - own) / (total - self._total))


def _cores() -> tuple[float, float]:
    """Return the busy time of all cores and their total time [clock ticks]; zeros if unknown."""
    try:
        words = Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()
    except OSError:
        return 0.0, 0.0
    user, nice, system, idle, disk, irq, softirq, stolen = map(float, words[1:9])
    busy = user + nice + system + irq + softirq + stolen
    return busy, busy + idle + disk


def random_steps(env: Any, count: int, seed: int) -> Step:  # noqa: ANN401 - this file knows no package
    """Return a step of a PettingZoo parallel environment with cyclic random actions of all agents.

    Finished episodes restart.
    """
    env.reset(seed=seed)
    names = env.possible_agents
    for name in names:
        env.action_space(name).seed(seed)
    actions = cycle(
        [{name: env.action_space(name).sample() for name in names} for _ in range(count)]
    )

    def step() -> None:
        if not env.agents:
            env.reset()
        env.step(next(actions))

    return step


def calls_per_second(step: Step, seconds: float) -> float:
    """Return the call rate [1/s]; at least one call and at least this duration [s] are measured."""
    calls, started = 0, time.perf_counter()
    while True:
        step()
        calls += 1
        passed = time.perf_counter() - started
        if passed >= seconds:
            return calls / passed


def measure(variant: Variant, seconds: float, repeats: int) -> dict[str, object]:
    """Return world-steps per second without warm-up; one step of one world with all its agents counts one."""
    step = variant.make()
    step()
    calls_per_second(step, seconds / 3.0)
    watch = Watch()
    rates = [
        calls_per_second(step, seconds) * variant.worlds * variant.steps for _ in range(repeats)
    ]
    return {
        "others": watch.others(),
        "steps_per_second": statistics.median(rates),
        "slowest": min(rates),
        "fastest": max(rates),
    }


def run(name: str, version: str, variants: Iterable[Variant]) -> None:
    """Measure the variants and print each as a line of JSON at once.

    A failed variant is reported; the others continue.

    Args:
        name: What people call the package.
        version: Of the package, and of what its speed hangs on.
        variants: The rows.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    for variant in variants:
        line: dict[str, object] = {
            "name": name,
            "variant": variant.name,
            "worlds": variant.worlds,
            "version": version,
        }
        try:
            line |= {"agents": variant.agents, "field": variant.field}
            line |= measure(variant, given.seconds, given.repeats)
        except Exception as error:  # noqa: BLE001 - the package's other rows still count
            line["error"] = f"{type(error).__name__}: {error}"
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()
