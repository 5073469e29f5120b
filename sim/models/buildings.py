"""Buildings: prisms over polygons, which hide what is behind them and stop a UAV that flies lower than they are high.

A building is the set of the points above its footprint, a simple polygon, from the ground up to its height. For contact
it is closed: a path that touches a wall has met it. For sight it is open: a wall hides what is behind it, but neither
itself nor what leans on it from outside. A sight line needs a gap, though: one that touches buildings on both of its
sides, as between two that share a wall, is blocked. No camera is inside a building.

A building is a row of a table of hazards, a polygon with a height; its corners are in counterclockwise order. Rows of
height 0 are empty.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.messages.buildings import Building
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray, records
from sim.models.grid import chord
from sim.models.hazards import BLOCK, HazardRow
from sim.models.polygons import (
    ON_EDGE,
    distance_to_polygon,
    lies_inside,
    passes_inside,
    segment_distance2,
    share_to_polygon,
)
from sim.models.vehicles import norm


class CameraPosition(NamedTuple):
    """Position of a camera."""

    x: float
    y: float
    z: float
    """Height above the ground [m]."""


_MARGIN = 1e-9
"""Excess of a bounding circle's radius [m]. It exceeds the rounding error in areas of up to 10 km."""


def building_table(
    buildings: Sequence[tuple[Sequence[tuple[float, float]], float]], first: int = 0
) -> tuple[RecordArray, FloatArray]:
    """Return the tables of buildings.

    Args:
        buildings: For each building the corners of its footprint [m], in either orientation, and its height [m].
        first: Row of their first corner in the table of corners.

    Returns:
        The table of `HazardRow`, and the corners of all footprints [m], shape (corners, 2).

    Raises:
        ValueError: If a footprint has no area, or a height is not positive and finite.
    """
    rows: list[HazardRow] = []
    corners = [np.zeros((0, 2))]
    for k, (polygon, height) in enumerate(buildings):
        footprint = np.array(polygon, dtype=np.float64).reshape(-1, 2)
        area = _signed_area(footprint)
        if not abs(area) > 0.0:
            raise ValueError(f"buildings[{k}]: no area; give the corners of a simple polygon")
        if not 0.0 < height < math.inf:
            raise ValueError(f"buildings[{k}].height = {height}: not positive and finite")
        footprint = footprint if area > 0.0 else footprint[::-1]
        x, y = (0.5 * (footprint.min(axis=0) + footprint.max(axis=0))).tolist()
        bounding_radius = float(np.hypot(footprint[:, 0] - x, footprint[:, 1] - y).max()) + _MARGIN
        rows.append(
            HazardRow(BLOCK, 1.0, x, y, 0.0, bounding_radius, first, len(footprint), height)
        )
        corners.append(footprint)
        first += len(footprint)
    return records(HazardRow, rows), np.concatenate(corners)


def tables_of(buildings: Sequence[Building], first: int = 0) -> tuple[RecordArray, FloatArray]:
    """Return the `building_table` of messages."""
    return building_table([(one.corners, one.height) for one in buildings], first)


