"""Briefing of each vehicle: its own row of the scenario, and only the bounds of the other vehicles."""

from collections.abc import Mapping
from typing import Any

from bus.messages.base import or_none
from bus.messages.buildings import Building
from bus.messages.ground import UavGround, UgvGround
from bus.messages.links import LinkKind
from bus.messages.scenario import Detector, Limits
from bus.messages.vehicle import Briefing, UavBriefing, UgvBriefing
from bus.registry import BODIES
from sim.channel.description import longest_delay
from sim.engine.run_keys import derive_key
from sim.models.camera import noise_at
from sim.models.randomness import BUILDING_FIELDS, PILOT, words_of
from sim.models.safety import SafetyBounds, safety_bounds
from sim.scenario.building_tables import max_building_height, run_buildings
from sim.scenario.clearance import clearance_fault, guaranteed_clearance
from sim.scenario.safety import safety_parameters
from sim.scenario.team import briefed_team, endurance_of, mates_of
from sim.scenario.types import Scenario, altitude_limits
from sim.scenario.vehicle_types import Uav, Ugv


def limits(vehicle: Uav | Ugv) -> Limits:
    """Return a vehicle's bounds in the form of a message."""
    return Limits(
        max_speed=or_none(vehicle.max_speed), max_acceleration=or_none(vehicle.max_acceleration)
    )


def detector_noise(scenario: Scenario, uav: Uav) -> float:
    """Return the standard deviation of a detection per axis, by which the UAV's estimator weighs it [m].

    With an altitude, the value for a UGV below the UAV at its initial altitude.
    """
    noise, limits = scenario.detections.noise, altitude_limits(scenario, uav)
    if limits is None:
        return noise
    reference = scenario.camera.reference_altitude
    return float(noise_at(noise, reference, 0.0, limits.initial_altitude))


def hiding_fault(scenario: Scenario, ugv: Ugv, driver: str | None = None) -> str:
    """Return why buildings may hide a UGV from certified UAVs; empty if they cannot.

    Arguments as in `clearance_fault`.
    """
    return clearance_fault(scenario, ugv, driver) if can_hide(scenario, ugv) else ""


def can_hide(scenario: Scenario, ugv: Ugv) -> bool:
    """Return whether any building is higher than a UGV's marker."""
    tallest = max_building_height(scenario)
    return tallest is not None and tallest > ugv.marker_height


def clearance_notice(scenario: Scenario, name: str, driver: str) -> str:
    """Return a warning if a new driver of a UGV ends the clearance that certificates assume; else empty."""
    ugv = next(one for one in scenario.ugv if one.name == name)
    assumed = guaranteed_clearance(scenario, ugv)
    if assumed <= guaranteed_clearance(scenario, ugv, driver):
        return ""
    return (
        f"{name}: the driver {driver} keeps no distance from buildings, but the UAV's certificates assume "
        f"{assumed:g} m: no tick counts as certified; see docs/explanation/guarantee.md"
    )


def ugv_carries(scenario: Scenario, ugv: Ugv) -> bool:
    """Return whether a UGV's commands carry backup trajectories, as with the driver `navigate`."""
    return scenario.has_ground and ugv.driver == "navigate"


def monitored_bounds(scenario: Scenario, uav: str) -> SafetyBounds:
    """Return the bounds with which the simulator checks a UAV's certificates."""
    vehicle = next(one for one in scenario.uav if one.name == uav)
    target = next(one for one in scenario.ugv if one.name == vehicle.escorts)
    return safety_bounds(
        safety_parameters(scenario, uav),
        visibility_radius=scenario.visibility.radius,
        v_a=vehicle.max_speed,
        u_a=vehicle.max_acceleration,
        v_g=target.max_speed,
        dt=scenario.dt,
    )


def all_buildings(scenario: Scenario, seed: int, secret: str = "") -> tuple[Building, ...]:
    """Return the buildings of a run."""
    key = words_of(derive_key(seed, BUILDING_FIELDS, 0, secret))
    return run_buildings(scenario, key)


def known_buildings(
    scenario: Scenario, vehicle: Uav | Ugv, seed: int, secret: str = ""
) -> tuple[Building, ...]:
    """Return the buildings on which a vehicle is briefed; empty if it has no map.

    A UAV is briefed on the buildings at given positions only. Those of a field stay clear of the UGVs' goals, so they
    would reveal something of the goals.
    """
    if not scenario.has_buildings or not scenario.buildings.known:
        return ()
    return scenario.building if isinstance(vehicle, Uav) else all_buildings(scenario, seed, secret)


