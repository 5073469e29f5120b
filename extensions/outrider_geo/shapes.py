"""Footprints that contain the given buildings: simple polygons without holes, apart from each other.

Every operation adds ground to the buildings, or joins them; none takes any away.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from shapely import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from bus.messages.buildings import MOST_BUILDING_CORNERS
from sim.compiling.compile import FloatArray, IntArray

Polygons = list[Polygon]

APART = 0.01
"""Smallest distance between two footprints [m]."""
_GRID = 1e-3
"""Grid of the corners [m]."""
_THICKER = 2.0 * _GRID
"""Distance by which all walls move outwards first [m]."""
_SLACK = 5.0 * _GRID
"""Least distance by which simplified walls move outwards [m]; corners then move to the grid."""
_GROWN = 0.4
"""Share of the tolerance by which walls move outwards before corners are removed, within the same share."""
_MITRE = 1.5
"""Largest distance of a grown corner from the wall's, in distances by which the wall moves: a right angle's is 1.41."""


class Repaired(NamedTuple):
    """Valid geometries of the given buildings, and how many were not valid."""

    shapes: list[BaseGeometry]
    repaired: int


def repaired(polygons: Iterable[Sequence[FloatArray]]) -> Repaired:
    """Return the valid geometry of each polygon; all walls of an invalid one remain walls.

    Args:
        polygons: Rings of each polygon [m], the outer one first. Shape (points, 2) each.
    """
    raw = [Polygon(_closed(rings[0]), [*map(_closed, rings[1:])]) for rings in polygons]
    valid = shapely.is_valid(raw)
    return Repaired(
        [one if ok else shapely.make_valid(one) for one, ok in zip(raw, valid, strict=True)],
        int((~valid).sum()),
    )


def _closed(ring: FloatArray) -> FloatArray:
    """Return a ring of at least four points whose last one is the first one."""
    closed = ring if (ring[0] == ring[-1]).all() else np.concatenate([ring, ring[:1]])
    return closed if len(closed) > 3 else np.concatenate([closed, closed[-1:]])


def contacts(shapes: Sequence[BaseGeometry]) -> int:
    """Return the number of pairs of geometries that touch or overlap, within a millimetre."""
    return len(_near(shapes, _GRID))


def _near(shapes: Sequence[BaseGeometry], distance: float) -> IntArray:
    """Return the pairs of geometries within a distance [m]. Shape (pairs, 2)."""
    if len(shapes) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    one, other = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=distance)
    pairs: IntArray = np.column_stack([one, other])[one < other]
    return pairs


def merged(shapes: Sequence[BaseGeometry], gap: float) -> Polygons:
    """Return the union of geometries, with gaps narrower than `gap` closed [m]; holes remain."""
    # a little thicker, so that even a line, to which an invalid polygon may be reduced, stays on the grid
    union, half = _union([_grown(one, _THICKER) for one in shapes]), 0.5 * gap
    # beside sharp corners, shrinking takes away a little more than growing added
    return _parts(_union([_grown(_grown(union, half), -half), union]))


def _union(shapes: Sequence[BaseGeometry]) -> BaseGeometry:
    """Return the union of geometries, with corners on the grid, which makes it robust."""
    return shapely.union_all(shapes, grid_size=_GRID)


def _grown(shape: BaseGeometry, distance: float) -> BaseGeometry:
    return shapely.buffer(shape, distance, join_style="mitre", mitre_limit=_MITRE)


def _parts(shape: BaseGeometry) -> Polygons:
    return [one for one in shapely.get_parts(shape).tolist() if isinstance(one, Polygon)]


def courts(polygons: Sequence[Polygon]) -> Polygons:
    """Return the holes of polygons, without those that are due to rounding."""
    holes = [Polygon(ring) for one in polygons for ring in one.interiors]
    return [one for one in holes if one.area > _GRID]


def filled(polygons: Sequence[Polygon]) -> Polygons:
    """Return polygons with their holes filled, and united with what stands inside them."""
    return _parts(_union([Polygon(one.exterior) for one in polygons]))


def simplified(polygon: Polygon, tolerance: float) -> Polygon:
    """Return a polygon with fewer corners that contains a given one, and exceeds it by at most `tolerance` [m]."""
    step = _GROWN * tolerance
    fewer = shapely.simplify(_outer(_grown(polygon, step)), step - _SLACK)
    least = _grown(polygon, _SLACK)  # moving corners to the grid may not uncover a wall
    if not (isinstance(fewer, Polygon) and shapely.covers(fewer, least)):
        fewer = _outer(_union([fewer, least]))
    return fewer


def _outer(shape: BaseGeometry) -> Polygon:
    """Return the outline of a connected geometry, without holes."""
    parts = _parts(shape)
    outer = [Polygon(one.exterior) for one in parts]
    return outer[0] if len(outer) == 1 else shapely.convex_hull(MultiPolygon(outer))


def apart(polygons: Sequence[Polygon], area: Polygon, tolerance: float) -> Polygons:
    """Return footprints inside an area that are apart from each other and have few enough corners.

    Footprints that touch are joined; one with too many corners is simplified, with a tolerance that doubles until it
    has few enough.

    Args:
        polygons: Footprints without holes [m].
        area: The area, a rectangle [m].
        tolerance: Tolerance of the first simplification [m].
    """
    found = list(polygons)
    while True:
        found = _clipped(found, area)
        groups = _groups(found)
        if len(groups) < len(found):
            found = [_joined(group) for group in groups]
            continue
        large = [corners_of(one) > MOST_BUILDING_CORNERS for one in found]
        if not any(large):
            return found
        tolerance *= 2.0
        found = [
            simplified(one, tolerance) if too_many else one
            for one, too_many in zip(found, large, strict=True)
        ]


def corners_of(polygon: Polygon) -> int:
    """Return the number of corners of a polygon's outline."""
    return len(polygon.exterior.coords) - 1


def _clipped(polygons: Sequence[Polygon], area: Polygon) -> Polygons:
    """Return the parts of polygons inside an area, with corners on the grid, without holes."""
    inside = [shapely.intersection(one, area, grid_size=_GRID) for one in polygons]
    return filled([part for one in inside for part in _parts(one)])


def _groups(polygons: Polygons) -> list[Polygons]:
    """Return the groups of polygons that are not apart."""
    pairs = _near(polygons, APART)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(polygons),) * 2)
    count, labels = connected_components(graph, directed=False)
    groups: list[Polygons] = [[] for _ in range(count)]
    for one, label in zip(polygons, labels.tolist(), strict=True):
        groups[label].append(one)
    return groups


def _joined(group: Polygons) -> Polygon:
    """Return a polygon that contains a group of polygons, each near another one."""
    if len(group) == 1:
        return group[0]
    reach = 4.0 * APART
    bridges = [
        shapely.convex_hull(
            shapely.union(
                shapely.intersection(group[i], _grown(group[j], reach)),
                shapely.intersection(group[j], _grown(group[i], reach)),
            )
        )
        for i, j in _near(group, APART).tolist()
    ]
    return _outer(_union([*group, *bridges]))
