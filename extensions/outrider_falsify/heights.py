"""Altitude in an attack: an adversary that dives and climbs, and the radius within which the UGV is visible."""

import itertools
import math
from typing import NamedTuple

import msgspec

from agents.safety.altitude import Acceleration, decide_in_space
from agents.safety.decision import decide
from agents.safety.levels import bounds_at, levels_of
from agents.safety.memory import FilterMemory
from bus.messages.buildings import AltitudeLimits, Camera
from bus.messages.vehicle import UavBriefing
from outrider_falsify.conditions import Conditions, scenario_of
from outrider_falsify.opponents import UAV
from outrider_falsify.rng import RngState, next_share
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray
from sim.engine.briefing import uav_briefing
from sim.engine.world_state import BatchState
from sim.models.altitude import VerticalState
from sim.models.safety import SafetyBounds, visible_radius
from sim.models.vehicles import State
from sim.scenario.types import Scenario


class Town(NamedTuple):
    """Worst town that the declared bounds allow, seen from an altitude: buildings stand wherever they hide most."""

    r_v: float
    """Visibility radius [m]."""
    tangent: float
    """Tangent of the camera's half angle."""
    marker: float
    """Height of the UGV's marker [m]."""
    tallest: float
    """Height of the buildings [m]."""
    clearance: float
    """Distance that the UGV keeps from them [m]."""


_LIMITS = (
    AltitudeLimits(initial_altitude=14.0, max_altitude=30.0),
    AltitudeLimits(
        initial_altitude=12.0, max_altitude=20.0, max_climb_rate=4.0, max_vertical_acceleration=3.0
    ),
    AltitudeLimits(
        initial_altitude=9.0,
        min_altitude=0.5,
        max_altitude=40.0,
        max_climb_rate=0.3,
        max_vertical_acceleration=0.1,
    ),
)
"""Agile and sluggish UAVs."""
_TOWNS = ((5.0, 1.5, 0.3), (3.0, 0.8, 0.0), (0.0, 1.5, 0.3))
"""Height of the buildings, clearance and height of the marker [m]."""
FLIGHTS = tuple(itertools.product(_LIMITS, (0.785, 1.2), _TOWNS))
"""Flights with an altitude: vertical limits, half angle of the camera [rad], and town."""


class Heights(NamedTuple):
    """Altitude of an attacked UAV: bounds of its filter by altitude, and the town."""

    levels: RecordArray
    """`SafetyBounds` by increasing floor. Shape (levels,)."""
    town: Town


def _at_altitude(
    scenario: Scenario, limits: AltitudeLimits, camera: Camera, town: Town
) -> Scenario:
    """Return a scenario in which the UAV has an altitude. The world needs no buildings: `Town` judges."""
    uav = msgspec.structs.replace(
        scenario.uav[0],
        initial_altitude=limits.initial_altitude,
        min_altitude=limits.min_altitude,
        max_altitude=limits.max_altitude,
        max_climb_rate=limits.max_climb_rate,
        max_vertical_acceleration=limits.max_vertical_acceleration,
    )
    ugv = msgspec.structs.replace(scenario.ugv[0], marker_height=town.marker)
    return msgspec.structs.replace(scenario, camera=camera, uav=(uav,), ugv=(ugv,))


def _setting(
    bounds: SafetyBounds, conditions: Conditions, flight: int
) -> tuple[Scenario, Town, UavBriefing]:
    """Return the scenario of a flight, its town, and the briefing of the UAV with the bounds of the attack."""
    limits, half_angle, (tallest, clearance, marker) = FLIGHTS[flight]
    town = Town(conditions.r_v, math.tan(half_angle), marker, tallest, clearance)
    camera = Camera(half_angle=half_angle)
    scenario = _at_altitude(scenario_of(bounds, conditions), limits, camera, town)
    brief = uav_briefing(scenario, scenario.uav[0].name, 0)
    brief = msgspec.structs.replace(
        brief,
        safety=msgspec.structs.replace(
            brief.safety,
            max_measurement_error=bounds.max_measurement_error,
            max_measurement_age=bounds.max_measurement_age,
        ),
        max_building_height=tallest or None,
        guaranteed_clearance=clearance,
        marker_height=marker,
    )
    return scenario, town, brief


def certifiable(bounds: SafetyBounds, conditions: Conditions, flight: int) -> bool:
    """Return whether the highest altitude of a flight can be certified. Arguments as in `over_town`."""
    _, _, brief = _setting(bounds, conditions, flight)
    return bounds_at(brief, FLIGHTS[flight][0].max_altitude).valid


def over_town(
    bounds: SafetyBounds, conditions: Conditions, flight: int
) -> tuple[Scenario, Heights]:
    """Return the scenario of an attacked UAV with an altitude, and the bounds of its filter.

    Args:
        bounds: Declared bounds in the plane.
        conditions: Conditions of the attack.
        flight: Row of `FLIGHTS`.
    """
    scenario, town, brief = _setting(bounds, conditions, flight)
    return scenario, Heights(levels_of(brief), town)


@compiled
def sight_radius(heights: Heights | None, state: BatchState, r_v: float) -> float:
    """Return the radius within which the UGV is certainly visible now [m]; r_v in the plane."""
    if heights is None:
        return r_v
    town = heights.town
    radius: float = visible_radius(
        state.vehicles[0, UAV].vertical.altitude,
        town.r_v,
        town.tangent,
        town.marker,
        town.tallest,
        town.clearance,
    )
    return radius


@compiled
def draw_climb(random: RngState, max_acceleration: float) -> float:
    """Draw the adversary's vertical acceleration [m/s²]; NaN: it levels off."""
    share = next_share(random)
    if share < 0.4:
        return -max_acceleration
    if share < 0.6:
        return max_acceleration
    if share < 0.7:
        return math.nan
    if share < 0.85:  # down to the order of rounding errors
        share = math.pow(10.0, -16.0 * next_share(random))
        return -max_acceleration * share
    return (2.0 * next_share(random) - 1.0) * max_acceleration


@compiled
def nominal_climb(
    heights: Heights | None, roles: RecordArray, random: RngState, vertical: VerticalState
) -> float:
    """Return the nominal vertical acceleration chosen by the adversary in the UAV [m/s²]; 0 in the plane."""
    if heights is None:
        return 0.0
    if next_share(random) < 0.04:
        roles[0].climb = draw_climb(random, vertical.max_acceleration)
    climb: float = roles[0].climb
    return 0.0 if math.isnan(climb) else climb


@compiled
def filter_nominal(
    heights: Heights | None,
    bounds: SafetyBounds,
    memory: FilterMemory,
    times: tuple[int, int],
    own: State,
    vertical: VerticalState,
    nominal: Acceleration,
) -> None:
    """Let the filter decide on the nominal accelerations.

    Args:
        heights: Altitude of the UAV; None: it flies in the plane.
        bounds, memory: Bounds of the filter in the plane, and its memory.
        times: Tick, and first tick of the trajectory that the vehicle executes.
        own, vertical: Horizontal and vertical state of the UAV.
        nominal: Nominal acceleration.
    """
    if heights is None:
        decide(bounds, memory, times[0], own, nominal.x, nominal.y, times[1])
    else:
        decide_in_space(heights.levels, memory, times[0], own, vertical, nominal, times[1])
