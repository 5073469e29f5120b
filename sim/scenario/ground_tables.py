"""Hazards of a scenario as tables for compiled code."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from bus.messages.base import Vector
from bus.messages.buildings import Building
from bus.messages.ground import Hazard
from bus.registry import HAZARDS
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray, records
from sim.models.buildings import tables_of
from sim.models.ground import (
    CLEAR,
    TileArray,
    add_disc,
    add_polygon,
    fill_tiles,
    tile_index,
    tiles_shape,
)
from sim.models.hazard_fields import HazardFieldRow, place_hazards
from sim.models.hazards import BLOCK, HazardRow
from sim.models.randomness import Key
from sim.scenario.building_tables import building_rooms
from sim.scenario.clearance import enlargement
from sim.scenario.ground_types import HazardField
from sim.scenario.stops import stops
from sim.scenario.types import Scenario

BLOCK_CORNERS = 4
"""Corners of a building at a random position."""


class GroundTables(NamedTuple):
    """Ground of a scenario, the same in each of its runs."""

    hazards: RecordArray
    """Table of `HazardRow`: the given hazards, the buildings, then the hazards of fields. Rows for what is at random
    positions are empty.
    """
    buildings: range
    """Rows of the buildings, which block like hazards of the kind `block`."""
    corners: FloatArray
    """Corners of the polygons [m]; zero for buildings at random positions. Shape (corners, 2)."""
    tiles: TileArray
    """True states with the given hazards and buildings. Shape (rows, columns)."""
    closed: TileArray
    """States with the buildings enlarged by the largest `building_clearance`, and with all that blocks enlarged by
    `enlargement` if the buildings are unknown: routes lead around them. The same array as `tiles` if nothing is
    enlarged. Shape (rows, columns).
    """
    fields: RecordArray
    """Table of `HazardFieldRow`."""
    stops: FloatArray
    """Starts and goals of the UGVs [m]. Shape (stops, 2)."""
    routes: IntArray
    """Routes from each start to its goals, in the form of `sim.models.hazard_fields.place_hazards`. Shape (routes,
    4).
    """


def ground_tables(scenario: Scenario) -> GroundTables:
    """Return the tables of a valid scenario."""
    rooms = sum(building_rooms(scenario))
    given = hazard_rows(scenario.hazard)
    corners = corners_of(scenario.hazard)
    houses, footprints = tables_of(scenario.building, first=len(corners))
    room = rooms + sum(field.count for field in scenario.hazard_field)
    hazards = np.concatenate([given, houses, np.zeros(room, dtype=given.dtype)])
    buildings = range(len(given), len(given) + len(houses) + rooms)
    corners = np.concatenate([corners, footprints, np.zeros((rooms * BLOCK_CORNERS, 2))])
    shape = tiles_shape(scenario.area.width, scenario.area.height, scenario.ground.tile)
    tiles = np.full(shape, CLEAR, dtype=np.uint8)
    if scenario.hazard or scenario.building:  # without hazards nothing is compiled for them
        fill_tiles(hazards[: len(given) + len(houses)], corners, scenario.ground.tile, tiles)
    points = [point for ugv in scenario.ugv for point in stops(ugv)]
    tables = GroundTables(
        hazards,
        buildings,
        corners,
        tiles,
        closed=tiles,
        fields=records(
            HazardFieldRow, [_field_row(scenario, one) for one in scenario.hazard_field]
        ),
        stops=np.array(points, dtype=np.float64),
        routes=_routes(scenario, *tiles.shape),
    )
    return tables._replace(closed=_closed_tiles(scenario, tables, scenario.building))


def world_corners(scenario: Scenario, tables: GroundTables, worlds: int) -> FloatArray:
    """Return the corners of all worlds: from the tables, with random buildings of its own for each world."""
    own = first_corner(scenario, tables, 1) - first_corner(scenario, tables, 0)
    return np.concatenate([tables.corners, np.zeros(((worlds - 1) * own, 2))])


def first_corner(scenario: Scenario, tables: GroundTables, world: int) -> int:
    """Return the row of the first corner of a world's random buildings."""
    own = sum(building_rooms(scenario)) * BLOCK_CORNERS
    return len(tables.corners) + (world - 1) * own


def world_tables(
    tables: GroundTables, hazards: RecordArray, corners: FloatArray, tiles: TileArray
) -> GroundTables:
    """Return the tables of one run, with arrays of its own in the initial state."""
    closed = tiles if tables.closed is tables.tiles else tables.closed.copy()
    return tables._replace(hazards=hazards, corners=corners, tiles=tiles, closed=closed)