def _common(scenario: Scenario, vehicle: Uav | Ugv, seed: int, secret: str) -> dict[str, Any]:
    """Return the fields of `VehicleBriefing`."""
    row = [one.name for one in scenario.vehicles].index(vehicle.name)
    return {
        "vehicle": vehicle.name,
        "dt": scenario.dt,
        "area": scenario.area,
        "limits": limits(vehicle),
        "key": derive_key(seed, PILOT, row, secret),
        "buildings": known_buildings(scenario, vehicle, seed, secret),
    }


def uav_briefing(
    scenario: Scenario,
    name: str,
    seed: int,
    secret: str = "",
    drivers: Mapping[str, str] | None = None,
) -> UavBriefing:
    """Return the briefing of a UAV; arguments and errors as in `briefing`.

    `drivers`: Drivers in control from the start, by UGV, instead of the scenario's; `EXTERNAL` for external actions.
    """
    uav = {one.name: one for one in scenario.uav}[name]
    escorted = {ugv.name: ugv for ugv in scenario.ugv}[uav.escorts]
    altitude = altitude_limits(scenario, uav)
    return UavBriefing(
        **_common(scenario, uav, seed, secret),
        has_robot=BODIES[uav.body].reported,
        target_limits=limits(escorted),
        visibility_radius=scenario.visibility.radius,
        sensor=scenario.sensor,
        desired_coverage=scenario.coverage.desired,
        covered=scenario.coverage.covered,
        law=scenario.law_of(uav),
        detector=Detector(
            noise=detector_noise(scenario, uav),
            truncation=or_none(scenario.detections.truncation),
            period=scenario.detection_period * scenario.dt,
        ),
        estimator=scenario.estimator,
        safety=safety_parameters(scenario, name),
        command_timeout=scenario.command_timeout,
        ground=UavGround(tile=scenario.ground.tile, map_update_rate=scenario.ground.map_update_rate)
        if scenario.has_ground
        else None,
        altitude=altitude,
        camera=None if altitude is None else scenario.camera,
        marker_height=escorted.marker_height,
        guaranteed_clearance=guaranteed_clearance(
            scenario, escorted, (drivers or {}).get(escorted.name)
        ),
        max_building_height=max_building_height(scenario),
        origin=scenario.origin,
        team=briefed_team(scenario, uav),
        endurance=endurance_of(uav),
        mates=mates_of(scenario, name),
    )


def ugv_briefing(scenario: Scenario, name: str, seed: int, secret: str = "") -> UgvBriefing:
    """Return the briefing of a UGV; arguments and errors as in `briefing`."""
    ugv = {one.name: one for one in scenario.ugv}[name]
    return UgvBriefing(
        **_common(scenario, ugv, seed, secret),
        driver=ugv.driver,
        kinematics=ugv.kinematics,
        track=ugv.track,
        max_curvature=ugv.max_curvature,
        goals=ugv.goals,
        goal_tolerance=ugv.goal_tolerance,
        script=ugv.script,
        command_timeout=scenario.command_timeout,
        ground=UgvGround(
            tile=scenario.ground.tile,
            sensing_range=scenario.ground.sensing_range,
            caution=ugv.caution,
            rough_speed_share=scenario.rough_share,
            delay=ugv_delay(scenario, name),
            building_clearance=ugv.building_clearance,
            tile_clearance=0.0 if scenario.buildings.known else ugv.building_clearance,
            only_buildings=scenario.only_known_buildings,
            executes_trajectories=ugv_carries(scenario, ugv),
        )
        if scenario.has_ground
        else None,
    )


def ugv_delay(scenario: Scenario, ugv: str) -> float:
    """Return the longest delay of a UGV's commands [s]."""
    return longest_delay(scenario.links.of(ugv, LinkKind.COMMANDS), scenario.links.traces)


def briefing(
    scenario: Scenario,
    name: str,
    seed: int,
    secret: str = "",
    drivers: Mapping[str, str] | None = None,
) -> Briefing:
    """Return the briefing of a vehicle in a run with this seed and secret; it contains neither.

    Args:
        scenario: Scenario of the run.
        name: The vehicle.
        seed, secret: Seed and secret of the run.
        drivers: As in `uav_briefing`.

    Raises:
        KeyError: If the scenario has no such vehicle.
    """
    if any(ugv.name == name for ugv in scenario.ugv):
        return ugv_briefing(scenario, name, seed, secret)
    return uav_briefing(scenario, name, seed, secret, drivers)
