"""Checks of altitudes, cameras and buildings, one function each."""

import math
from collections.abc import Iterator

import numpy as np

from bus.messages.buildings import MOST_BUILDINGS, AltitudeLimits
from bus.numbers import at_least, below, exact
from bus.registry import ALTITUDE_LAWS, CAUTIONS
from sim.input.faults import Fault, unknown_name
from sim.models.buildings import tables_of
from sim.models.hazards import BLOCK, hazard_at
from sim.scenario.building_tables import highest_building, most_buildings
from sim.scenario.clearance import clearance_fault, enlargement, least_distance
from sim.scenario.polygon_checks import first_contact, polygon_faults
from sim.scenario.stops import all_stops
from sim.scenario.types import Scenario, altitude_limits
from sim.scenario.vehicle_types import Ugv
from sim.scenario.world_checks import Check, escorts

_VERTICAL = (
    "min_altitude",
    "max_altitude",
    "max_climb_rate",
    "max_vertical_acceleration",
    "vertical_clearance",
)
_ROUNDING = 1e-12
MOST_CORNERS = 10_000
"""Maximum number of corners of all given buildings, which bounds the size of a briefing."""


def altitudes_are_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check that vertical bounds belong to an initial altitude, which is between the lowest and the highest one."""
    yield from unknown_name("altitude.law", scenario.altitude.law, ALTITUDE_LAWS)
    for k, uav in enumerate(scenario.uav):
        limits = altitude_limits(scenario, uav)
        if limits is None:
            for name in _VERTICAL:
                value = getattr(uav, name)
                if value is not None:
                    wrong = "no effect without an initial altitude"
                    yield Fault(f"uav.{k}.{name}", value, wrong, f"also uav.{k}.initial_altitude")
        elif limits.min_altitude > limits.max_altitude:
            allowed = f"up to uav.{k}.max_altitude = {exact(limits.max_altitude)} m"
            yield Fault(
                f"uav.{k}.min_altitude", limits.min_altitude, "above the highest altitude", allowed
            )
        elif not limits.min_altitude <= limits.initial_altitude <= limits.max_altitude:
            yield Fault(
                f"uav.{k}.initial_altitude",
                limits.initial_altitude,
                "out of bounds",
                f"{exact(limits.min_altitude)} to {exact(limits.max_altitude)} m",
            )


def _flown(scenario: Scenario) -> Iterator[tuple[str, Ugv, AltitudeLimits]]:
    """Yield the path, the UGV and the vertical bounds of each UAV that has an altitude."""
    for path, uav, ugv in escorts(scenario):
        limits = altitude_limits(scenario, uav)
        if limits is not None:
            yield path, ugv, limits


def cameras_see(scenario: Scenario) -> Iterator[Fault]:
    r"""Check that each camera sees a cell or more at the height of the marker: $(z - h_m) \tan\theta$."""
    slope, cell = math.tan(scenario.camera.half_angle), scenario.area.cell
    numbers = {ugv.name: k for k, ugv in enumerate(scenario.ugv)}
    for path, ugv, limits in _flown(scenario):
        if ugv.marker_height >= limits.max_altitude:
            yield Fault(
                f"ugv.{numbers[ugv.name]}.marker_height",
                ugv.marker_height,
                f"not below any altitude of its UAV, {path}.max_altitude = {exact(limits.max_altitude)} m",
                f"less than {path}.min_altitude = {exact(limits.min_altitude)} m",
            )
        for field in ("initial_altitude", "min_altitude"):
            altitude: float = getattr(limits, field)
            seen = (altitude - ugv.marker_height) * slope
            if seen < cell:
                wrong = f"the marker at {exact(ugv.marker_height)} m is not below it"
                if seen > 0.0:
                    wrong = f"the camera sees {below(seen, cell, 3)} m there, less than a cell ({exact(cell)} m)"
                least = ugv.marker_height + cell / slope
                yield Fault(f"{path}.{field}", altitude, wrong, f"above {at_least(least, 4)} m")


def uavs_have_an_altitude(scenario: Scenario) -> Iterator[Fault]:
    """Check that every UAV has an altitude if there are buildings."""
    for k, uav in enumerate(scenario.uav):
        if scenario.has_buildings and uav.initial_altitude is None:
            wrong = "missing: a UAV in the plane cannot fly among buildings"
            yield Fault(f"uav.{k}.initial_altitude", None, wrong, "a number in m")


def building_fields_are_possible(scenario: Scenario) -> Iterator[Fault]:
    """Check sides, heights and streets of the fields, and the number of buildings."""
    count, least = float(len(scenario.building)), least_distance(scenario)
    for k, field in enumerate(scenario.building_field):
        path = f"building_field.{k}"
        for name in ("block", "height"):
            smallest, largest = getattr(field, name)
            if smallest > largest:
                value = [smallest, largest]
                yield Fault(f"{path}.{name}", value, "out of order", "[smallest, largest] in m")
        if field.street < 2.0 * least * (1.0 - _ROUNDING):
            wrong = "too narrow: its tiles between two buildings may all be closed"
            needed = "2 building_clearance + 3 ground.tile"
            if enlargement(scenario) > 0.0:
                needed = "2 building_clearance + 6 ground.tile, as the buildings are unknown"
            allowed = f"{at_least(2.0 * least)} m or more: {needed}"
            yield Fault(f"{path}.street", field.street, wrong, allowed)
        most = most_buildings(scenario, field)
        count += most
        if most == 0.0:
            side = min(scenario.area.width, scenario.area.height)
            allowed = f"sides that fit with two streets into {exact(side)} m"
            yield Fault(f"{path}.block", list(field.block), "none fit into the area", allowed)
        elif count > MOST_BUILDINGS:
            wrong = f"makes up to {count:,.0f} buildings in total"
            allowed = f"larger ones, or wider streets: {MOST_BUILDINGS:,} buildings at most"
            yield Fault(f"{path}.block", list(field.block), wrong, allowed)


def buildings_have_a_shape(scenario: Scenario) -> Iterator[Fault]:
    """Check that footprints are simple polygons inside Q, with few enough corners in total."""
    width, height, corners = scenario.area.width, scenario.area.height, 0
    for k, building in enumerate(scenario.building):
        path = f"building.{k}.polygon"
        corners += len(building.polygon)
        if corners > MOST_CORNERS:
            wrong = f"makes {corners:,} corners in total"
            yield Fault(path, building.polygon, wrong, f"up to {MOST_CORNERS:,} in total")
        yield from polygon_faults(path, building.polygon)
        low, high = building.bounds
        if not (low[0] >= 0.0 and low[1] >= 0.0 and high[0] <= width and high[1] <= height):
            allowed = f"[0, {exact(width)}] x [0, {exact(height)}] m"
            yield Fault(path, building.polygon, "outside Q", allowed)


def buildings_are_apart(scenario: Scenario) -> Iterator[Fault]:
    """Check that no two footprints overlap or touch."""
    contact = first_contact([np.array(building.corners) for building in scenario.building])
    if contact is not None:
        one, other = contact
        wrong = f"overlaps or touches building.{one}"
        allowed = "footprints more than a millimetre apart"
        yield Fault(f"building.{other}.polygon", scenario.building[other].polygon, wrong, allowed)


def buildings_leave_stops_free(scenario: Scenario) -> Iterator[Fault]:
    """Check that no building covers a start or a goal of a UGV, or the start of a UAV that is too low over it."""
    if not scenario.building:
        return
    rows, corners = tables_of(scenario.building)
    for path, (x, y) in all_stops(scenario):
        k = hazard_at(rows, corners, BLOCK, x, y)
        if k >= 0:
            polygon = scenario.building[k].polygon
            wrong = f"covers {path} = [{exact(x)}, {exact(y)}]"
            allowed = "a footprint away from all starts and goals"
            yield Fault(f"building.{k}.polygon", polygon, wrong, allowed)
    for n, uav in enumerate(scenario.uav):
        k, limits = hazard_at(rows, corners, BLOCK, *uav.position), altitude_limits(scenario, uav)
        if k >= 0 and limits is not None:
            least = scenario.building[k].height + limits.vertical_clearance
            if limits.initial_altitude < least:
                wrong = f"too low over building.{k}, {exact(scenario.building[k].height)} m high"
                allowed = f"{at_least(least)} m or more there, or another position"
                yield Fault(f"uav.{n}.initial_altitude", limits.initial_altitude, wrong, allowed)


def building_bounds_agree(scenario: Scenario) -> Iterator[Fault]:
    """Check that the declared height of the highest building is not below a building."""
    declared, highest = scenario.certificate.max_building_height, highest_building(scenario)
    if declared is not None and declared < highest:
        wrong = f"below the highest possible building, {exact(highest)} m"
        yield Fault(
            "certificate.max_building_height", declared, wrong, f"{exact(highest)} m or more"
        )


def building_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of a clearance that a UGV does not keep by itself, or that may keep it from its goals."""
    if not scenario.has_buildings:
        return
    tile, sensing = scenario.ground.tile, scenario.ground.sensing_range
    waiting = [
        ugv for ugv in scenario.ugv if ugv.driver == "navigate" and ugv.caution == CAUTIONS[0]
    ]
    needed = max((ugv.building_clearance for ugv in waiting), default=0.0) + 2.0 * tile
    if enlargement(scenario) > 0.0 and waiting and sensing < needed:
        yield (
            f"ground.sensing_range = {exact(sensing)} m: a UGV may wait forever beside an unknown building, as no UAV "
            f"sees the ground under it; {at_least(needed)} m (building_clearance + 2 ground.tile) lets it sense the "
            "building itself"
        )
    for k, ugv in enumerate(scenario.ugv):
        fault = clearance_fault(scenario, ugv)
        if ugv.building_clearance > 0.0 and fault:
            yield (
                f"ugv.{k}.building_clearance = {exact(ugv.building_clearance)}: not ensured (A9): {fault}"
            )


BUILDING_CHECKS: tuple[Check, ...] = (
    altitudes_are_possible,
    cameras_see,
    uavs_have_an_altitude,
    building_fields_are_possible,
    buildings_have_a_shape,
    buildings_are_apart,
    buildings_leave_stops_free,
    building_bounds_agree,
)
"""Checks in order, after those of numbers and names."""
