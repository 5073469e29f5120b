"""Altitude in an attack: an adversary that dives and climbs, and the radius within which the UGV is visible."""

import math
from typing import NamedTuple

import msgspec

from agents.safety.altitude import decide_in_space
from agents.safety.decision import decide
from agents.safety.levels import levels_of
from agents.safety.memory import FilterMemory
from bus.messages.buildings import AltitudeLimits, Camera
from bus.messages.vehicle import UavBriefing
from outrider_falsify.opponents import UAV
from outrider_falsify.rng import RngState, next_share
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray
from sim.engine.briefing import uav_briefing
from sim.engine.world_state import BatchState
from sim.models.altitude import VerticalMotion
from sim.models.safety import SafetyBounds, visible_radius
from sim.models.vehicles import Motion
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


class Heights(NamedTuple):
    """Altitude of an attacked UAV: bounds of its filter by altitude, and the town."""

    levels: RecordArray
    """`SafetyBounds` by increasing floor. Shape (levels,)."""
    town: Town


def at_altitude(scenario: Scenario, limits: AltitudeLimits, camera: Camera, town: Town) -> Scenario:
    """Return a scenario of an attack with a UAV that has an altitude. The world needs no buildings: `Town` judges."""
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


def heights_of(scenario: Scenario, town: Town, briefing: UavBriefing | None = None) -> Heights:
    """Return the bounds of the filter over the worst town.

    Args:
        scenario: Scenario from `at_altitude`.
        town: The town.
        briefing: Briefing of the UAV with the declared bounds; None: the scenario's.
    """
    brief = briefing or uav_briefing(scenario, scenario.uav[0].name, 0)
    brief = msgspec.structs.replace(
        brief,
        max_building_height=town.tallest if town.tallest > 0.0 else None,
        building_clearance=town.clearance,
        marker_height=town.marker,
    )
    return Heights(levels_of(brief), town)


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
    return (2.0 * next_share(random) - 1.0) * max_acceleration


@compiled
def nominal_climb(
    heights: Heights | None, roles: RecordArray, random: RngState, own: VerticalMotion
) -> float:
    """Return the nominal vertical acceleration chosen by the adversary in the UAV [m/s²]; 0 in the plane."""
    if heights is None:
        return 0.0
    if next_share(random) < 0.04:
        roles[0].climb = draw_climb(random, own.max_acceleration)
    climb: float = roles[0].climb
    return 0.0 if math.isnan(climb) else climb


@compiled
def filter_nominal(
    heights: Heights | None,
    bounds: SafetyBounds,
    memory: FilterMemory,
    times: tuple[int, int],
    here: Motion,
    own: VerticalMotion,
    wanted: tuple[float, float, float],
) -> None:
    """Let the filter decide on the nominal accelerations `wanted` [m/s²].

    Args:
        heights: Altitude of the UAV; None: it flies in the plane.
        bounds, memory: Bounds of the filter in the plane, and its memory.
        times: Tick, and first tick of the trajectory that the vehicle executes.
        here, own: Horizontal and vertical state of the UAV.
        wanted: Nominal acceleration, horizontal and vertical.
    """
    if heights is None:
        decide(bounds, memory, times[0], here, wanted[0], wanted[1], times[1])
    else:
        decide_in_space(heights.levels, memory, times[0], here, own, wanted, times[1])
