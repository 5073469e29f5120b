"""A town: its area, its buildings in metres, and what was done to them."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
import shapely
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from bus.errors import ScenarioError
from bus.geodesy import geodetic, local
from bus.messages.buildings import MOST_BUILDINGS, Building
from bus.messages.scenario import Area, Origin
from bus.numbers import exact
from outrider_geo import shapes
from outrider_geo.reading import Buildings, Outline
from sim.compiling.compile import FloatArray
from sim.scenario.building_checks import MOST_CORNERS

WIDEST = 2000.0
"""Largest side of an imported area [m]: the error of the flat Earth is decimetres there."""
_LATITUDES = 80.0
"""Largest latitude of a scenario's origin [deg]."""
_CELLS = ((500.0, 0.5), (1000.0, 1.0), (WIDEST, 2.0))
"""Sides of tiles and cells by the largest side of the area [m]: at most a million tiles."""
_STRAIGHT = 1e-3
"""Largest distance of a corner from a straight wall [m]."""
_STEP = 0.95
"""Ratio of the sides that are tried one after the other."""


class Options(NamedTuple):
    """Options of an import."""

    center: tuple[float, float] | None = None
    """Latitude and longitude of the area's centre [deg]; None: the centre of the data."""
    size: tuple[float, float] | None = None
    """Width and height of the area [m]; None: all buildings, with a street around them."""
    height: float = 6.0
    """Height of buildings of unknown height [m]."""
    clearance: float = 2.0
    """Distance that the UGV keeps from buildings [m]."""
    gap: float = 1.0
    """Gaps that are narrower are closed [m]."""
    tolerance: float = 0.3
    """Largest distance by which simplified walls move outwards [m]."""
    min_area: float = 0.0
    """Smaller buildings are dropped [m²]."""


class Step(NamedTuple):
    """Buildings after one step of an import."""

    name: str
    buildings: int
    corners: int
    area: float
    """Covered ground [m²]."""


class Town(NamedTuple):
    """Buildings of an area."""

    area: Area
    origin: Origin
    buildings: tuple[Building, ...]
    steps: tuple[Step, ...]
    counts: Counter[str]
    uncovered: float
    """Ground of given buildings in the area that is outside all buildings [m²]."""


class _Given(NamedTuple):
    """Given buildings in metres."""

    polygons: list[list[FloatArray]]
    heights: list[float]


def import_town(found: Buildings, options: Options, file: str) -> Town:
    """Return the town of the buildings of a file.

    Raises:
        ScenarioError: If the area is too large, has too many buildings, or has none.
    """
    area, origin = _area(found.outlines, options, file)
    town = _town(found, options, area, origin)
    if not town.buildings:
        center = _middle(_points(found.outlines))
        raise ScenarioError(
            f"{file}: no building in the area; allowed: --origin and --size with a building inside, such as --origin "
            f"{center[0]:.5f},{center[1]:.5f}, and a smaller --min-area"
        )
    if _too_many(town):
        size = _largest_size(found, options, town)
        corners = sum(len(one.polygon) for one in town.buildings)
        raise ScenarioError(
            f"{file}: {len(town.buildings):,} buildings with {corners:,} corners in {_metres(area)} m; allowed: "
            f"{MOST_BUILDINGS:,} buildings and {MOST_CORNERS:,} corners at most: --size {size} has few enough"
        )
    return town


def _too_many(town: Town) -> bool:
    corners = sum(len(one.polygon) for one in town.buildings)
    return len(town.buildings) > MOST_BUILDINGS or corners > MOST_CORNERS


def _metres(area: Area) -> str:
    return f"{exact(area.width)} x {exact(area.height)}"


def _area(outlines: Sequence[Outline], options: Options, file: str) -> tuple[Area, Origin]:
    """Return the area, and the geographic position of its lower left corner."""
    points = _points(outlines)
    longitude, latitude = points.T
    phi, theta = _middle(points) if options.center is None else options.center
    if abs(phi) > _LATITUDES:
        raise ScenarioError(
            f"{file}: latitude {exact(phi)} of the area's centre: too near to a pole; allowed: -80 to 80 degrees"
        )
    center = Origin(latitude=phi, longitude=theta, altitude=0.0)
    if options.size is None:
        reach = np.abs(local(center, latitude, longitude)).max(axis=0)
        street = 2.0 * options.clearance + 4.0
        width, height = (2.0 * math.ceil(one + street) for one in reach.tolist())
    else:
        width, height = options.size
    if max(width, height) > WIDEST:
        given = "--size" if options.size else "the buildings reach over"
        raise ScenarioError(
            f"{file}: {given} {exact(width)} x {exact(height)} m: too large; allowed: {exact(WIDEST)} m at most, such "
            "as --size 400,400, around --origin LAT,LON"
        )
    cell = next(cell for widest, cell in _CELLS if max(width, height) <= widest)
    area = Area(width=_whole(width, cell), height=_whole(height, cell), cell=cell)
    south, west, _ = geodetic(center, -0.5 * area.width, -0.5 * area.height)
    return area, Origin(latitude=round(south, 8), longitude=round(west, 8), altitude=0.0)


def _points(outlines: Sequence[Outline]) -> FloatArray:
    """Return the longitudes and latitudes of all outer rings [deg]. Shape (points, 2)."""
    return np.array([point for one in outlines for rings in one.polygons for point in rings[0]])


def _middle(points: FloatArray) -> tuple[float, float]:
    """Return latitude and longitude of the centre of points [deg]; they may lie across the antimeridian."""
    longitude, latitude = points.T
    near = (longitude - longitude[0] + 180.0) % 360.0 - 180.0
    theta = float(longitude[0] + 0.5 * (near.min() + near.max()) + 180.0) % 360.0 - 180.0
    return 0.5 * float(latitude.min() + latitude.max()), theta


