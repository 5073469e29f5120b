"""Compilation of the code of a flight before its first tick."""

from agents.warming import warm_up as warm_up_pilot
from bus.keys import Role
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.warming import warm_up


def warm_up_flight(scenario: Scenario | None = None) -> None:
    """Compile the world and both kinds of pilot, or load them from the cache.

    Args:
        scenario: Scenario to fly; None: the default scenario.
    """
    warm_up(scenario or load_scenario())
    for role in (Role.UAV, Role.UGV):
        warm_up_pilot(role)
