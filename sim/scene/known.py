"""The scene of a scenario that is known, and the radii that belong to it."""

import math

from bus.messages import Geometry
from sim.engine.briefing import limits
from sim.models.vehicles import stopping_distance
from sim.scenario.types import Scenario
from sim.scene.model import Scene, assembled


def raw_radius(scenario: Scenario, uav: str) -> float:
    """r_s of (18) [m] of one UAV and its UGV, whatever its sign."""
    bounds = {vehicle.name: vehicle for vehicle in scenario.vehicles}
    one = next(one for one in scenario.uav if one.name == uav)
    speed = one.max_speed + bounds[one.escorts].max_speed
    return scenario.visibility.radius - float(stopping_distance(speed, one.max_acceleration))


def inner_radius(scenario: Scenario, ugv: str) -> float | None:
    """r_s of (18) around a UGV [m], the smallest of its UAVs; None where it is no circle of its own."""
    radii = [raw_radius(scenario, uav.name) for uav in scenario.uav if uav.escorts == ugv]
    return min((r_s for r_s in radii if 0.0 < r_s < scenario.visibility.radius), default=None)


def geometry_of(scenario: Scenario) -> Geometry:
    """The part of a scenario that observers are told."""
    radius = raw_radius(scenario, scenario.uav[0].name)
    return Geometry(
        area=scenario.area,
        visibility_radius=scenario.visibility.radius,
        sensor_range=scenario.sensor.range,
        switching_radius=radius if math.isfinite(radius) else None,
        dt=scenario.dt,
        limits={vehicle.name: limits(vehicle) for vehicle in scenario.vehicles},
        uavs={uav.name: uav.escorts for uav in scenario.uav},
    )


def scene_of(scenario: Scenario) -> Scene:
    """The scene of a scenario that is known."""
    ugvs = sorted(ugv.name for ugv in scenario.ugv)
    return assembled(
        scenario.name,
        (scenario.area.width, scenario.area.height),
        {uav.name: uav.escorts for uav in scenario.uav},
        ugvs,
        goals={ugv.name: ugv.goals for ugv in scenario.ugv},
        radii=(scenario.visibility.radius, scenario.sensor.range),
        inner={ugv: inner_radius(scenario, ugv) for ugv in ugvs},
    )