def _whole(side: float, cell: float) -> float:
    """Return a side of a whole number of cells [m]."""
    return cell * math.ceil(side / cell - 1e-9)


def _in_metres(outlines: Sequence[Outline], origin: Origin, height: float) -> _Given:
    polygons, heights = [], []
    for one in outlines:
        for rings in one.polygons:
            points = [np.array(ring) for ring in rings]
            polygons.append([local(origin, ring[:, 1], ring[:, 0]) for ring in points])
            heights.append(height if one.height is None else one.height)
    return _Given(polygons, heights)


def _town(found: Buildings, options: Options, area: Area, origin: Origin) -> Town:
    """Return the town of an area, whatever the number of its buildings."""
    given = _in_metres(found.outlines, origin, options.height)
    box = shapely.box(0.0, 0.0, area.width, area.height)
    valid = shapes.repaired(given.polygons)
    steps = [_step("read", valid.shapes)]
    inside = shapely.intersection(valid.shapes, box)
    kept = np.flatnonzero(~shapely.is_empty(inside))
    walls: list[BaseGeometry] = inside[kept].tolist()
    heights = np.array(given.heights)[kept]
    steps.append(_step("inside the area", walls))
    counts = found.counts + Counter(
        repaired=valid.repaired, outside=len(inside) - len(kept), contacts=shapes.contacts(walls)
    )
    joined = shapes.merged(walls, max(options.gap, 2.0 * options.tolerance + shapes.APART))
    steps.append(_step("merged", joined))
    courts = shapes.courts(joined)
    full = shapes.filled(joined)
    steps.append(_step("courts filled", full))
    large = [one for one in full if one.area >= options.min_area]
    counts += Counter(courts=len(courts), dropped=len(full) - len(large))
    fewer = [shapes.simplified(one, options.tolerance) for one in large]
    footprints = shapes.apart(fewer, box, options.tolerance)
    steps.append(_step("simplified", footprints))
    if not footprints:
        return Town(area, origin, (), tuple(steps), counts, 0.0)
    highest = _heights(footprints, walls, heights)
    counts["raised"] = _raised(footprints, walls, heights, highest)
    uncovered = shapely.difference(shapely.union_all(walls), shapely.union_all(footprints)).area
    buildings = tuple(
        Building(polygon=_corners(one), height=height)
        for one, height in zip(footprints, highest, strict=True)
    )
    return Town(area, origin, buildings, tuple(steps), counts, float(uncovered))


def _step(name: str, shapes_found: Sequence[BaseGeometry]) -> Step:
    """Return the counts of geometries; corners in a straight wall do not count."""
    found = [shapely.simplify(one, _STRAIGHT) for one in shapes_found]
    corners = int(shapely.get_num_coordinates(found).sum()) if found else 0
    rings = sum(
        1 + len(part.interiors)
        for one in found
        for part in shapely.get_parts(one).tolist()
        if isinstance(part, Polygon)
    )
    return Step(name, len(found), corners - rings, float(shapely.union_all(found).area))


def _corners(footprint: Polygon) -> tuple[tuple[float, float], ...]:
    ring = shapely.get_coordinates(shapely.normalize(footprint))[:-1]
    return tuple((round(x, 3), round(y, 3)) for x, y in ring.tolist())


def _heights(
    footprints: Sequence[Polygon], walls: Sequence[BaseGeometry], heights: FloatArray
) -> list[float]:
    """Return the height of the highest given building in each footprint, rounded up to centimetres [m]."""
    highest = np.zeros(len(footprints))
    tree = shapely.STRtree(footprints)
    given, owner = tree.query(walls, predicate="intersects")
    np.maximum.at(highest, owner, heights[given])
    return [math.ceil(100.0 * one - 1e-6) / 100.0 for one in highest.tolist()]


def _raised(
    footprints: Sequence[Polygon],
    walls: Sequence[BaseGeometry],
    heights: FloatArray,
    highest: Sequence[float],
) -> int:
    """Return the number of given buildings that belong to a footprint which is higher than they are."""
    given, owner = shapely.STRtree(footprints).query(walls, predicate="intersects")
    higher = np.array(highest)[owner] > heights[given] + 0.01
    return len(set(given[higher].tolist()))


def _largest_size(found: Buildings, options: Options, town: Town) -> str:
    """Return the `--size` of an area around the same centre that has few enough buildings and corners."""
    area = town.area
    polygons = [Polygon(one.polygon) for one in town.buildings]
    corners = np.array([len(one.polygon) for one in town.buildings])
    center = geodetic(town.origin, 0.5 * area.width, 0.5 * area.height)[:2]
    share = 1.0
    while True:
        share *= _STEP
        width, height = (math.floor(share * side) for side in (area.width, area.height))
        left, low = 0.5 * (area.width - width), 0.5 * (area.height - height)
        box = shapely.box(left, low, left + width, low + height)
        inside = shapely.intersects(polygons, box)
        if inside.sum() > MOST_BUILDINGS or corners[inside].sum() > MOST_CORNERS:
            continue
        smaller = options._replace(center=center, size=(width, height))
        if not _too_many(_town(found, smaller, *_area(found.outlines, smaller, ""))):
            return f"{width},{height}"


def highest_building(town: Town) -> float:
    """Return the height of the highest building [m]."""
    return max(one.height for one in town.buildings)


def as_json(town: Town) -> dict[str, object]:
    """Return what was done, for `--json`."""
    return {
        "area": msgspec.to_builtins(town.area),
        "origin": msgspec.to_builtins(town.origin),
        "steps": [one._asdict() for one in town.steps],
        "counts": dict(town.counts),
        "uncovered_area": town.uncovered,
        "highest": highest_building(town),
    }
