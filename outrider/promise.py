"""Whether a scenario's UAVs can certify that they keep sight, told before it is flown."""

from agents.control.handover import check_assumptions
from agents.control.visibility import promise_of
from bus.messages import UavBriefing
from sim.briefing import briefing
from sim.scenario import Scenario


def promise_warnings(scenario: Scenario) -> tuple[str, ...]:
    """What stands in the way of the law `certified`, one line each; empty for other laws, and where nothing does."""
    if scenario.law.name != "certified":
        return ()
    lines = []
    for uav in scenario.uav:
        told = briefing(scenario, uav.name, scenario.seed)
        if isinstance(told, UavBriefing):
            lines += [f"{uav.name}: not certified: {fault}" for fault in check_assumptions(promise_of(told))]
    return tuple(lines)
