"""Inputs of every law: the constants of one UAV, and the estimate of the UGV."""

import math
from typing import NamedTuple

from agents.safety.levels import bounds_of
from bus.errors import ScenarioError
from bus.messages.vehicle import UavBriefing
from bus.registry import SENSORS
from sim.models.sensor import SensorParameters, sensor_parameters
from sim.models.vehicles import raw_switching_radius


class UavParameters(NamedTuple):
    """Constants of one UAV that any law may need; a missing bound is infinite."""

    dt: float
    """[s]"""
    width: float
    height: float
    """Q [m]."""
    cell: float
    """Width of a cell of the coverage grid [m]."""
    max_speed: float
    """v_a [m/s]."""
    max_acceleration: float
    """u_a [m/s²]."""
    target_max_speed: float
    """v_g [m/s]."""
    switching_radius: float
    """r_s of (18) [m]; not positive if the UAV is too weak."""
    density_radius: float
    """r_o of (9) [m]."""
    sensor: SensorParameters
    """S_a of (2)."""
    desired_coverage: float
    """C* of (4)."""
    max_distance: float
    """Largest distance to the UGV that keeps it visible despite the largest measurement error [m]."""


class Target(NamedTuple):
    """Estimate of the UGV's state."""

    known: bool
    """False before the first detection; the other fields are meaningless then."""
    p_x: float
    p_y: float
    """[m]"""
    v_x: float
    v_y: float
    """[m/s]"""
    p_variance: float
    """Per axis [m²]."""
    v_variance: float
    """Per axis [m²/s²]."""


def _max_distance(briefing: UavBriefing) -> float:
    """Return r_v of the safety filter minus the largest measurement error [m]."""
    bounds = bounds_of(briefing)
    distance = bounds.radius - bounds.placed_error
    return float(distance if math.isfinite(distance) else briefing.visibility_radius)


def uav_parameters(briefing: UavBriefing) -> UavParameters:
    """Return the constants of a UAV from its briefing.

    Raises:
        ScenarioError: If the sensor model is unknown.
    """
    if briefing.sensor.model not in SENSORS:
        raise ScenarioError(
            f"sensor.model = {briefing.sensor.model!r}: unknown; allowed: {', '.join(SENSORS)}"
        )
    (v_a, u_a), (v_g, _) = briefing.limits.numbers, briefing.target_limits.numbers
    return UavParameters(
        dt=float(briefing.dt),
        width=float(briefing.area.width),
        height=float(briefing.area.height),
        cell=float(briefing.area.cell),
        max_speed=v_a,
        max_acceleration=u_a,
        target_max_speed=v_g,
        switching_radius=float(raw_switching_radius(briefing.visibility_radius, v_a, v_g, u_a)),
        density_radius=float(briefing.visibility_radius + briefing.sensor.range),
        sensor=sensor_parameters(briefing.sensor),
        desired_coverage=float(briefing.desired_coverage),
        max_distance=_max_distance(briefing),
    )
