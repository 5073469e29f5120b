"""Parts of a scene that depend on the UAVs' altitudes: radii, hidden ground, and the line of sight."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.messages.telemetry import EscortTruth, VehicleTruth
from sim.models.buildings import tables_of
from sim.models.camera import range_at, visibility_radius_at
from sim.models.shadows import all_known, hidden_cells
from sim.models.sight import is_lost, sight_margin
from sim.scene.model import Point, Ring, Scene, Space

HIDDEN = "hidden or too low"
"""Short reason for a UGV that is not visible at any distance: behind a building, or below a UAV that is too low."""


class Sight(NamedTuple):
    """Pair of a UAV and its UGV that is closest to losing sight, or has lost it."""

    distance: float
    """Distance of the two [m]."""
    radius: float
    """Distance within which the UGV is visible [m]; 0: it is not visible at any."""

    @property
    def lost(self) -> bool:
        """True if the UGV is out of sight, (5)."""
        return bool(is_lost(self.distance, self.radius))

    @property
    def margin(self) -> float:
        """Distance by which the UGV may still recede [m]; 0 while it is not visible at any distance."""
        return float(sight_margin(self.distance, self.radius))

    @property
    def hidden(self) -> bool:
        """True if the UGV is not visible at any distance: a building hides it, or the UAV is too low."""
        return self.radius == 0.0


def worst_sight(pairs: Iterable[tuple[float, float]]) -> Sight | None:
    """Return the pair with the smallest margin; None without pairs.

    Args:
        pairs: Distance of each UAV from its UGV, and the distance within which it sees the UGV [m].
    """
    return min((Sight(*pair) for pair in pairs), key=lambda one: one.margin, default=None)


def sight_of(escort: EscortTruth, r_v: float) -> Sight:
    """Return distance and radius of sight of a pair; `r_v`: the radius in the plane [m], infinite if unknown."""
    return Sight(escort.distance, r_v if escort.sight_radius is None else escort.sight_radius)


def decisive(escorts: Sequence[EscortTruth]) -> tuple[EscortTruth, ...]:
    """Return the pairs on which sight depends: of each team its nearest UAV, and every UAV without a team."""
    nearest: dict[str, EscortTruth] = {}
    for escort in escorts:
        key = escort.ugv if escort.teamed else f"{escort.ugv}/{escort.uav}"
        if key not in nearest or escort.distance < nearest[key].distance:
            nearest[key] = escort
    return tuple(nearest.values())


def altitudes_of(vehicles: Mapping[str, VehicleTruth]) -> dict[str, float]:
    """Return the altitude of each UAV that has one [m]."""
    return {name: one.altitude for name, one in vehicles.items() if one.altitude is not None}


def sight_at(space: Space, ugv: str, r_v: float, altitude: float) -> float:
    """Return the visibility radius at an altitude [m], where no building hides the UGV.

    Args:
        space: Camera and markers.
        ugv: Name of the UGV.
        r_v: Visibility radius at a great altitude [m].
        altitude: Altitude of the UAV [m].
    """
    if space.camera is None:
        return r_v
    tangent = math.tan(space.camera.half_angle)
    return float(visibility_radius_at(r_v, tangent, space.markers.get(ugv, 0.0), altitude))


def range_of(space: Space, sensing_range: float, altitude: float) -> float:
    """Return the range of the sensor on the ground at an altitude [m]; `sensing_range`: at a great altitude [m]."""
    if space.camera is None:
        return sensing_range
    return float(range_at(sensing_range, math.tan(space.camera.half_angle), altitude))


def ring_radius(scene: Scene, ring: Ring, altitudes: Mapping[str, float]) -> float:
    """Return the radius of a circle with the UAVs at these altitudes [m]; of a UGV's UAVs, the lowest counts."""
    if ring.symbol == "r" and ring.around in altitudes:
        return range_of(scene.space, ring.radius, altitudes[ring.around])
    if ring.symbol != "r_v":
        return ring.radius
    uavs = (uav for uav, ugv in scene.escorts if ugv == ring.around and uav in altitudes)
    radii = (sight_at(scene.space, ring.around, ring.radius, altitudes[uav]) for uav in uavs)
    return min(radii, default=ring.radius)


class HiddenGround:
    """Ground in the range of the UAVs' sensors that buildings hide from their cameras.

    Args:
        scene: Scene with buildings.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._tables = tables_of(scene.space.buildings)
        self._ranges = {ring.around: ring.radius for ring in scene.rings if ring.symbol == "r"}

    def cells(
        self, positions: Mapping[str, Point], altitudes: Mapping[str, float], shape: tuple[int, int]
    ) -> npt.NDArray[np.bool_]:
        """Return the cells that are in the range of a UAV and hidden from every UAV that is in range of them.

        Args:
            positions: Position of each vehicle [m].
            altitudes: Altitude of each UAV [m].
            shape: Rows and columns of the grid over the scene's area.
        """
        cell = self._scene.width / shape[1]
        hidden, seen = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
        y, x = np.ogrid[: shape[0], : shape[1]]
        for uav, z in altitudes.items():
            (p_x, p_y), sensing_range = positions[uav], self._ranges.get(uav, 0.0)
            radius = range_of(self._scene.space, sensing_range, z)
            shadow = hidden_cells(all_known(*self._tables, z), p_x, p_y, radius, cell, shape)
            disc = np.hypot((x + 0.5) * cell - p_x, (y + 0.5) * cell - p_y) <= radius
            hidden |= shadow
            seen |= disc & ~shadow
        return hidden & ~seen
