"""Text of an imported town's scenario."""

import math
from collections.abc import Sequence

from bus.numbers import exact
from outrider_geo.town import Town
from outrider_geo.vehicles import (
    BAND,
    HALF_ANGLE,
    MARKER,
    UAV_ACCELERATION,
    UGV_ACCELERATION,
    Vehicles,
)
from sim.input.faults import toml_value


def scenario_text(
    town: Town, vehicles: Vehicles, clearance: float, title: str, comments: Sequence[str]
) -> str:
    """Return the TOML text of a scenario.

    Args:
        town: Its buildings.
        vehicles: Its vehicles.
        clearance: Distance that the UGV keeps from buildings [m].
        title: Title in one line.
        comments: Lines at the head: the source, its date, its licence.
    """
    middle = vehicles.altitude + 0.5 * BAND
    area, origin = town.area, town.origin
    lines = [
        *(f"# {line}" for line in comments),
        f"title = {toml_value(title)}",
        "seed = 1",
        f"duration = {vehicles.duration!r}",
        "",
        "[area]",
        f"width = {area.width!r}",
        f"height = {area.height!r}",
        f"cell = {area.cell!r}",
        "",
        "[origin]  # lower left corner; x points east, y north",
        f"latitude = {origin.latitude!r}",
        f"longitude = {origin.longitude!r}",
        f"altitude = {origin.altitude!r}",
        "",
        "[law]",
        'name = "certified"',
        "",
        "[visibility]",
        f"radius = {vehicles.visibility!r}",
        "",
        "[sensor]",
        f"range = {_range(vehicles)!r}",
        "",
        "[camera]",
        f"half_angle = {HALF_ANGLE!r}",
        f"reference_altitude = {middle!r}",
        "",
        "[detections]",
        "noise = 0.1",
        "dropout = 0.1",
        "",
        "[ground]",
        f"tile = {area.cell!r}",
        f"sensing_range = {1.5 * area.cell!r}",
        *_vehicle_lines(vehicles, clearance),
    ]
    for one in town.buildings:
        polygon = ", ".join(map(_point, one.polygon))
        lines += ["", "[[building]]", f"polygon = [{polygon}]", f"height = {one.height!r}"]
    return "\n".join(lines) + "\n"


def _vehicle_lines(vehicles: Vehicles, clearance: float) -> list[str]:
    start, *goals = vehicles.stops
    return [
        "",
        "[[uav]]",
        f"position = {_point(start)}",
        f"max_speed = {vehicles.uav_speed!r}",
        f"max_acceleration = {UAV_ACCELERATION!r}",
        f"initial_altitude = {vehicles.altitude + 0.5 * BAND!r}",
        f"min_altitude = {vehicles.altitude!r}",
        f"max_altitude = {vehicles.altitude + BAND!r}",
        "",
        "[[ugv]]",
        'driver = "navigate"',
        f"position = {_point(start)}",
        f"goals = [{', '.join(map(_point, goals))}]",
        f"max_speed = {vehicles.ugv_speed!r}",
        f"max_acceleration = {UGV_ACCELERATION!r}",
        "goal_tolerance = 0.5",
        f"marker_height = {MARKER!r}",
        f"building_clearance = {clearance!r}",
    ]


def _point(point: Sequence[float]) -> str:
    x, y = point
    return f"[{exact(x)}, {exact(y)}]"


def _range(vehicles: Vehicles) -> float:
    """Return the range of the UAV's sensor [m]: a little more than the visibility radius."""
    return float(math.ceil(1.25 * vehicles.visibility))
