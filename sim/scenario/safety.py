"""Bounds that a scenario declares to the UAVs' safety filters, or that follow from its noise, wind and links."""

import math

from bus.messages.base import or_none
from bus.messages.links import LinkKind
from bus.messages.scenario import SafetyParameters
from bus.registry import BODIES
from sim.channel.description import longest_delay
from sim.models.camera import noise_at
from sim.models.inner_loop import tracking_error
from sim.scenario.types import DEFAULT_AGE, Scenario, altitude_limits
from sim.scenario.vehicle_types import Uav


def noise_range(scenario: Scenario, uav: Uav) -> tuple[float, float]:
    """Return the smallest and the largest standard deviation of a UAV's detections per axis [m].

    With an altitude, noise grows with the slant range: it is smallest at the lowest altitude directly above the UGV,
    and largest at the highest altitude and the farthest detection.
    """
    noise, limits = scenario.detections.noise, altitude_limits(scenario, uav)
    if limits is None:
        return noise, noise
    reference, sensing_range = scenario.camera.reference_altitude, scenario.sensor.range
    return (
        float(noise_at(noise, reference, 0.0, limits.min_altitude)),
        float(noise_at(noise, reference, sensing_range, limits.max_altitude)),
    )


def largest_noise(scenario: Scenario, uav: Uav) -> float:
    """Return the largest standard deviation of a UAV's detections per axis, at any altitude and distance [m]."""
    return noise_range(scenario, uav)[1]


def largest_error(scenario: Scenario, uav: Uav) -> float:
    """Return the largest error of a UAV's detections, as a vector norm [m]; infinite: unbounded."""
    noise = largest_noise(scenario, uav)
    return noise * scenario.detections.truncation if noise > 0.0 else 0.0


def largest_tracking_error(scenario: Scenario, uav: Uav) -> float:
    """Return the largest distance of a UAV from its reference position, w [m]; infinite if unbounded or unknown."""
    if BODIES[uav.body].make:
        return math.inf  # only a measurement tells
    return tracking_error(uav.tracking, scenario.wind.largest, uav.position_error, scenario.dt)


def command_delay(scenario: Scenario, uav: str) -> float:
    """Return the longest delay of a UAV's commands [s]: the declared one, or the longest of its link."""
    if scenario.certificate.max_command_delay is not None:
        return scenario.certificate.max_command_delay
    return longest_delay(scenario.links.of(uav, LinkKind.COMMANDS), scenario.links.traces)


def safety_parameters(scenario: Scenario, uav: str) -> SafetyParameters:
    """Return the parameters of a UAV's safety filter."""
    given = scenario.certificate
    tracking = given.max_tracking_error
    (vehicle,) = (one for one in scenario.uav if one.name == uav)
    if tracking is None:
        tracking = or_none(largest_tracking_error(scenario, vehicle))
    return SafetyParameters(
        max_measurement_error=given.max_measurement_error
        if given.max_measurement_error is not None
        else or_none(largest_error(scenario, vehicle)),
        max_measurement_age=given.max_measurement_age or DEFAULT_AGE,
        max_command_delay=command_delay(scenario, uav),
        max_command_interval=scenario.dt
        if given.max_command_interval is None
        else given.max_command_interval,
        max_tracking_error=tracking,
        margin=given.margin,
        search=vehicle.search,
    )
