"""Work of a sweep's worker process: some runs of one point."""

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
    """Compile the code of a flight, once per process."""
    warm_up_flight()


def fly_run(scenario: Scenario, seed: int) -> dict[str, Any]:
    """Fly a run and return its results, or the error of a failed run."""
    started = time.perf_counter()
    try:
        summary = fly(scenario, seed)[1]
    except Exception as error:  # noqa: BLE001 - any error is stored in the run's row, and other runs continue
        return failed_row(error, time.perf_counter() - started)
    return row_of(summary, time.perf_counter() - started)


def fly_runs(scenario: Scenario, seeds: dict[int, int]) -> list[dict[str, Any]]:
    """Fly a scenario with some seeds.

    Args:
        scenario: Scenario of one point.
        seeds: Seeds by run number.

    Returns:
        The results, each with its run number.
    """
    warm_up_once()
    return [{"run": run, **fly_run(scenario, seed)} for run, seed in seeds.items()]


def installed_version() -> str:
    """Return the version of Outrider in the calling process."""
    return version("outrider")
