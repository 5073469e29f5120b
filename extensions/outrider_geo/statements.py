"""Statements of a GeoJSON file on its source, date and licence."""

from collections.abc import Iterator, Mapping
from typing import Any

from sim.input.faults import one_line, short

_KEYS = (
    *("source", "attribution", "copyright", "license", "licence", "rights"),
    *("timestamp", "date", "generator", "osm_base", "data_timestamp", "notice"),
)
_MOST = 10
_LONGEST = 200
"""Largest length of a statement [characters]."""
NO_LICENCE = "the file states no licence: find out yours before you pass this scenario on"
OPENSTREETMAP = "OpenStreetMap data: © OpenStreetMap contributors, ODbL, https://www.openstreetmap.org/copyright"


def statements(collection: Mapping[str, Any]) -> tuple[str, ...]:
    """Return lines on source, date and licence, as the file states them.

    Args:
        collection: A FeatureCollection. Members beside its features may state them, and so may the property `sources`
            of Overture's features. Identifiers such as `way/1` are OpenStreetMap's.
    """
    found = [*_members(collection)]
    stated = " ".join(found).lower()
    names = _datasets(collection["features"])
    if names:
        found.append(f"datasets: {', '.join(names)}")
    from_osm = "openstreetmap" in " ".join([stated, *names]).lower()
    if "odbl" not in stated and (from_osm or _has_osm_ids(collection["features"])):
        found.append(OPENSTREETMAP)
    elif not any(word in stated for word in ("licen", "copyright", "odbl", "rights", "©")):
        found.append(NO_LICENCE)
    return tuple(found)


def _members(collection: Mapping[str, Any]) -> Iterator[str]:
    """Yield the members of a collection, and of its table `metadata`, that state something."""
    inner = collection.get("metadata")
    for table in (collection, inner if isinstance(inner, dict) else {}):
        for key in _KEYS:
            value = table.get(key)
            if isinstance(value, str) and value.strip():
                text = one_line(" ".join(value.split()))
                yield f"{key}: {text[:_LONGEST]}"


def _datasets(features: list[Any]) -> list[str]:
    """Return the names of the data sets in Overture's property `sources`."""
    found: dict[str, None] = {}
    for feature in features:
        properties = feature.get("properties") if isinstance(feature, dict) else None
        sources = properties.get("sources") if isinstance(properties, dict) else None
        for one in sources if isinstance(sources, list) else []:
            name = one.get("dataset") if isinstance(one, dict) else None
            if isinstance(name, str) and len(found) < _MOST:
                found[short(name)] = None
    return sorted(found)


def _has_osm_ids(features: list[Any]) -> bool:
    for feature in features:
        properties = feature.get("properties") if isinstance(feature, dict) else None
        for table in (feature, properties):
            for key in ("id", "@id"):
                value = table.get(key) if isinstance(table, dict) else None
                if isinstance(value, str) and value.startswith(("way/", "relation/")):
                    return True
    return False
