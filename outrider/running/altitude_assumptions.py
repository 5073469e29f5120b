"""From which altitude the sight of a scenario can be certified, and what prevents it below."""

import math

from agents.safety.levels import bounds_at, least_altitude, lowest_certified, radius_at
from bus.messages.vehicle import UavBriefing
from bus.numbers import above, exact
from sim.engine.briefing import hiding_fault
from sim.scenario.types import Scenario, Uav


def certified_from(briefing: UavBriefing) -> str:
    """Return the lowest certified altitude and its cause in one clause; empty in the plane, or if there is none."""
    lowest = lowest_certified(briefing)
    if lowest is None:
        return ""
    return f"sight can be certified at {_up(lowest)} m or higher{_cause(briefing, lowest)}"


def _up(altitude: float) -> str:
    """Return an altitude, rounded up to a centimetre, as text."""
    return f"{math.ceil(100.0 * altitude) / 100.0:.2f}"


def _cause(briefing: UavBriefing, lowest: float) -> str:
    """Return why sight can be certified from an altitude [m] on, as the end of a sentence."""
    own, camera = briefing.altitude, briefing.camera
    if own is None or camera is None:
        return ""
    if lowest <= own.min_altitude:
        return ", from the lowest altitude of the UAV on"
    if lowest <= least_altitude(briefing):
        return (
            f", that is {exact(own.vertical_clearance)} m above the highest building "
            f"({exact(briefing.max_building_height or 0.0)} m)"
        )
    above = lowest - briefing.marker_height
    seen = above * math.tan(camera.half_angle)
    if radius_at(briefing, lowest) >= seen - 1e-6:
        return f"; there, the camera sees a UGV within {seen:.2f} m"
    return (
        f"; there, buildings up to {exact(briefing.max_building_height or 0.0)} m high cannot hide a UGV that is "
        f"within {radius_at(briefing, lowest):.2f} m and at least {exact(briefing.building_clearance)} m from them"
    )


def altitude_fault(scenario: Scenario, uav: Uav, briefing: UavBriefing) -> str:
    """Return why the altitudes or buildings of a scenario prevent certificates; empty if they do not.

    Args:
        scenario: The scenario.
        uav: The UAV.
        briefing: Its briefing.
    """
    if briefing.altitude is None:
        return ""
    (escorted,) = (ugv for ugv in scenario.ugv if ugv.name == uav.escorts)
    fault = hiding_fault(scenario, escorted)
    if fault:
        return f"{uav.escorts} guarantees no distance from buildings, which may hide it: {fault}"
    lowest = lowest_certified(briefing)
    if lowest is None:
        highest = briefing.altitude.max_altitude
        floor = least_altitude(briefing)
        if floor > highest:
            needed = f"the {above(floor, highest)} m that clear the highest building"
            return f"max_altitude = {exact(highest)} m: lower than {needed}"
        if bounds_at(briefing).valid:
            return (
                f"even at max_altitude = {exact(highest)} m the UGV is visible within "
                f"{radius_at(briefing, highest):.2f} m only; raise max_altitude, camera.half_angle or "
                "ugv.building_clearance"
            )
    return ""


def low_start(scenario: Scenario, uav: Uav, briefing: UavBriefing) -> str:
    """Return why sight is not certified before the safety filter has climbed; empty if it need not climb.

    Arguments as in `altitude_fault`.
    """
    if briefing.altitude is None or scenario.altitude.law != "fixed":
        return ""
    lowest, start = lowest_certified(briefing), briefing.altitude.initial_altitude
    if lowest is None or start >= lowest:
        return ""
    return f"initial_altitude = {exact(start)} m: too low, so the safety filter climbs; {certified_from(briefing)}"
