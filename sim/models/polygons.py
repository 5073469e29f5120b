"""Geometry of polygons. For contact they are closed sets: a point on an edge touches the polygon.

For sight they are open: only points inside hide something, see `passes_inside` and `lies_inside`.

All functions read a polygon from a table of corners [m], shape (corners, 2): `count` rows from `first` on, in the order
in which the edges join them. The polygon is simple, convex or not, in either orientation.
"""

import math

from sim.compiling.compile import FloatArray, compiled

ON_EDGE = 1e-9
"""Distance from an edge up to which a point is on it for sight [m].

It exceeds the rounding error in areas of up to 10 km.
"""


@compiled
def segment_distance2(a_x: float, a_y: float, b_x: float, b_y: float, x: float, y: float) -> float:
    """Return the squared distance of (x, y) from the segment from a to b [m²]."""
    d_x, d_y, e_x, e_y = b_x - a_x, b_y - a_y, x - a_x, y - a_y
    along, length2 = e_x * d_x + e_y * d_y, d_x * d_x + d_y * d_y
    if along > 0.0:
        share = 1.0 if along >= length2 else along / length2
        e_x, e_y = e_x - share * d_x, e_y - share * d_y
    return e_x * e_x + e_y * e_y


@compiled
def _met(
    p_x: float, p_y: float, d_x: float, d_y: float, a_x: float, a_y: float, b_x: float, b_y: float
) -> float:
    """Return the share of the path from p by d at which it meets the segment a to b; infinite: never, or parallel."""
    e_x, e_y = b_x - a_x, b_y - a_y
    turn = d_x * e_y - d_y * e_x
    if turn == 0.0:
        return math.inf
    share = ((a_x - p_x) * e_y - (a_y - p_y) * e_x) / turn
    along = ((a_x - p_x) * d_y - (a_y - p_y) * d_x) / turn
    return share if 0.0 <= share <= 1.0 and 0.0 <= along <= 1.0 else math.inf


@compiled
def _place(corners: FloatArray, first: int, count: int, x: float, y: float) -> tuple[bool, float]:
    """Return whether a point is inside a polygon, at random on an edge, and its distance from the edges [m]."""
    end = first + count
    inside, nearest = False, math.inf
    a_x, a_y = corners[end - 1, 0], corners[end - 1, 1]
    for n in range(first, end):
        b_x, b_y = corners[n, 0], corners[n, 1]
        nearest = min(nearest, segment_distance2(a_x, a_y, b_x, b_y, x, y))
        if (a_y > y) != (b_y > y) and x < a_x + (b_x - a_x) * (y - a_y) / (b_y - a_y):
            inside = not inside
        a_x, a_y = b_x, b_y
    return inside, math.sqrt(nearest)


@compiled
def distance_to_polygon(corners: FloatArray, first: int, count: int, x: float, y: float) -> float:
    """Return the distance of a point from a polygon [m]; 0 inside and on an edge.

    Args:
        corners, first, count: The polygon.
        x, y: The point [m].
    """
    inside, edge = _place(corners, first, count, x, y)
    return 0.0 if inside else edge


@compiled
def lies_inside(corners: FloatArray, first: int, count: int, x: float, y: float) -> bool:
    """Return whether a point is inside a polygon and not on an edge. Arguments as in `distance_to_polygon`."""
    inside, edge = _place(corners, first, count, x, y)
    return inside and edge > ON_EDGE


@compiled
def passes_inside(
    corners: FloatArray,
    first: int,
    count: int,
    start: tuple[float, float],
    direction: tuple[float, float],
    part: tuple[float, float],
    side: int,
) -> bool:
    """Return whether a part of a line is inside a polygon somewhere if the line is shifted sideways by next to nothing.

    A line along an edge, or through a corner, is inside on one of its sides only.

    Args:
        corners, first, count: The polygon.
        start: Point of the line [m].
        direction: Vector along the line [m]; not zero.
        part: Shares of the direction vector at which the part begins and ends.
        side: Side to which the line is shifted: 1: left, -1: right.
    """
    (d_x, d_y), (begin, end) = direction, part
    last, inside = first + count - 1, False
    a_x, a_y = corners[last, 0] - start[0], corners[last, 1] - start[1]
    a_turn = d_x * a_y - d_y * a_x
    a_left = a_turn > 0.0 or (a_turn == 0.0 and side < 0)
    for n in range(first, last + 1):
        b_x, b_y = corners[n, 0] - start[0], corners[n, 1] - start[1]
        b_turn = d_x * b_y - d_y * b_x
        b_left = b_turn > 0.0 or (b_turn == 0.0 and side < 0)
        if a_left != b_left:
            t = a_turn / (a_turn - b_turn)
            c_x, c_y = a_x + t * (b_x - a_x), a_y + t * (b_y - a_y)
            share = (c_x * d_x + c_y * d_y) / (d_x * d_x + d_y * d_y)
            if begin < share < end:
                return True
            if share <= begin:
                inside = not inside
        a_x, a_y, a_turn, a_left = b_x, b_y, b_turn, b_left
    return inside


@compiled
def share_to_edges(
    corners: FloatArray,
    first: int,
    count: int,
    start: tuple[float, float],
    end: tuple[float, float],
) -> float:
    """Return the share of the segment from start to end at which it first meets an edge that is not parallel.

    A segment inside a polygon, or inside one of its edges, meets none: check an end with `distance_to_polygon`.

    Args:
        corners, first, count: The polygon.
        start, end: Points [m].

    Returns:
        0: at its start, to 1: at its end; infinite: never.
    """
    p_x, p_y = start
    d_x, d_y = end[0] - p_x, end[1] - p_y
    last, nearest = first + count - 1, math.inf
    a_x, a_y = corners[last, 0], corners[last, 1]
    for n in range(first, last + 1):
        b_x, b_y = corners[n, 0], corners[n, 1]
        nearest = min(nearest, _met(p_x, p_y, d_x, d_y, a_x, a_y, b_x, b_y))
        a_x, a_y = b_x, b_y
    return nearest


@compiled
def share_to_polygon(
    corners: FloatArray,
    first: int,
    count: int,
    start: tuple[float, float],
    end: tuple[float, float],
) -> float:
    """Return the share of the segment from start to end at which it first touches a polygon; infinite: never.

    Arguments as in `share_to_edges`.
    """
    if distance_to_polygon(corners, first, count, start[0], start[1]) == 0.0:
        return 0.0
    # rounding may hide a corner that the segment enters through
    inside = distance_to_polygon(corners, first, count, end[0], end[1]) == 0.0
    return min(1.0 if inside else math.inf, share_to_edges(corners, first, count, start, end))


@compiled
def path_distance(
    corners: FloatArray,
    first: int,
    count: int,
    start: tuple[float, float],
    end: tuple[float, float],
) -> float:
    """Return the distance of the segment from start to end from a polygon [m]; 0 if they touch.

    Arguments as in `share_to_edges`.
    """
    if share_to_polygon(corners, first, count, start, end) < math.inf:
        return 0.0
    nearest = min(
        distance_to_polygon(corners, first, count, start[0], start[1]),
        distance_to_polygon(corners, first, count, end[0], end[1]),
    )
    for n in range(first, first + count):
        x, y = corners[n, 0], corners[n, 1]
        away = segment_distance2(start[0], start[1], end[0], end[1], x, y)
        nearest = min(nearest, math.sqrt(away))
    return nearest