def _closed_tiles(
    scenario: Scenario, tables: GroundTables, buildings: tuple[Building, ...]
) -> TileArray:
    """Return the tiles with these buildings enlarged by the largest clearance."""
    kept, tile = enlargement(scenario), scenario.ground.tile
    if kept == 0.0 and (not buildings or scenario.max_building_clearance == 0.0):
        return tables.tiles
    closed, clearance = tables.tiles.copy(), kept or scenario.max_building_clearance
    for building in buildings:
        add_polygon(np.array(building.corners), clearance, BLOCK, tile, closed)
    for hazard in scenario.hazard:
        if kept > 0.0 and not HAZARDS[hazard.kind].drivable:
            if hazard.corners:
                add_polygon(np.array(hazard.corners), kept, BLOCK, tile, closed)
            else:
                x, y = hazard.middle
                add_disc(x, y, (hazard.radius or 0.0) + kept, BLOCK, tile, closed)
    return closed


def place_buildings(
    scenario: Scenario, tables: GroundTables, buildings: tuple[Building, ...], first: int
) -> GroundTables:
    """Add the buildings at random positions of a run.

    Args:
        scenario: The scenario.
        tables: Its tables, without hazards of fields; `hazards`, `corners` and `tiles` are changed.
        buildings: All buildings of the run, see `run_buildings`.
        first: Row of `corners` for the first corner of the buildings at random positions.

    Returns:
        The tables with their `closed` tiles.
    """
    drawn = buildings[len(scenario.building) :]
    rows, corners = tables_of(drawn, first=first)
    begin = tables.buildings.start + len(scenario.building)
    tables.hazards[begin : tables.buildings.stop] = 0
    tables.hazards[begin : begin + len(rows)] = rows
    tables.corners[first : first + len(corners)] = corners
    end = begin + len(rows)
    fill_tiles(tables.hazards[:end], tables.corners, scenario.ground.tile, tables.tiles)
    return tables._replace(closed=_closed_tiles(scenario, tables, buildings))


def place_fields(scenario: Scenario, tables: GroundTables, key: Key) -> int:
    """Draw the hazards of the scenario's fields.

    Args:
        scenario: The scenario.
        tables: Its tables, without hazards of fields; `hazards`, `tiles` and `closed` are changed.
        key: Key of the random numbers.

    Returns:
        Row of `hazards` after the last hazard.
    """
    behind = place_hazards(
        tables.fields,
        tables.stops,
        tables.routes,
        (scenario.area.width, scenario.area.height),
        scenario.ground.tile,
        key,
        tables.hazards,
        tables.buildings.stop,
        tables.closed,
    )
    if tables.closed is not tables.tiles:
        fill_tiles(tables.hazards, tables.corners, scenario.ground.tile, tables.tiles)
    return behind


def _field_row(scenario: Scenario, field: HazardField) -> HazardFieldRow:
    kind, (smallest, largest) = HAZARDS[field.kind].code, field.radius
    return HazardFieldRow(
        kind,
        field.count,
        smallest,
        largest,
        share=field.kept_share,
        clear=field.clearance,
        kept=0.0 if HAZARDS[field.kind].drivable else enlargement(scenario),
    )


def _routes(scenario: Scenario, rows: int, columns: int) -> IntArray:
    tile, routes = scenario.ground.tile, []
    for ugv in scenario.ugv:
        tiles = [(tile_index(y, tile, rows), tile_index(x, tile, columns)) for x, y in stops(ugv)]
        start, *goals = tiles
        routes += [(*start, *goal) for goal in goals if goal != start] or [start * 2]
    return np.array(list(dict.fromkeys(routes)), dtype=np.int64)


def corners_of(hazards: tuple[Hazard, ...]) -> FloatArray:
    """Return the corners of all polygons, concatenated [m]. Shape (corners, 2)."""
    found: list[Vector] = [corner for hazard in hazards for corner in hazard.corners]
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def hazard_rows(hazards: tuple[Hazard, ...]) -> RecordArray:
    """Return a table of `HazardRow`, one row per hazard."""
    return records(HazardRow, list(_rows(hazards)))


def _rows(hazards: tuple[Hazard, ...]) -> Iterator[HazardRow]:
    first = 0
    for hazard in hazards:
        kind, count, radius = HAZARDS[hazard.kind].code, len(hazard.corners), hazard.radius or 0.0
        bounding_radius = 0.5 * math.dist(*hazard.bounds) if count else radius
        yield HazardRow(
            kind, hazard.kept_share, *hazard.middle, radius, bounding_radius, first, count
        )
        first += count
