"""Requests of an operator to the UAVs of a team."""

from bus.errors import ScenarioError
from bus.messages.team import Request, Role
from sim.input.faults import near
from sim.scenario.team import mates_of
from sim.scenario.types import Scenario


def check_request(scenario: Scenario, uav: str, request: Request, role: Role | None) -> None:
    """Raise if a UAV cannot follow an operator's request.

    Args:
        scenario: Scenario of the run.
        uav: Name of the UAV.
        request: The request.
        role: Role that the UAV has reported last; None: none.

    Raises:
        ScenarioError: The UAV is unknown or has no team, or the request does not fit its role.
    """
    uavs = sorted(one.name for one in scenario.uav)
    allowed = ", ".join(uavs) or "none, the scenario has no UAV"
    if uav not in {one.name for one in scenario.vehicles}:
        raise ScenarioError(f"vehicle = {uav!r}: unknown{near(uav, uavs)}; allowed: {allowed}")
    if uav not in uavs:
        raise ScenarioError(f"vehicle = {uav!r}: not a UAV; allowed: {allowed}")
    mates, team = mates_of(scenario, uav), scenario.team
    if team is None:
        raise ScenarioError(f"vehicle = {uav!r}: it has no team; allowed: scenarios with [team]")
    if role is None:
        raise ScenarioError(f"vehicle = {uav!r}: it has reported no role; allowed: UAVs with one")
    if request is Request.GUARD and role is Role.GUARD:
        raise ScenarioError(f"request = 'GUARD': {uav} is already a guard; allowed: RELIEF")
    if request is Request.RELIEF and role is not Role.GUARD:
        raise ScenarioError(
            f"request = 'RELIEF': {uav} is no guard, its role is {role}; allowed: GUARD"
        )
    if request is Request.RELIEF and team.guards >= len(mates):
        raise ScenarioError(
            f"request = 'RELIEF': no UAV can take over, all {len(mates)} guard (team.guards = {team.guards}); "
            "allowed: teams with more UAVs than guards"
        )
