"""Attack on the safety filter of a UAV that dives and climbs over the worst town."""

import math

import msgspec
import pytest

from bus.messages.buildings import AltitudeLimits, Camera
from outrider_falsify.attack import attack
from outrider_falsify.conditions import Conditions, declared, scenario_of
from outrider_falsify.heights import Town, at_altitude, heights_of
from sim.engine.briefing import uav_briefing

LIMITS = AltitudeLimits(initial_altitude=14.0, max_altitude=30.0)
CAMERA = Camera(half_angle=0.785)
TOWN = Town(r_v=4.75, tangent=math.tan(0.785), marker=0.3, tallest=5.0, clearance=1.5)
CONDITIONS = {
    "perfect": Conditions(),
    "delayed and lossy": Conditions(delay=0.2, max_command_interval=1.0, losses=1),
}


def attacked(name: str, eps: float, town: Town, judged: Town, runs: int) -> tuple[float, float]:
    """Return the certified ticks out of sight, and the broken certificates, of all runs.

    Args:
        name: Conditions.
        eps: Largest detection error [m].
        town: Town that the filter assumes.
        judged: Town by which sight is judged.
        runs: Number of runs.
    """
    conditions = CONDITIONS[name]
    bounds = declared(conditions, eps)
    scenario = at_altitude(scenario_of(bounds, conditions), LIMITS, CAMERA, town)
    brief = uav_briefing(scenario, "uav_0", 0)
    safety = msgspec.structs.replace(
        brief.safety,
        max_measurement_error=eps,
        max_measurement_age=bounds.max_measurement_age,
    )
    heights = heights_of(scenario, town, msgspec.structs.replace(brief, safety=safety))
    assert heights.levels["valid"].all()
    flight = scenario, heights._replace(town=judged)
    found = attack(bounds, conditions, 3, 0, runs, 60.0, flight)
    return float(found["certified_lost"].sum()), float(found["broken"].sum())


@pytest.mark.parametrize("name", CONDITIONS)
def test_no_certified_tick_is_out_of_sight_at_any_altitude(name: str) -> None:
    assert attacked(name, 0.3, TOWN, TOWN, 60) == (0.0, 0.0)


def test_buildings_nearer_than_declared_are_noticed() -> None:
    """The attack is strong enough to find a filter that assumes too much."""
    lost, _ = attacked("perfect", 0.3, TOWN, TOWN._replace(clearance=1.3), 60)
    assert lost > 0.0
