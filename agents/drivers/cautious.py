"""Safety filter of the driver `navigate`: a command acts only if the UGV can afterwards stop on open tiles.

The proof is in docs/explanation/ground.md. A cautious UGV treats only tiles known to be drivable as open. A bold UGV
treats all tiles as open that it does not know to be blocked, and is never certified. Positions in m, speeds in m/s,
accelerations in m/s².
"""

import math
from typing import NamedTuple

from agents.drivers.navigate_parameters import NavigateParameters
from agents.drivers.planning import is_beside_block
from agents.drivers.tile_map import MAPPED, OccupancyGrid
from sim.compiling.compile import compiled
from sim.models.ground import UNSEEN, TileArray, edge_within, span, tile_index
from sim.models.hazards import BLOCK, ROUGH, TOUCH
from sim.models.kinematics import UgvState, step_ugv
from sim.models.vehicles import norm

_EXIT_RINGS = 16
"""Largest distance of an exit from blocked tiles [tiles], to bound the search."""


class Open(NamedTuple):
    """Kinds of tiles that count as open."""

    unseen: int
    """1 if unseen tiles are open."""
    rough: int
    """1 if rough tiles are open."""
    beside: int
    """1 if tiles beside blocked ones are open."""
    row: int
    column: int
    end_row: int
    end_column: int
    """Range of blocked tiles that count as open, end exclusive, so that a UGV standing on such tiles can leave them.

    It contains tiles blocked by the map of buildings only if the UGV stands on one.
    """
    touch: float
    """Distance below which a tile counts as touched [m]: `TOUCH`, or less to recheck an earlier decision."""


@compiled
def open_to(bold: int) -> Open:
    """Return the open tiles for a UGV on open ground, bold (1) or cautious (0)."""
    return Open(bold, 1, 1, 0, 0, 0, 0, TOUCH)


@compiled
def known_open() -> Open:
    """Return the tiles known to be drivable, with a tolerance for rounding, to recheck an earlier decision."""
    return Open(0, 1, 1, 0, 0, 0, 0, 0.5 * TOUCH)


@compiled
def _is_open(tiles: TileArray, ground: Open, i: int, j: int) -> bool:
    state = tiles[i, j]
    if ground.beside == 0 and is_beside_block(tiles, i, j):
        return False
    if state == UNSEEN:
        return ground.unseen != 0
    if state == ROUGH:
        return ground.rough != 0
    if state == BLOCK:
        return ground.row <= i < ground.end_row and ground.column <= j < ground.end_column
    return True


@compiled
def triangle_is_open(
    tiles: TileArray,
    tile: float,
    ground: Open,
    a: tuple[float, float],
    b: tuple[float, float],
    c: tuple[float, float],
) -> bool:
    """Return whether all tiles touched by a triangle are open; there are none outside the map.

    Args:
        tiles: Occupancy grid. Shape (rows, columns).
        tile: Side of a tile [m].
        ground: Kinds of tiles that are open.
        a, b, c: Corners of the triangle [m]; some may coincide.
    """
    rows, columns = tiles.shape
    touch = ground.touch
    lowest, highest = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
    first, end = span(lowest - touch, highest + touch, tile, rows)
    for i in range(first, end):
        low, high = i * tile - touch, (i + 1) * tile + touch
        left, right = edge_within(a[0], a[1], b[0], b[1], low, high)
        one, other = edge_within(b[0], b[1], c[0], c[1], low, high)
        left, right = min(left, one), max(right, other)
        one, other = edge_within(c[0], c[1], a[0], a[1], low, high)
        left, right = min(left, one), max(right, other)
        if left <= right:
            begin, behind = span(left - touch, right + touch, tile, columns)
            for j in range(begin, behind):
                if not _is_open(tiles, ground, i, j):
                    return False
    return True


