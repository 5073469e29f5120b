"""Geometry of hazards on the ground: discs and polygons.

Hazards are closed sets: a point on the edge touches the hazard. All functions work on tables of `HazardRow`; rows of
kind 0 are empty.
"""

import math
from typing import NamedTuple

from bus.registry import HAZARDS
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray
from sim.models.polygons import distance_to_polygon, share_to_edges
from sim.models.vehicles import norm

ROUGH, BLOCK, FOUND = HAZARDS["rough"].code, HAZARDS["block"].code, HAZARDS["find"].code
"""Kinds of hazards, and states of the tiles that they touch. BLOCK takes precedence over ROUGH, and ROUGH over
FOUND.
"""

TOUCH = 1e-9
"""Tolerance for contact between a tile and a hazard or path [m].

It exceeds the rounding error in areas of up to 10 km, so that rounding hides no hazard from a vehicle."""


class HazardRow(NamedTuple):
    """Hazard, a row of a table."""

    kind: int
    """Code of a row of `bus.registry.HAZARDS`; 0: the row is empty."""
    share: float
    """Share of its maximum speed that a vehicle keeps on it; 1 unless it is rough."""
    x: float
    y: float
    """Center of the disc, or of a circle around the polygon [m]."""
    radius: float
    """Radius of the disc [m]; 0: a polygon."""
    bounding_radius: float
    """Radius of a circle around (x, y) that contains the hazard [m]."""
    first: int
    """Row of its first corner in the table of corners."""
    corners: int
    """Number of its corners; 0: a disc."""
    height: float = 0.0
    """Height of the roof of a building above the ground [m]; 0: not a building."""


@compiled
def distance_to_hazard(
    hazards: RecordArray, corners: FloatArray, k: int, x: float, y: float
) -> float:
    """Return the distance of a point from a hazard; 0 inside and on the edge.

    Args:
        hazards: Table of `HazardRow`.
        corners: Corners of all polygons, each in order [m]. Shape (corners, 2).
        k: Index of the hazard.
        x, y: The point [m].

    Returns:
        The distance [m].
    """
    row = hazards[k]
    if row["corners"] == 0:
        away: float = norm(x - row["x"], y - row["y"]) - row["radius"]
        return max(away, 0.0)
    distance: float = distance_to_polygon(corners, row["first"], row["corners"], x, y)
    return distance


@compiled
def may_be_within(hazards: RecordArray, k: int, x: float, y: float, distance: float) -> bool:
    """Return False only if a point is farther than `distance` [m] from a hazard's bounding circle.

    Other arguments as in `distance_to_hazard`.
    """
    row = hazards[k]
    d_x, d_y, far = x - row["x"], y - row["y"], row["bounding_radius"] + distance
    return bool(d_x * d_x + d_y * d_y <= far * far)


@compiled
def point_in_hazard(hazards: RecordArray, corners: FloatArray, k: int, x: float, y: float) -> bool:
    """Return whether a point touches a hazard. Arguments as in `distance_to_hazard`."""
    near = may_be_within(hazards, k, x, y, TOUCH)
    return near and distance_to_hazard(hazards, corners, k, x, y) == 0.0


@compiled
def hazard_at(hazards: RecordArray, corners: FloatArray, kind: int, x: float, y: float) -> int:
    """Return the first hazard of a kind that a point touches; -1: none.

    Args:
        hazards, corners: As in `distance_to_hazard`.
        kind: Code of a row of `HAZARDS`.
        x, y: The point [m].
    """
    for k in range(hazards.shape[0]):
        if hazards[k]["kind"] == kind and point_in_hazard(hazards, corners, k, x, y):
            return k
    return -1


@compiled
def rough_share(hazards: RecordArray, corners: FloatArray, x: float, y: float) -> float:
    """Return the share of maximum speed that a vehicle keeps at a point: the smallest of the rough hazards there, or 1.

    Args:
        hazards, corners: As in `distance_to_hazard`.
        x, y: The point [m].
    """
    least = 1.0
    for k in range(hazards.shape[0]):
        row = hazards[k]
        if (
            row["kind"] == ROUGH
            and row["share"] < least
            and point_in_hazard(hazards, corners, k, x, y)
        ):
            least = row["share"]
    return least


@compiled
def share_to_hazard(
    hazards: RecordArray,
    corners: FloatArray,
    k: int,
    start: tuple[float, float],
    end: tuple[float, float],
) -> float:
    """Return the share of the segment from start to end at which it first touches a hazard; infinite: never.

    Args:
        hazards, corners, k: As in `distance_to_hazard`.
        start, end: Points [m].

    Returns:
        0: at its start, to 1: at its end.
    """
    row = hazards[k]
    p_x, p_y = start
    d_x, d_y = end[0] - p_x, end[1] - p_y
    if point_in_hazard(hazards, corners, k, p_x, p_y):
        return 0.0
    first = 1.0 if point_in_hazard(hazards, corners, k, end[0], end[1]) else math.inf
    if row["corners"] == 0:
        # |p + t d - c| = r: the smaller root, where the segment enters
        length2, radius = d_x * d_x + d_y * d_y, row["radius"]
        f_x, f_y = p_x - row["x"], p_y - row["y"]
        half = f_x * d_x + f_y * d_y
        square = half * half - length2 * (f_x * f_x + f_y * f_y - radius * radius)
        if square < 0.0 or length2 == 0.0:
            return first
        share = (-half - math.sqrt(square)) / length2
        return min(first, share) if 0.0 <= share <= 1.0 else first
    return min(first, share_to_edges(corners, row["first"], row["corners"], start, end))


@compiled
def crosses_hazard(
    hazards: RecordArray,
    corners: FloatArray,
    kind: int,
    start: tuple[float, float],
    end: tuple[float, float],
) -> tuple[int, float]:
    """Return the first hazard of a kind on the segment from start to end, and the share of the segment before it.

    Within a tick a vehicle deviates from this segment by at most u dt² / 8.

    Args:
        hazards, corners: As in `distance_to_hazard`.
        kind: Code of a row of `HAZARDS`.
        start, end: Points [m].

    Returns:
        Index of the hazard, and the share from 0 to 1; -1 and infinity: none.
    """
    found, first = -1, math.inf
    length = norm(end[0] - start[0], end[1] - start[1])
    for k in range(hazards.shape[0]):
        near = may_be_within(hazards, k, start[0], start[1], length + TOUCH)
        if near and hazards[k]["kind"] == kind:
            share = share_to_hazard(hazards, corners, k, start, end)
            if share < first:
                found, first = k, share
    return found, first
