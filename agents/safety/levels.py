"""Bounds of the safety filter by altitude: the lowest certified altitude, and a table of bounds above it."""

import functools
import math

import msgspec
import numpy as np

from agents.safety.altitude import FLOOR_MARGIN
from agents.safety.handover import certificate, handover_bound
from bus.messages.vehicle import UavBriefing
from sim.compiling.records import RecordArray, records
from sim.models.safety import SafetyBounds, safety_bounds, visible_radius

MOST_LEVELS = 12
"""Maximum number of rows of the table."""
_PRECISION = 0.01
"""Precision of the lowest certified altitude [m]."""


def bounds_at(briefing: UavBriefing, z: float | None = None) -> SafetyBounds:
    """Return the bounds of a UAV's safety filter, hand-over included, that hold from an altitude on.

    Args:
        briefing: Briefing of the UAV.
        z: Altitude [m]; None: the UAV flies in the plane.
    """
    (v_a, u_a), (v_g, _) = briefing.limits.numbers, briefing.target_limits.numbers
    radius = briefing.visibility_radius
    if z is not None:
        radius = radius_at(briefing, z - FLOOR_MARGIN)
    bounds = certificate(
        safety_bounds(
            briefing.safety,
            visibility_radius=radius,
            v_a=v_a,
            u_a=u_a,
            v_g=v_g,
            dt=briefing.dt,
            width=briefing.area.width,
            height=briefing.area.height,
            floor=-math.inf if z is None else z,
            roofs=-math.inf if z is None else clear_altitude(briefing),
        )
    )
    if z is None or briefing.guaranteed_clearance > 0.0:
        return bounds
    hidden = camera_radius(briefing, z - FLOOR_MARGIN) - radius
    return bounds._replace(search_radius=bounds.search_radius + hidden)


def radius_at(briefing: UavBriefing, z: float) -> float:
    """Return the distance within which the UGV is visible from an altitude, see `visible_radius` [m]."""
    if briefing.camera is None:
        return briefing.visibility_radius
    return float(
        visible_radius(
            z,
            briefing.visibility_radius,
            math.tan(briefing.camera.half_angle),
            briefing.marker_height,
            briefing.max_building_height or 0.0,
            briefing.guaranteed_clearance,
        )
    )


def camera_radius(briefing: UavBriefing, z: float) -> float:
    """Return the distance within which the UGV is visible from an altitude if no building hides it [m]."""
    return radius_at(msgspec.structs.replace(briefing, max_building_height=None), z)


def clear_altitude(briefing: UavBriefing) -> float:
    """Return the altitude that clears every roof despite rounding [m]; minus infinity if there are no buildings."""
    limits, roofs = briefing.altitude, briefing.max_building_height
    return (
        -math.inf
        if limits is None or roofs is None
        else roofs + limits.vertical_clearance + FLOOR_MARGIN
    )


def least_altitude(briefing: UavBriefing) -> float:
    """Return the lowest altitude that clears every building [m]."""
    limits = briefing.altitude
    return -math.inf if limits is None else max(limits.min_altitude, clear_altitude(briefing))


@functools.lru_cache(maxsize=256)
def _levels(briefing: UavBriefing) -> tuple[SafetyBounds, ...]:
    limits = briefing.altitude
    if limits is None:
        return (bounds_at(briefing),)
    low, high = least_altitude(briefing), limits.max_altitude
    top = bounds_at(briefing, high)
    if low > high or not top.valid:
        # nothing is certified, but the filter still keeps the UAV above the buildings
        return (top._replace(floor=low if low <= high else -math.inf, valid=False),)
    if not bounds_at(briefing, low).valid:
        invalid, low = low, high
        while low - invalid > _PRECISION:
            middle = 0.5 * (low + invalid)
            if bounds_at(briefing, middle).valid:
                low = middle
            else:
                invalid = middle
    best = radius_at(briefing, high - FLOOR_MARGIN)
    full = next(  # above it, the radius grows no more
        (z for z in np.linspace(low, high, 200) if radius_at(briefing, z - FLOOR_MARGIN) >= best),
        high,
    )
    found: list[SafetyBounds] = []
    for z in dict.fromkeys(np.linspace(low, float(full), MOST_LEVELS).tolist()):
        bounds = bounds_at(briefing, z)
        if found and not bounds.handover_radius >= found[-1].handover_radius:  # smaller, or NaN
            # found in steps: a hand-over radius also holds for every larger visibility radius
            radius = found[-1].handover_radius
            bound = float(handover_bound(bounds, radius))
            bounds = bounds._replace(handover_radius=radius, handover_bound=bound, valid=True)
        found.append(bounds)
    return tuple(found)


def _first_part(briefing: UavBriefing) -> UavBriefing:
    """Return the briefing without its history, on which no bound depends."""
    return msgspec.structs.replace(briefing, past=())


def levels_of(briefing: UavBriefing) -> RecordArray:
    """Return the filter's bounds by increasing floor, as a table of `SafetyBounds`.

    One row if the UAV flies in the plane, or if no altitude can be certified; then it has the lowest altitude that
    clears every building as its floor. Shape (levels,).
    """
    return records(SafetyBounds, _levels(_first_part(briefing)))


def lowest_certified(briefing: UavBriefing) -> float | None:
    """Return the lowest altitude that can be certified [m]; None: no altitude can, or the UAV flies in the plane."""
    lowest = _levels(_first_part(briefing))[0]
    return lowest.floor if lowest.valid and math.isfinite(lowest.floor) else None


def bounds_of(briefing: UavBriefing) -> SafetyBounds:
    """Return the bounds of a UAV's safety filter at its initial altitude."""
    levels = _levels(_first_part(briefing))
    if briefing.altitude is None:
        return levels[0]
    below = [one for one in levels if one.floor <= briefing.altitude.initial_altitude]
    return below[-1] if below else levels[0]