@compiled
def segment_is_open(
    tiles: TileArray, tile: float, ground: Open, a: tuple[float, float], b: tuple[float, float]
) -> bool:
    """Return whether all tiles touched by a straight segment are open. Arguments as in `triangle_is_open`."""
    return triangle_is_open(tiles, tile, ground, a, b, b)


@compiled
def open_share(
    tiles: TileArray, tile: float, ground: Open, a: tuple[float, float], b: tuple[float, float]
) -> float:
    """Return the share of a straight segment that is open from its start. Arguments as in `triangle_is_open`."""
    if segment_is_open(tiles, tile, ground, a, b):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(24):
        share = 0.5 * (low + high)
        there = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
        if segment_is_open(tiles, tile, ground, a, there):
            low = share
        else:
            high = share
    return low


@compiled
def braking_distance(speed: float, u_max: float, dt: float) -> float:
    """Return the stopping distance of `brake` in ticks [m]: full ticks at u_max, then one that ends at rest."""
    if math.isinf(u_max):
        return 0.5 * speed * dt
    full = math.floor(speed / (u_max * dt))
    rest = speed - full * (u_max * dt)
    return full * dt * (speed - 0.5 * u_max * dt * full) + 0.5 * rest * dt


@compiled
def slowing_distance(speed: float, slow: float, u_max: float, dt: float) -> float:
    """Return the distance [m] until `brake` ends a tick no faster than `slow` [m/s]; 0 if already as slow."""
    if speed <= slow:
        return 0.0
    if math.isinf(u_max):
        return 0.5 * speed * dt
    full = math.ceil((speed - slow) / (u_max * dt))
    if full * (u_max * dt) >= speed:
        return braking_distance(speed, u_max, dt)
    return full * dt * (speed - 0.5 * u_max * dt * full)


@compiled
def is_safe(
    parameters: NavigateParameters,
    late: bool,
    tiles: TileArray,
    ground: Open,
    own: UgvState,
    u_x: float,
    u_y: float,
) -> bool:
    """Return whether a command keeps the UGV on open tiles in its tick, and while it brakes to rest afterwards.

    Args:
        parameters: Parameters of the driver.
        late: True if commands are delayed: the prediction must then also hold on rough ground.
        tiles: Occupancy grid of the UGV. Shape (rows, columns).
        ground: Kinds of tiles that are open.
        own: State of the UGV when the command takes effect.
        u_x, u_y: Command [m/s²].
    """
    tile, v_max, u_max, dt = (
        parameters.tile,
        parameters.max_speed,
        parameters.max_acceleration,
        parameters.dt,
    )
    a = own.p_x, own.p_y
    x, y, w_x, w_y, _ = step_ugv(parameters.kinematics, own, u_x, u_y, (v_max, u_max), v_max, dt)
    turn = a[0] + 0.5 * own.v_x * dt, a[1] + 0.5 * own.v_y * dt
    speed = norm(w_x, w_y)
    e_x, e_y = (w_x / speed, w_y / speed) if speed > 0.0 else (0.0, 0.0)
    distance = braking_distance(speed, u_max, dt)
    end = x + e_x * distance, y + e_y * distance
    slack = TOUCH - ground.touch
    width, height = parameters.width + slack, parameters.height + slack
    if not (-slack <= x <= width and -slack <= y <= height):
        return False
    if not (-slack <= end[0] <= width and -slack <= end[1] <= height):
        return False
    # the trajectory of the tick lies within the triangle
    if not triangle_is_open(tiles, tile, ground, a, turn, (x, y)):
        return False
    if not segment_is_open(tiles, tile, ground, (x, y), end):
        return False
    slow = parameters.rough_share * v_max + slack  # rough ground never reduces the speed further
    if not late or speed <= slow:
        return True
    distance = slowing_distance(speed, slow, u_max, dt)
    there = x + e_x * distance, y + e_y * distance
    even = Open(
        ground.unseen,
        0,
        1,
        ground.row,
        ground.column,
        ground.end_row,
        ground.end_column,
        ground.touch,
    )
    if not triangle_is_open(tiles, tile, even, a, turn, (x, y)):
        return False
    return segment_is_open(tiles, tile, even, (x, y), there)


