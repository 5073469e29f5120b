"""Hazards of a scenario as tables for compiled code."""

import math
from collections.abc import Iterator
from hashlib import blake2b
from typing import NamedTuple

import numpy as np

from bus.messages.base import Vector
from bus.messages.ground import Hazard
from bus.registry import DRIVERS, HAZARDS
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray, records
from sim.models.ground import CLEAR, TileArray, fill_tiles, tile_index, tiles_shape
from sim.models.hazard_fields import HazardFieldRow, place_hazards, work_array
from sim.models.hazards import HazardRow
from sim.models.randomness import Key
from sim.scenario.types import HazardField, Scenario, Ugv

_WAY_BITS = 63
"""Number of routes with a bit of their own; further routes have hashes that cancel only with probability 2^-63."""


class GroundTables(NamedTuple):
    """Ground of a scenario, the same in each of its runs."""

    hazards: RecordArray
    """Table of `HazardRow`, with empty rows at the end for the hazards of fields."""
    corners: FloatArray
    """Corners of the polygons [m]. Shape (corners, 2)."""
    tiles: TileArray
    """True states with the given hazards, without the hazards of fields. Shape (rows, columns)."""
    fields: RecordArray
    """Table of `HazardFieldRow`."""
    stops: FloatArray
    """Starts and goals of the UGVs [m]. Shape (stops, 2)."""
    ways: IntArray
    """Routes from each start to its goals, in the form of `sim.models.hazard_fields.place_hazards`. Shape (routes,
    5).
    """


def ground_tables(scenario: Scenario) -> GroundTables:
    """Return the tables of a valid scenario."""
    given = hazard_rows(scenario.hazard)
    room = sum(field.count for field in scenario.hazard_field)
    hazards = np.concatenate([given, np.zeros(room, dtype=given.dtype)])
    corners = corners_of(scenario.hazard)
    shape = tiles_shape(scenario.area.width, scenario.area.height, scenario.ground.tile)
    tiles = np.full(shape, CLEAR, dtype=np.uint8)
    if scenario.hazard:  # without hazards nothing is compiled for them
        fill_tiles(given, corners, scenario.ground.tile, tiles)
    points = [point for ugv in scenario.ugv for point in stops(ugv)]
    return GroundTables(
        hazards,
        corners,
        tiles,
        fields=records(HazardFieldRow, [_field_row(field) for field in scenario.hazard_field]),
        stops=np.array(points, dtype=np.float64),
        ways=_ways(scenario, *tiles.shape),
    )


def place_fields(scenario: Scenario, tables: GroundTables, key: Key) -> int:
    """Draw the hazards of the scenario's fields.

    Args:
        scenario: The scenario.
        tables: Its tables, without hazards of fields; `hazards` and `tiles` are changed.
        key: Key of the random numbers.

    Returns:
        Total number of hazards.
    """
    return place_hazards(
        tables.fields,
        tables.stops,
        tables.ways,
        (scenario.area.width, scenario.area.height),
        scenario.ground.tile,
        key,
        tables.hazards,
        len(scenario.hazard),
        tables.tiles,
        work_array(*tables.tiles.shape),
    )


def _field_row(field: HazardField) -> HazardFieldRow:
    kind, (smallest, largest) = HAZARDS[field.kind].code, field.radius
    return HazardFieldRow(
        kind, field.count, smallest, largest, share=field.kept_share, clear=field.clearance
    )


def _ways(scenario: Scenario, rows: int, columns: int) -> IntArray:
    tile, ways = scenario.ground.tile, []
    for ugv in scenario.ugv:
        places = [(tile_index(y, tile, rows), tile_index(x, tile, columns)) for x, y in stops(ugv)]
        start, *goals = places
        ways += [(*start, *goal) for goal in dict.fromkeys(goals) if goal != start] or [start * 2]
    ways = list(dict.fromkeys(ways))
    return np.array([(*way, _way_bits(n)) for n, way in enumerate(ways)], dtype=np.int64)


def _way_bits(way: int) -> int:
    if way < _WAY_BITS:
        return 1 << way
    digest = blake2b(way.to_bytes(8, "little"), digest_size=8).digest()
    return int.from_bytes(digest, "little", signed=True)


def corners_of(hazards: tuple[Hazard, ...]) -> FloatArray:
    """Return the corners of all polygons, concatenated [m]. Shape (corners, 2)."""
    found = [corner for hazard in hazards for corner in hazard.corners]
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def hazard_rows(hazards: tuple[Hazard, ...]) -> RecordArray:
    """Return a table of `HazardRow`, one row per hazard."""
    return records(HazardRow, list(_rows(hazards)))


def _rows(hazards: tuple[Hazard, ...]) -> Iterator[HazardRow]:
    first = 0
    for hazard in hazards:
        kind, count, radius = HAZARDS[hazard.kind].code, len(hazard.corners), hazard.radius or 0.0
        reach = 0.5 * math.dist(*hazard.bounds) if count else radius
        yield HazardRow(kind, hazard.kept_share, *hazard.middle, radius, reach, first, count)
        first += count


def stops(ugv: Ugv) -> tuple[Vector, ...]:
    """Return the start of a UGV, and its goals if its driver uses them [m]."""
    driver = DRIVERS[ugv.driver]
    roams = driver.provided and driver.wants != "goals"
    return (ugv.position, *(() if roams else ugv.goals))
