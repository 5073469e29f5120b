"""The work of a sweep's worker process: a few runs of one point, each in this process."""

import time
from functools import cache
from importlib.metadata import version
from typing import Any

from outrider.experiments.sweep.columns import failed_row, row_of
from outrider.running.flying import fly
from outrider.running.warming import warm_up_flight
from sim.scenario.types import Scenario


@cache
def warm_up_once() -> None:
    """Compile everything that a flight needs, once in a process."""
    warm_up_flight()


def fly_run(scenario: Scenario, seed: int) -> dict[str, Any]:
    """The results of one run; of one that raises, why."""
    started = time.perf_counter()
    try:
        summary = fly(scenario, seed)[1]
    except Exception as error:  # noqa: BLE001 - whatever it is, it belongs into this run's row, and the others go on
        return failed_row(error, time.perf_counter() - started)
    return row_of(summary, time.perf_counter() - started)


def fly_runs(scenario: Scenario, seeds: dict[int, int]) -> list[dict[str, Any]]:
    """Fly a scenario with some seeds.

    Args:
        scenario: Scenario of one point.
        seeds: Seeds by the runs' numbers.

    Returns:
        The results, each with its run's number.
    """
    warm_up_once()
    return [{"run": run, **fly_run(scenario, seed)} for run, seed in seeds.items()]


def installed_version() -> str:
    """Of Outrider, where this is called."""
    return version("outrider")