class _Range(NamedTuple):
    """Rectangle of tiles, end exclusive."""

    row: int
    column: int
    end_row: int
    end_column: int


@compiled
def _touched(memory: OccupancyGrid, tile: float, x: float, y: float) -> _Range:
    """Return the tiles that a UGV at a point touches."""
    rows, columns = memory.tiles.shape
    row, end_row = span(y - TOUCH, y + TOUCH, tile, rows)
    column, end_column = span(x - TOUCH, x + TOUCH, tile, columns)
    return _Range(row, column, end_row, end_column)


@compiled
def _extended(tiles: _Range, i: int, j: int) -> _Range:
    """Return a range extended to a tile."""
    return _Range(
        min(tiles.row, i),
        min(tiles.column, j),
        max(tiles.end_row, i + 1),
        max(tiles.end_column, j + 1),
    )


@compiled
def _is_mapped(memory: OccupancyGrid, tiles: _Range) -> bool:
    """Return whether the map of buildings has blocked a tile of a range."""
    for i in range(tiles.row, tiles.end_row):
        for j in range(tiles.column, tiles.end_column):
            if memory.measured[i, j] == MAPPED:
                return True
    return False


@compiled
def nearest_open(
    memory: OccupancyGrid, tile: float, bold: int, x: float, y: float
) -> tuple[int, int]:
    """Return row and column of the open tile nearest to a point, on the first square ring that has one.

    Tiles blocked by the map of buildings are no way out, unless the point itself touches one: no report was wrong
    about them.

    Args:
        memory: Occupancy grid of the UGV.
        tile: Side of a tile [m].
        bold: 1 if unseen tiles are open.
        x, y: Point [m].

    Returns:
        The tile of the point itself if no other is open within `_EXIT_RINGS`.
    """
    rows, columns = memory.tiles.shape
    i, j = tile_index(y, tile, rows), tile_index(x, tile, columns)
    touched = _touched(memory, tile, x, y)
    on_map = _is_mapped(memory, touched)
    ground, row, column, least = open_to(bold), i, j, math.inf
    for ring in range(1, min(max(rows, columns), _EXIT_RINGS + 1)):
        for r in range(max(i - ring, 0), min(i + ring + 1, rows)):
            for c in range(max(j - ring, 0), min(j + ring + 1, columns)):
                if max(abs(r - i), abs(c - j)) != ring or not _is_open(memory.tiles, ground, r, c):
                    continue
                away = norm((c + 0.5) * tile - x, (r + 0.5) * tile - y)
                if away < least and (on_map or not _is_mapped(memory, _extended(touched, r, c))):
                    row, column, least = r, c, away
        if least < math.inf:
            break
    return row, column


@compiled
def open_from(memory: OccupancyGrid, tile: float, bold: int, x: float, y: float) -> Open:
    """Return the open tiles for a UGV at a point; on blocked tiles, these and its exit count as open.

    The UGV stands on blocked tiles only if a report was wrong, if it is bold, or if it started or was driven there.
    Arguments as in `nearest_open`.
    """
    touched = _touched(memory, tile, x, y)
    blocked = False
    for i in range(touched.row, touched.end_row):
        for j in range(touched.column, touched.end_column):
            blocked = blocked or memory.tiles[i, j] == BLOCK
    if not blocked:
        return open_to(bold)
    rows, columns = memory.tiles.shape
    if memory.tiles[tile_index(y, tile, rows), tile_index(x, tile, columns)] == BLOCK:
        i, j = nearest_open(memory, tile, bold, x, y)
        touched = _extended(touched, i, j)
    return Open(bold, 1, 1, touched.row, touched.column, touched.end_row, touched.end_column, TOUCH)
