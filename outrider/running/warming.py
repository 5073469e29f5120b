"""Compiles or loads all that a flight compiles, before anybody waits for it."""

from agents.process import warm_up as warm_up_pilot
from bus.keys import Role
from sim.kernels.compile import compiling
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import warm_up


def warm_up_flight(scenario: Scenario | None = None) -> None:
    """Compile the world and both kinds of pilot, or load what another process has compiled.

    Args:
        scenario: What is to be flown; None: the default one.
    """
    with compiling("world", "uav", "ugv"):
        warm_up(scenario or load_scenario())
        for role in (Role.UAV, Role.UGV):
            warm_up_pilot(role)
