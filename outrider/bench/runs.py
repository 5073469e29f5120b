"""Whole runs: over the bus, in one process, in sweeps, and how long they take to begin."""

import json
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import msgspec

from bus.errors import BusError
from outrider.bench.kernels import world_step
from outrider.bench.pairs import many_pairs
from outrider.bench.raw_lockstep import ticks_per_second
from outrider.bench.timing import Pair
from outrider.experiments.falsify.saving import as_toml
from outrider.running.child import outrider_command
from outrider.running.flying import InProcess, fly, make_pilots
from outrider.running.launch import NOBODY, Outcome, Output, launch
from sim.kernels.threads import cores
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight
from sim.server.run_timing import Timing

_SECONDS = 100.0
"""Length of a flight over three processes [s]: 2,000 ticks."""


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
        raise BusError(
            f"the run that was to be measured failed: {outcome.fault or 'it was cut short'}"
        )
    return outcome.summary.ticks_per_second


def lockstep() -> Pair:
    """Three processes with everything computed, beside a bare exchange of the same payloads."""
    scenario = load_scenario("escort", overrides={"duration": _SECONDS})
    outcome = launch(scenario, "escort", (f"duration={_SECONDS}",), NOBODY, Output())
    return _flown(outcome), ticks_per_second(*_payloads(scenario), scenario.ticks)


def pairs(count: int) -> Pair:
    """So many pairs in lockstep, each vehicle in a process of its own, beside a bare exchange among as many peers."""
    scenario = many_pairs(count, seconds=round(max(10.0, 200.0 / count)))
    with tempfile.TemporaryDirectory(prefix="outrider-pairs-") as folder:
        path = Path(folder) / "pairs.toml"
        path.write_text(as_toml(scenario, []), encoding="utf-8")
        outcome = launch(
            scenario,
            str(path),
            (),
            NOBODY,
            Output(),
            timing=Timing(deadline=120.0, join_timeout=900.0),
        )
    escort = load_scenario("escort")
    return _flown(outcome), ticks_per_second(*_payloads(escort), scenario.ticks, peers=2 * count)


def run_in_process() -> Pair:
    """Both pilots, the filter and the world in one process, beside the world alone."""
    scenario = load_scenario("escort")
    fly(msgspec.structs.replace(scenario, duration=1.0), scenario.seed)  # loads what is compiled
    summary = fly(scenario, scenario.seed)[1]
    return summary.ticks_per_second, world_step()[0]


def sweep(*, seconds: float = 60.0, seeds: int = 16) -> Pair:
    """Runs a second of a small sweep on all cores, its workers already there, beside one process times the cores.

    Args:
        seconds: Duration of each run [s].
        seeds: How often each of the four points is flown.
    """
    from outrider.experiments.sweep.definition import describe_sweep  # noqa: PLC0415 - an extra, as the next three
    from outrider.experiments.sweep.folder import SweepFolder  # noqa: PLC0415
    from outrider.experiments.sweep.plan import lay_out  # noqa: PLC0415
    from outrider.experiments.sweep.running import fly_sweep  # noqa: PLC0415

    def flown(count: int) -> float:
        settings: dict[str, Any] = {
            "laws": "logarithmic,certified",
            "vary": ("links.detections.delay=0,0.5",),
            "changes": (f"duration={seconds}",),
        }
        plan = lay_out(describe_sweep("escort", seeds=count, **settings)[0])
        with (
            tempfile.TemporaryDirectory(prefix="outrider-sweep-") as out,
            SweepFolder(Path(out), plan, command="bench") as folder,
        ):
            started = time.perf_counter()
            fly_sweep(plan, folder, jobs=cores())
            folder.finish()
            scenarios.extend(point.scenario for point in plan.points)
            return plan.runs / (time.perf_counter() - started)

    scenarios: list[Scenario] = []
    flown(cores())  # the processes start, and load what is compiled
    runs_per_second = flown(seeds)
    each = [_seconds_of(scenario) for scenario in scenarios[-4:]]
    return runs_per_second, cores() / statistics.mean(each)


def _seconds_of(scenario: Scenario) -> float:
    fly(msgspec.structs.replace(scenario, duration=1.0), 0)
    started = time.perf_counter()
    for seed in range(2):
        fly(scenario, seed)
    return (time.perf_counter() - started) / 2


def _one_tick(cache: str) -> float:
    """Wall time [s] of `outrider run` over a single tick: from its start to the end, so more than to its first tick."""
    environment = os.environ | {"OUTRIDER_CACHE": cache}
    command = outrider_command("run", "escort", "--duration", "0.05", "--no-files", "--json")
    started = time.perf_counter()
    done = subprocess.run(
        command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, check=True
    )
    seconds = time.perf_counter() - started
    json.loads(done.stdout)
    return seconds


def first_tick() -> Pair:
    """Start to first tick with a warm compile cache, beside a cold one."""
    with tempfile.TemporaryDirectory(prefix="outrider-cold-") as cache:
        cold = _one_tick(cache)
        return _one_tick(cache), cold
