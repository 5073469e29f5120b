"""Check of a scenario's own functions against the paper's conditions."""

from agents.control.orbit import check_path
from agents.control.visibility import switching_radius
from agents.control.weighting import check_weighting
from agents.laws.policy import check_fit
from bus.registry import LAWS
from outrider.running.user_code import load_function, own_code
from sim.engine.briefing import uav_briefing
from sim.scenario.types import Scenario


def check_own_functions(scenario: Scenario) -> tuple[str, ...]:
    """Load the scenario's functions and check the paper's conditions, before any process starts.

    Returns:
        Warnings about a path that the UAV cannot follow, one line each.

    Raises:
        ScenarioError: If a function does not exist or violates a condition.
    """
    if not own_code(scenario):
        return ()
    weighting = load_function(scenario.custom.weighting, what="custom.weighting")
    path = load_function(scenario.custom.path, what="custom.path")
    load_function(scenario.custom.policy, what="custom.policy")
    own = load_function(scenario.custom.uav_policy, what="custom.uav_policy")
    ugvs = {ugv.name: ugv for ugv in scenario.ugv}
    warnings: list[str] = []
    for uav in scenario.uav:
        if own is not None:
            briefing = uav_briefing(scenario, uav.name, 0)
            warnings += check_fit(briefing, own, scenario.custom.uav_policy)
        r_v, v_g = scenario.visibility.radius, ugvs[uav.escorts].max_speed
        own_field = LAWS[scenario.law_of(uav).name].own
        if weighting is not None and own_field == "weighting":
            check_weighting(
                weighting, switching_radius(r_v, uav.max_speed, v_g, uav.max_acceleration)
            )
        if path is not None and own_field == "path":
            warnings += check_path(
                path, scenario.duration, r_v, uav.max_speed, v_g, uav.max_acceleration
            )
    return tuple(dict.fromkeys(warnings))
