"""Scene of a known scenario, and its radii."""

import math

from bus.messages.base import Vector
from bus.messages.buildings import Building
from bus.messages.telemetry import Geometry
from bus.registry import DRIVERS
from sim.engine.briefing import limits
from sim.models.kinematics import kinematics_of, largest_turn_rate
from sim.scenario.kinematics import steers
from sim.scenario.team import teams_of
from sim.scenario.types import Scenario, switching_radius
from sim.scenario.vehicle_types import Ugv
from sim.scenario.world_checks import escorts
from sim.scene.model import Scene, Space, assembled


def inner_radius(scenario: Scenario, ugv: str) -> float | None:
    """Return r_s of (18) around a UGV [m], the smallest of its UAVs; None if it is not within (0, r_v)."""
    radii = [
        switching_radius(scenario, uav, its) for _, uav, its in escorts(scenario) if its.name == ugv
    ]
    return min((r_s for r_s in radii if 0.0 < r_s < scenario.visibility.radius), default=None)


_GOALS = 100
"""Number of a UGV's goals sent to observers."""


def geometry_of(scenario: Scenario, buildings: tuple[Building, ...] = ()) -> Geometry:
    """Return the part of a scenario that is sent to observers.

    Args:
        scenario: Scenario of the run.
        buildings: All buildings of the run, given and random ones.
    """
    radii = (switching_radius(scenario, uav, ugv) for _, uav, ugv in escorts(scenario))
    radius = next(radii, math.inf)
    return Geometry(
        area=scenario.area,
        visibility_radius=scenario.visibility.radius,
        sensor_range=scenario.sensor.range,
        switching_radius=radius if math.isfinite(radius) else None,
        dt=scenario.dt,
        limits={vehicle.name: limits(vehicle) for vehicle in scenario.vehicles},
        max_turn_rates={
            ugv.name: largest_turn_rate(kinematics_of(ugv), ugv.max_speed)
            for ugv in scenario.ugv
            if steers(ugv)
        },
        uavs={uav.name: uav.escorts for uav in scenario.uav},
        goals={ugv.name: goals[:_GOALS] for ugv in scenario.ugv if (goals := _goals(ugv))},
        origin=scenario.origin,
        buildings=buildings,
        camera=scenario.camera if scenario.has_altitude else None,
        marker_heights=_markers(scenario),
        teams=teams_of(scenario),
        endurances={
            uav.name: uav.endurance
            for uav in scenario.uav
            if scenario.team is not None and uav.endurance is not None
        },
    )


def _goals(ugv: Ugv) -> tuple[Vector, ...]:
    """Return the goals of a UGV [m]; none if its driver does not use them."""
    driver = DRIVERS[ugv.driver]
    return ugv.goals if driver.wants == "goals" or not driver.module else ()


def _markers(scenario: Scenario) -> dict[str, float]:
    """Return the height of each UGV's marker [m]; empty if the UAVs fly in the plane."""
    if not scenario.has_altitude:
        return {}
    return {ugv.name: ugv.marker_height for ugv in scenario.ugv}


def scene_of(scenario: Scenario, buildings: tuple[Building, ...] = ()) -> Scene:
    """Return the scene of a scenario; `buildings`: all buildings of the run."""
    ugvs = sorted(ugv.name for ugv in scenario.ugv)
    return assembled(
        scenario.title or scenario.name,
        (scenario.area.width, scenario.area.height),
        {uav.name: uav.escorts for uav in scenario.uav},
        ugvs,
        steering={ugv.name for ugv in scenario.ugv if steers(ugv)},
        goals={ugv.name: _goals(ugv) for ugv in scenario.ugv},
        radii=(scenario.visibility.radius, scenario.sensor.range),
        inner={ugv: inner_radius(scenario, ugv) for ugv in ugvs},
        space=Space(
            buildings=buildings,
            camera=scenario.camera if scenario.has_altitude else None,
            markers=_markers(scenario),
        ),
        teams=teams_of(scenario),
    )
