"""Shares of a tick's time when both pilots fly in one process, beside the world's step alone.

python benchmarks/one_flight.py --flights 6
"""

import argparse
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from markdown_tables import head

from agents.process import Pilot
from agents.uav import UavPilot
from outrider.bench.kernels import world_stepper
from outrider.running.flying import InProcess, make_pilots
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight
from sim.world import World

_WINDOW = 100
"""Ticks that are timed together: the thread's own clock costs a third of a microsecond."""
_QUIET = 10
"""The percentile that is shown: what others do on the machine only ever adds."""
WORLD, WHOLE = "`World.step` with error and gradient", "a tick of the flight"
ALONE = "`World.step` alone, over and over"
Times = dict[str, list[float]]


def _timed(
    spent: dict[str, float],
    name: str,
    work: Callable[..., Any],
    *given: Any,  # noqa: ANN401 - whatever it takes and gives
    **named: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    started = time.perf_counter()
    result = work(*given, **named)
    spent[name] += time.perf_counter() - started
    return result


def parts(flight: Flight, pilots: dict[str, Pilot]) -> dict[str, tuple[Any, str]]:
    """The parts of a tick: an object, and its method; those that begin with a dash are within the one above."""
    found: dict[str, tuple[Any, str]] = {
        "observations": (flight, "observations"),
        "the tick recorded, commands taken and applied": (flight, "apply"),
        "- row of the record, with e(t)": (flight.recorder, "record"),
        "- answers counted, reports held against the truth": (flight.answers, "settle"),
        "- the world moves": (flight.world, "advance"),
    }
    for name, pilot in pilots.items():
        found[f"pilot of {name}"] = pilot, "act"
        if isinstance(pilot, UavPilot):
            found |= {
                "- map, estimator and safety filter updated": (pilot, "perceive"),
                "- of it the estimator, by filterpy": (pilot.estimator, "update"),
            }
    return found


def _fly(scenario: Scenario, times: Times, *, apart: bool) -> None:
    """One flight: each part by the wall clock, or windows of whole ticks by the thread's own."""
    flight, pilots = Flight(scenario, scenario.seed), make_pilots(scenario, scenario.seed)
    clock, spent = [time.thread_time()], defaultdict[str, float](float)
    if apart:
        for name, (owner, method) in parts(flight, pilots).items():
            times.setdefault(name, [])  # in this order
            setattr(owner, method, partial(_timed, spent, name, getattr(owner, method)))

    def on_tick() -> None:
        for name, seconds in spent.items():
            times[name].append(seconds)
        spent.clear()
        if flight.world.tick % _WINDOW == 0:
            clock.append(time.thread_time())

    flight.fly(InProcess(pilots), on_tick=on_tick)
    if not apart:
        times[WHOLE] += (np.diff(clock) / _WINDOW).tolist()


def measure(flights: int) -> dict[str, float]:
    """Microseconds of each part of a tick, the lower end of many."""
    scenario, times = load_scenario("escort"), defaultdict[str, list[float]](list)
    _fly(scenario, defaultdict(list), apart=False)  # loads what is compiled
    for _ in range(flights):
        _fly(scenario, times, apart=False)
        _fly(scenario, times, apart=True)
        world, commands = World(scenario, 1), np.zeros((2, 2))
        for name, step in ((ALONE, partial(world.step, commands)), (WORLD, world_stepper())):
            for _ in range(scenario.ticks // _WINDOW):
                started = time.thread_time()
                for _ in range(_WINDOW):
                    step()
                times[name].append((time.thread_time() - started) / _WINDOW)
    return {name: 1e6 * float(np.percentile(each, _QUIET)) for name, each in times.items()}


def main(words: list[str] | None = None) -> None:
    """Print it as Markdown."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--flights", type=int, default=6, help="how many (%(default)s)")
    found = measure(parser.parse_args(words).flights)
    lines = [head("part | µs"), *(f"| {name} | {us:.1f} |" for name, us in found.items())]
    lines += [f"| ratio | {found[WORLD] / found[WHOLE]:.2f} |"]
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
