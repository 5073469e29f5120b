"""A UGV's tour through a town, and a UAV that can certify its sight."""

import itertools
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_erosion, label

from bus.errors import ScenarioError
from bus.messages.base import Vector
from bus.numbers import exact
from outrider_geo.town import Town, highest_building
from sim.models.hazards import BLOCK
from sim.models.safety import visible_radius
from sim.scenario.ground_tables import ground_tables
from sim.scenario.ground_types import Ground
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Ugv

BoolArray = npt.NDArray[np.bool_]

HALF_ANGLE = 0.785
"""Half of the camera's opening angle [rad]."""
MARKER = 0.3
"""Height of the UGV's marker [m]."""
UGV_ACCELERATION, UAV_ACCELERATION = 0.5, 3.0
_FASTEST = 4.0
"""Largest speed of the UAV [m/s]."""
_SLOWER = 4.0
"""Ratio of the UAV's speed to the UGV's."""
_AGILITY = 0.8
"""Speed of the UAV that leaves the safety filter room: this factor times the root of acceleration and radius."""
_ROOFS = 4.0
"""Lowest altitude, in heights of the highest building: the UGV is visible within about this many clearances."""
_LOWEST, _HIGHEST = 30.0, 120.0
"""Bounds of the lowest altitude [m]."""
BAND = 10.0
"""Height of the altitude band [m]."""
_PACE = 0.8
"""Share of its largest speed at which a cautious UGV is expected to travel."""
_MARGIN = 2
"""Tiles between stops and the ground that is too near to a building, where there is room for them."""


class Vehicles(NamedTuple):
    """Starts, goals and parameters of the vehicles."""

    stops: tuple[Vector, ...]
    """Start of the UGV and its goals [m]."""
    altitude: float
    """Lowest altitude of the UAV [m]."""
    visibility: float
    """Visibility radius [m]."""
    uav_speed: float
    ugv_speed: float
    """Largest speeds [m/s]."""
    duration: float
    """Duration of the tour [s]."""


def plan_vehicles(town: Town, clearance: float, file: str) -> Vehicles:
    """Return a tour through the largest connected free ground, from its south-west by the middle to its north-east.

    The UAV flies so high that the roofs hide the UGV only far away, and only as fast as its safety filter can brake.

    Args:
        town: The town.
        clearance: Distance that the UGV keeps from buildings [m].
        file: Name of the file, for error messages.

    Raises:
        ScenarioError: If there is no free ground.
    """
    stops = _tour(town, clearance, file)
    length = sum(abs(b[0] - a[0]) + abs(b[1] - a[1]) for a, b in itertools.pairwise(stops))
    highest = highest_building(town)
    altitude = min(max(_LOWEST, _rounded_up(_ROOFS * highest)), _HIGHEST)
    altitude = max(altitude, _rounded_up(highest + BAND))
    radius = visible_radius(altitude, math.inf, math.tan(HALF_ANGLE), MARKER, highest, clearance)
    radius = max(0.1, math.floor(10.0 * radius) / 10.0)
    speed = min(_FASTEST, math.floor(10.0 * _AGILITY * math.sqrt(UAV_ACCELERATION * radius)) / 10.0)
    seconds = length * _SLOWER / (_PACE * speed)
    return Vehicles(
        stops,
        altitude,
        visibility=radius,
        uav_speed=speed,
        ugv_speed=speed / _SLOWER,
        duration=max(60.0, 20.0 * math.ceil(seconds / 20.0)),
    )


def _rounded_up(altitude: float) -> float:
    return 5.0 * math.ceil(altitude / 5.0)


def _tour(town: Town, clearance: float, file: str) -> tuple[Vector, ...]:
    """Return the start of the UGV and its goals [m]."""
    free = _largest_region(_open_tiles(town, clearance))
    rows, columns = np.nonzero(free)
    points = (np.column_stack([columns, rows]) + 0.5) * town.area.cell
    size = np.array([town.area.width, town.area.height])
    stops: list[Vector] = []
    for share in (0.0, 0.5, 1.0) if len(points) else ():
        x, y = points[np.argmin(np.hypot(*(points - share * size).T))].tolist()
        if (x, y) not in stops:
            stops.append((x, y))
    if len(stops) < 2:
        raise ScenarioError(
            f"{file}: no free ground for a UGV that keeps {exact(clearance)} m from buildings; allowed: a smaller "
            "--clearance, or another --origin and --size"
        )
    return tuple(stops)


def _open_tiles(town: Town, clearance: float) -> BoolArray:
    """Return the tiles that a UGV may enter. Shape (rows, columns)."""
    alone = Scenario(
        area=town.area,
        ground=Ground(tile=town.area.cell),
        building=town.buildings,
        ugv=(Ugv(position=(0.0, 0.0), building_clearance=clearance),),
    )
    tiles: BoolArray = ground_tables(alone).closed != BLOCK
    return tiles


def _largest_region(tiles: BoolArray) -> BoolArray:
    """Return the tiles of the largest connected region, away from its edge. Shape (rows, columns)."""
    regions, _ = label(tiles)
    sizes = np.bincount(regions.ravel())
    sizes[0] = 0
    inner: BoolArray = (regions == int(sizes.argmax())) & tiles
    for _ in range(_MARGIN):
        smaller: BoolArray = binary_erosion(inner, np.ones((3, 3)))
        if not smaller.any():
            break
        inner = smaller
    return inner
