"""The hazards of a scenario as the tables that compiled code reads."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from bus.messages import Vector
from bus.registry import DRIVERS, HAZARDS
from sim.kernels.compile import FloatArray
from sim.kernels.records import RecordArray, records
from sim.models.ground import HazardRow, TileArray, fill_tiles, tiles_shape
from sim.scenario.types import Hazard, Scenario, Ugv


class GroundTables(NamedTuple):
    """What the scenario says of the ground, the same in each of its flights."""

    hazards: RecordArray
    """A table of `HazardRow`, with empty rows behind for those of its fields."""
    corners: FloatArray
    """Of the polygons [m]. Shape (corners, 2)."""
    tiles: TileArray
    """True states with the hazards that are given, without those of fields. Shape (rows, columns)."""


def ground_tables(s: Scenario) -> GroundTables:
    """The tables of a scenario whose hazards are possible."""
    given = hazard_rows(s.hazard)
    room = sum(field.count for field in s.hazard_field)
    hazards = np.concatenate([given, np.zeros(room, dtype=given.dtype)])
    corners = corners_of(s.hazard)
    tiles = np.zeros(tiles_shape(s.area.width, s.area.height, s.ground.tile), dtype=np.uint8)
    fill_tiles(given, corners, s.ground.tile, tiles)
    return GroundTables(hazards, corners, tiles)


def corners_of(hazards: tuple[Hazard, ...]) -> FloatArray:
    """The corners of all polygons, one after the other [m]. Shape (corners, 2)."""
    found = [corner for hazard in hazards for corner in hazard.polygon]
    return np.array(found, dtype=np.float64).reshape(-1, 2)


def hazard_rows(hazards: tuple[Hazard, ...]) -> RecordArray:
    """A table of `HazardRow`, with a row for each."""
    return records(HazardRow, list(_rows(hazards)))


def _rows(hazards: tuple[Hazard, ...]) -> Iterator[HazardRow]:
    first = 0
    for hazard in hazards:
        kind, count, radius = HAZARDS[hazard.kind].code, len(hazard.polygon), hazard.radius or 0.0
        if count:
            low, high = corner_bounds(hazard.polygon)
            x, y = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])
            reach = 0.5 * math.dist(low, high)
        else:
            (x, y), reach = hazard.center or (0.0, 0.0), radius
        yield HazardRow(kind, hazard.speed_share, x, y, radius, reach, first, count)
        first += count


def corner_bounds(polygon: tuple[Vector, ...]) -> tuple[Vector, Vector]:
    """The lower and the upper corner of the rectangle around a polygon [m]."""
    x, y = zip(*polygon, strict=True)
    return (min(x), min(y)), (max(x), max(y))


def stops(ugv: Ugv) -> tuple[Vector, ...]:
    """Where a UGV starts, and the goals of its driver if it has any [m]."""
    driver = DRIVERS[ugv.driver]
    roams = driver.make and driver.wants != "goals"
    return (ugv.position, *(() if roams else ugv.goals))
