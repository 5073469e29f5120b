"""Reading of buildings from GeoJSON, RFC 7946, as exported from OpenStreetMap or Overture."""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from bus.errors import ScenarioError
from bus.files import read_regular
from outrider_geo.heights import height_of
from outrider_geo.statements import statements
from sim.input.faults import Fault, one_line

MOST_BYTES = 256 << 20
"""Maximum size of a file [bytes]."""
_ALLOWED = "GeoJSON with Polygon and MultiPolygon features, as exported by Overpass turbo, osmtogeojson or Overture"
_BUILDING = ("building", "building:part")
_DEGREES = "WGS 84 longitude and latitude in degrees, as from ogr2ogr -t_srs EPSG:4326"
_CRS = ("CRS84", "4326")

Point = tuple[float, float]
Polygon = list[list[Point]]
"""Rings of longitude and latitude [deg], the outer one first."""


class Outline(NamedTuple):
    """Building of a file."""

    polygons: tuple[Polygon, ...]
    height: float | None
    """Its height [m]; None: unknown."""


class Buildings(NamedTuple):
    """Buildings of a file, and what was not read."""

    outlines: tuple[Outline, ...]
    counts: Counter[str]
    """Features by what became of them, and buildings by the source of their height."""
    statements: tuple[str, ...]
    """Statements of the file on its source, date and licence."""


def read_buildings(path: Path) -> Buildings:
    """Read the buildings of a GeoJSON file.

    If any feature has a property `building` or `building:part`, only such features are buildings; otherwise all
    polygons are. Underground buildings are no obstacles.

    Raises:
        ScenarioError: If it cannot be read, is not GeoJSON in degrees, or has no buildings.
    """
    file = one_line(str(path))
    collection = _collection(path, file)
    features = [_feature(one, k, file) for k, one in enumerate(collection["features"])]
    tagged = any(_is_building(tags) for tags, _ in features)
    counts: Counter[str] = Counter(features=len(features))
    outlines = []
    for k, (tags, geometry) in enumerate(features):
        if tagged and not _is_building(tags):
            counts["not_buildings"] += 1
        elif _is_underground(tags):
            counts["underground"] += 1
        elif polygons := tuple(_polygons(geometry, f"features.{k}.geometry", file)):
            height, source = height_of(tags)
            outlines.append(Outline(polygons, height))
            counts[f"height_{source}"] += 1
        else:
            counts["without_polygon"] += 1
    if not outlines:
        raise ScenarioError(
            f"{file}: {len(features):,} features, no building; allowed: polygons, with the property building if other "
            "features have it"
        )
    return Buildings(tuple(outlines), counts, statements(collection))


def _collection(path: Path, file: str) -> dict[str, Any]:
    """Return the FeatureCollection in a file; a single feature or geometry becomes one."""
    try:
        found = json.loads(read_regular(path, MOST_BYTES))
    except FileNotFoundError as error:
        raise ScenarioError(f"{file}: no such file; allowed: {_ALLOWED}") from error
    except OSError as error:
        raise ScenarioError(f"{file}: {error.strerror}; allowed: {_ALLOWED}") from error
    except RecursionError as error:
        raise ScenarioError(
            f"{file}: not GeoJSON: nested too deeply; allowed: {_ALLOWED}"
        ) from error
    except ValueError as error:  # of JSON, of UTF-8, or of a NUL in the path
        raise ScenarioError(
            f"{file}: not JSON: {one_line(str(error))}; allowed: {_ALLOWED}"
        ) from error
    if not isinstance(found, dict):
        raise ScenarioError(f"{file}: not GeoJSON: no object; allowed: {_ALLOWED}")
    if "type" not in found and isinstance(found.get("elements"), list):
        raise ScenarioError(f"{file}: Overpass JSON; allowed: {_ALLOWED}")
    _check_crs(found, file)
    kind = found.get("type")
    if kind == "FeatureCollection":
        if not isinstance(found.get("features"), list):
            raise Fault("features", None, "missing", "a list of features").error(file)
        return found
    if kind == "Feature":
        return {**found, "features": [found]}
    if kind in ("Polygon", "MultiPolygon", "GeometryCollection"):
        return {"features": [{"geometry": found, "properties": {}}]}
    raise Fault("type", kind, "not GeoJSON with polygons", _ALLOWED).error(file)


def _check_crs(collection: Mapping[str, Any], file: str) -> None:
    """Check the coordinate reference system that older files name.

    Raises:
        ScenarioError: If it is not WGS 84.
    """
    crs = collection.get("crs")
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if name is not None and not str(name).endswith(_CRS):
        raise Fault("crs.properties.name", name, "not WGS 84", _DEGREES).error(file)


def _feature(feature: object, k: int, file: str) -> tuple[Mapping[str, object], object]:
    """Return the properties and the geometry of a feature; older exports keep the tags in a table `tags`."""
    if not isinstance(feature, dict):
        raise Fault(f"features.{k}", feature, "no object", _ALLOWED).error(file)
    properties = feature.get("properties")
    tags = properties if isinstance(properties, dict) else {}
    inner = tags.get("tags")
    return ({**tags, **inner} if isinstance(inner, dict) else tags), feature.get("geometry")


def _is_building(tags: Mapping[str, object]) -> bool:
    return any(tags.get(name) not in (None, "", "no", False) for name in _BUILDING)


def _is_underground(tags: Mapping[str, object]) -> bool:
    return tags.get("location") == "underground" or tags.get("is_underground") in (True, "true")


def _polygons(geometry: object, path: str, file: str) -> Iterator[Polygon]:
    """Yield the polygons of a geometry; other geometries have none.

    Raises:
        ScenarioError: If a polygon is malformed, or its coordinates are not degrees.
    """
    if not isinstance(geometry, dict):
        return
    kind, given = geometry.get("type"), geometry.get("coordinates")
    if kind == "GeometryCollection":
        inner = geometry.get("geometries")
        for k, one in enumerate(inner if isinstance(inner, list) else []):
            yield from _polygons(one, f"{path}.geometries.{k}", file)
    elif kind in ("Polygon", "MultiPolygon"):
        where = f"{path}.coordinates"
        if not isinstance(given, list):
            raise Fault(where, given, "no list", f"the rings of a {kind}").error(file)
        for one in [given] if kind == "Polygon" else given:
            if not isinstance(one, list):
                raise Fault(where, one, "no list of rings", f"the rings of a {kind}").error(file)
            rings = [_ring(ring, where, file) for ring in one]
            if rings:
                yield rings


def _ring(ring: object, path: str, file: str) -> list[Point]:
    """Return the points of a ring."""
    if not isinstance(ring, list) or len(ring) < 3:
        allowed = "a ring of four points or more, the first one also last"
        raise Fault(path, ring, "not a ring", allowed).error(file)
    return [_point(point, path, file) for point in ring]


def _point(point: object, path: str, file: str) -> Point:
    """Return the longitude and latitude of a position [deg]."""
    numbers = point[:2] if isinstance(point, list) else []
    if len(numbers) != 2 or not all(type(one) in (int, float) for one in numbers):
        raise Fault(path, point, "not a position", "[longitude, latitude] in degrees").error(file)
    x, y = numbers
    if abs(x) <= 180.0 and abs(y) <= 90.0:
        return float(x), float(y)
    finite = all(isinstance(one, int) or math.isfinite(one) for one in numbers)
    wrong = "projected coordinates, not degrees" if finite else "not finite"
    raise Fault(path, [x, y], wrong, _DEGREES).error(file)
