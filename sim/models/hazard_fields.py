r"""Random hazards that never block the last route from a UGV's start to its goals.

Discs are drawn one after the other, by counter. A disc too close to a stop, overlapping another one, or blocking a
route is skipped. A route is a chain of adjacent tiles (4-connected) without blocking hazards.

A path of each route is marked. A disc that touches none of them blocks no route; otherwise the free tiles around it are
flooded again from the starts.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.records import RecordArray
from sim.models.ground import CLEAR, TileArray, add_disc, disc_columns, disc_rows, state_at
from sim.models.hazards import BLOCK, FOUND
from sim.models.randomness import HAZARD_PLACE, Key, draw, to_uniform
from sim.models.vehicles import norm

MOST_MISSES = 500
"""Consecutive skipped discs after which a field is full."""

_FREE, _BLOCKED = -1, -2
"""Special previous tiles: the tile is not reached; it is blocked or outside."""
Marks = npt.NDArray[np.bool_]
"""Marked tiles. Shape (rows, columns)."""


class HazardFieldRow(NamedTuple):
    """Random field, a row of a table."""

    kind: int
    """Code of a row of `bus.registry.HAZARDS`."""
    discs: int
    """Number of hazards."""
    smallest: float
    largest: float
    """Smallest and largest radius [m]."""
    share: float
    """Share of its maximum speed that a vehicle keeps; see `sim.models.hazards.HazardRow`."""
    clear: float
    """Smallest distance of its discs from all stops [m]."""
    kept: float
    """Distance from its discs at which routes stay open [m]; 0 unless they block."""


class Disc(NamedTuple):
    """Disc on the ground."""

    x: float
    y: float
    """Center [m]."""
    radius: float
    """Radius [m]."""


@compiled
def _index(i: int, j: int, columns: int) -> int:
    """Return the index of a tile on a map with a ring of blocked tiles around it."""
    return (i + 1) * (columns + 2) + j + 1


@compiled
def _flood(tiles: TileArray, start: int, previous: IntArray, queue: IntArray) -> None:
    """Flood the free tiles from a start: store the previous tile on a shortest path to each of them.

    Args:
        tiles: True states of the tiles.
        start: Index of a tile, see `_index`; its own previous tile.
        previous: Index of the previous tile of each tile, negative without one; changed.
        queue: Memory for the indices of the tiles reached.
    """
    rows, columns = tiles.shape
    previous[:] = _BLOCKED
    for i in range(rows):
        for j in range(columns):
            if tiles[i, j] != BLOCK:
                previous[_index(i, j, columns)] = _FREE
    if previous[start] == _BLOCKED:
        return
    previous[start], queue[0] = start, start
    done, reached = 0, 1
    while done < reached:
        current = queue[done]
        done += 1
        for step in (1, columns + 2, -1, -columns - 2):
            if previous[current + step] == _FREE:
                previous[current + step], queue[reached] = current, current + step
                reached += 1


@compiled
def _mark_paths(routes: IntArray, tiles: TileArray, marks: Marks) -> bool:
    """Mark the tiles of one path for each route; return False if a route is blocked.

    Args:
        routes: As in `place_hazards`.
        tiles: True states of the tiles.
        marks: Marked tiles; changed.
    """
    rows, columns = tiles.shape
    size = (rows + 2) * (columns + 2)
    previous, queue = np.empty(size, np.int64), np.empty(size, np.int64)
    marks[:] = False
    last = -1
    for k in range(routes.shape[0]):
        start = _index(routes[k, 0], routes[k, 1], columns)
        current = _index(routes[k, 2], routes[k, 3], columns)
        if start != last:
            _flood(tiles, start, previous, queue)
            last = start
        if previous[current] < 0:
            return False
        marks[current // (columns + 2) - 1, current % (columns + 2) - 1] = True
        while current != start:
            current = previous[current]
            marks[current // (columns + 2) - 1, current % (columns + 2) - 1] = True
    return True


@compiled
def _touches(x: float, y: float, radius: float, tile: float, marks: Marks) -> bool:
    """Return whether a disc touches a marked tile."""
    low, high = disc_rows(y, radius, tile, marks.shape[0])
    for i in range(low, high):
        first, end = disc_columns(x, y, radius, tile, i, marks.shape[1])
        if marks[i, first:end].any():
            return True
    return False


@compiled
def _fits(
    fields: RecordArray,
    f: int,
    disc: Disc,
    stops: FloatArray,
    tile: float,
    tiles: TileArray,
) -> bool:
    """Return whether a disc is far enough from all stops, overlaps no other disc, and hides no object to find.

    It overlaps another one if the tile at its center already has its state, or one with precedence.
    """
    x, y, radius = disc
    kind, clear = fields[f]["kind"], fields[f]["clear"]
    for n in range(stops.shape[0]):
        if norm(x - stops[n, 0], y - stops[n, 1]) < radius + clear:
            return False
    there = state_at(tiles, tile, x, y)
    if there in (kind, BLOCK):
        return False
    low, high = disc_rows(y, radius, tile, tiles.shape[0])
    for i in range(low, high):
        first, end = disc_columns(x, y, radius, tile, i, tiles.shape[1])
        for j in range(first, end):
            state = tiles[i, j]
            if state == FOUND or (kind == FOUND and state != CLEAR):
                return False
    return True


@compiled
def _drawn(fields: RecordArray, f: int, attempt: int, area: tuple[float, float], key: Key) -> Disc:
    """Draw a disc of one field."""
    field = fields[f]
    first, second, third, _ = draw(key, HAZARD_PLACE, f, attempt)
    radius = field["smallest"] + to_uniform(third) * (field["largest"] - field["smallest"])
    return Disc(to_uniform(first) * area[0], to_uniform(second) * area[1], radius)


@compiled
def place_hazards(
    fields: RecordArray,
    stops: FloatArray,
    routes: IntArray,
    area: tuple[float, float],
    tile: float,
    key: Key,
    hazards: RecordArray,
    first: int,
    tiles: TileArray,
) -> int:
    """Draw the hazards of random fields, field by field.

    Args:
        fields: Table of `HazardFieldRow`.
        stops: Points from which discs keep their clearance [m]. Shape (stops, 2).
        routes: Routes that stay open: row and column of the first and of the last tile. Routes with the same start
            follow each other. A start without a goal is a route from the start to itself. Shape (routes, 4).
        area: Width and height of the area [m].
        tile: Side of a tile [m].
        key: Key of the random numbers.
        hazards: Table of `HazardRow`, with capacity for all; changed.
        first: First row to fill. Unused rows are empty.
        tiles: True states with the hazards of earlier rows, enlarged by `kept`; changed.

    Returns:
        The row after the last filled one; fewer rows than the fields request if no more fit.
    """
    marks, new_marks = np.empty(tiles.shape, np.bool_), np.empty(tiles.shape, np.bool_)
    _mark_paths(routes, tiles, marks)
    behind = first
    for f in range(fields.shape[0]):
        field = fields[f]
        kind, last = field["kind"], behind + field["discs"]
        attempt, misses = -1, 0
        while behind < last and misses < MOST_MISSES:
            attempt, misses = attempt + 1, misses + 1
            x, y, radius = _drawn(fields, f, attempt, area, key)
            blocked_radius = radius + field["kept"]
            if not _fits(fields, f, Disc(x, y, blocked_radius), stops, tile, tiles):
                continue
            if kind == BLOCK and _touches(x, y, blocked_radius, tile, marks):
                trial = tiles.copy()
                add_disc(x, y, blocked_radius, BLOCK, tile, trial)
                if not _mark_paths(routes, trial, new_marks):
                    continue
                marks, new_marks = new_marks, marks
            add_disc(x, y, blocked_radius, kind, tile, tiles)
            row = hazards[behind]
            row["kind"], row["share"] = kind, field["share"]
            row["x"], row["y"], row["radius"], row["bounding_radius"] = x, y, radius, radius
            row["first"], row["corners"] = 0, 0
            behind, misses = behind + 1, 0
    for k in range(behind, hazards.shape[0]):
        hazards[k]["kind"] = 0
    return behind
