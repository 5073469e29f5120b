"""One tick flown with the user's own functions, to try them."""

from concurrent.futures.process import BrokenProcessPool

import msgspec

from bus.errors import ScenarioError
from bus.registry import DRIVERS
from outrider.running.user_code import own_code
from outrider.running.workers import open_pool
from sim.scenario.types import Scenario


def check_first_tick(scenario: Scenario) -> None:
    """Fly one tick where functions of the user's own fly, so that they are called once.

    In a process of its own: a library that crashes ends that one alone, and only it needs the compiler.

    Raises:
        ScenarioError: If one fails.
    """
    outside = any(DRIVERS[ugv.driver].outside for ugv in scenario.ugv)
    if not own_code(scenario) or outside:
        return
    tick = msgspec.structs.replace(scenario, duration=scenario.dt)
    with open_pool(1) as pool:
        try:
            pool.submit(_fly_for_nothing, tick).result()
        except BrokenProcessPool:
            raise ScenarioError(
                "the process that flies the first tick with your code has crashed"
            ) from None


def _fly_for_nothing(scenario: Scenario) -> None:
    """A worker's: without its results, which need not be pickled."""
    from outrider.running.flying import fly  # noqa: PLC0415 - the compiler is the worker's alone

    fly(scenario, scenario.seed)
