"""Trial of the user's functions, and of bodies, for one tick."""

from concurrent.futures.process import BrokenProcessPool

import msgspec

from bus.errors import ScenarioError
from bus.registry import BODIES, DRIVERS
from outrider.running.user_code import own_code
from outrider.running.workers import open_pool
from sim.scenario.types import Scenario


def check_first_tick(scenario: Scenario) -> None:
    """Fly one tick if the scenario uses the user's functions or a UAV has another body, so that each is called once.

    The tick is flown in another process: a crashing library ends only that process, and only it needs the compiler.

    Raises:
        ScenarioError: If a function fails, or a body does not suit its UAV.
    """
    outside = any(DRIVERS[ugv.driver].outside for ugv in scenario.ugv)
    outside |= any(BODIES[uav.body].reported for uav in scenario.uav)
    has_body = any(BODIES[uav.body].make for uav in scenario.uav)
    if not (own_code(scenario) or has_body) or outside:
        return
    tick = msgspec.structs.replace(scenario, duration=scenario.dt)
    with open_pool(1) as pool:
        try:
            pool.submit(_try, tick).result()
        except BrokenProcessPool:
            raise ScenarioError(
                "the process that tried your code for one tick has crashed; check the library that it calls"
            ) from None


def _try(scenario: Scenario) -> None:
    """Fly a scenario in a worker, and drop the results, which cannot be pickled."""
    from outrider.running.flying import fly  # noqa: PLC0415 - only the worker needs the compiler

    fly(scenario, scenario.seed)