def _signed_area(footprint: FloatArray) -> float:
    """Return the area of a polygon [m²]; negative if its corners are in clockwise order. Shape (corners, 2)."""
    if len(footprint) == 0:
        return 0.0
    x, y = (footprint - footprint[0]).T
    return float(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


@compiled
def _may_meet(
    buildings: RecordArray, k: int, start: tuple[float, float], end: tuple[float, float]
) -> bool:
    """Return False only if the segment from start to end misses a building's bounding circle."""
    row = buildings[k]
    away2 = segment_distance2(start[0], start[1], end[0], end[1], row["x"], row["y"])
    return bool(away2 <= row["bounding_radius"] * row["bounding_radius"])


@compiled
def line_of_sight(
    buildings: RecordArray,
    corners: FloatArray,
    x: float,
    y: float,
    z: float,
    q_x: float,
    q_y: float,
    h: float,
) -> bool:
    """Return whether a camera sees a point: the segment between them, or one just beside it, is outside all buildings.

    A building of height H hides the point if the part of the segment below H is inside its footprint somewhere. A
    building with H <= h hides nothing: a point on a roof is visible from above. A point inside the footprint, and lower
    than the roof, is hidden; one on a wall is visible from outside, within `ON_EDGE`.

    Args:
        buildings, corners: Tables as from `building_table`.
        x, y, z: Position of the camera, and its height above the ground [m]; outside of all buildings.
        q_x, q_y, h: Position of the point, and its height above the ground, at most z [m].
    """
    back = x - q_x, y - q_y
    length = norm(back[0], back[1])
    left = right = True
    for k in range(buildings.shape[0]):
        row = buildings[k]
        height = row["height"]
        if height <= h:
            continue
        share = 1.0 if height >= z else (height - h) / (z - h)
        point, end = (q_x, q_y), (q_x + share * back[0], q_y + share * back[1])
        if not _may_meet(buildings, k, point, end):
            continue
        first, count = row["first"], row["corners"]
        if length <= ON_EDGE:  # straight from above
            if lies_inside(corners, first, count, q_x, q_y):
                return False
            continue
        begin = min(ON_EDGE / length, share)
        part = begin, max(begin, share - ON_EDGE / length)
        left = left and not passes_inside(corners, first, count, point, back, part, 1)
        right = right and not passes_inside(corners, first, count, point, back, part, -1)
        if not (left or right):
            return False
    return True


@compiled
def building_distance(
    buildings: RecordArray, corners: FloatArray, x: float, y: float, lowest_height: float
) -> float:
    """Return the distance of a point from the nearest building that is higher than `lowest_height` [m].

    Args:
        buildings, corners: Tables as from `building_table`.
        x, y: The point [m].
        lowest_height: Lower buildings, and buildings of this height, do not count [m].

    Returns:
        The distance [m]; 0 inside and on a wall; infinite without such a building.
    """
    nearest = math.inf
    for k in range(buildings.shape[0]):
        row = buildings[k]
        near = norm(x - row["x"], y - row["y"]) - row["bounding_radius"] < nearest
        if near and row["height"] > lowest_height:
            distance = distance_to_polygon(corners, row["first"], row["corners"], x, y)
            nearest = min(nearest, distance)
    return nearest


@compiled
def sees_corner(
    buildings: RecordArray,
    corners: FloatArray,
    k: int,
    n: int,
    camera: CameraPosition,
    sensing_range: float,
) -> bool:
    """Return whether a camera sees a corner of a roof; of a wall if the roof is higher than the camera.

    Args:
        buildings, corners: Tables as from `building_table`.
        k, n: Row of the building, and row of its corner.
        camera: Position of the camera.
        sensing_range: Range of the camera on the ground [m].
    """
    x, y, z = camera
    d_x, d_y = x - corners[n, 0], y - corners[n, 1]
    if d_x * d_x + d_y * d_y > sensing_range * sensing_range:
        return False
    h = min(buildings[k]["height"], z)
    seen: bool = line_of_sight(buildings, corners, x, y, z, corners[n, 0], corners[n, 1], h)
    return seen


@compiled
def cover_footprint(
    coverage: FloatArray,
    buildings: RecordArray,
    corners: FloatArray,
    k: int,
    cell: float,
    value: float,
) -> None:
    """Set the cells of a map whose centers are under a building, not on its edge: there, a camera may see them.

    Args:
        coverage: The map; changed. Shape (rows, columns).
        buildings, corners: Tables as from `building_table`.
        k: Row of the building.
        cell: Width of a cell [m].
        value: New value of the cells.
    """
    row = buildings[k]
    first_row, end_row = chord(row["y"], row["bounding_radius"], cell, coverage.shape[0])
    first, end = chord(row["x"], row["bounding_radius"], cell, coverage.shape[1])
    for j in range(first_row, end_row):
        for i in range(first, end):
            x, y = (i + 0.5) * cell, (j + 0.5) * cell
            if lies_inside(corners, row["first"], row["corners"], x, y):
                coverage[j, i] = value


@compiled
def path_meets_building(
    buildings: RecordArray,
    corners: FloatArray,
    start: tuple[float, float],
    end: tuple[float, float],
    lowest_height: float,
) -> float:
    """Return the share of the segment from start to end at which it first touches a building.

    Args:
        buildings, corners, lowest_height: As in `building_distance`.
        start, end: Points [m].

    Returns:
        0: at its start, to 1: at its end; infinite: never.
    """
    first = math.inf
    for k in range(buildings.shape[0]):
        row = buildings[k]
        if row["height"] > lowest_height and _may_meet(buildings, k, start, end):
            first = min(first, share_to_polygon(corners, row["first"], row["corners"], start, end))
    return first
