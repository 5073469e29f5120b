"""Prisms over polygons as triangles, for viewers of three dimensions."""

from collections.abc import Sequence

from bus.messages.buildings import Building
from sim.scene.model import Point

Corner = tuple[float, float, float]
"""x, y and z [m]."""


def _turn(a: Point, b: Point, c: Point) -> float:
    """Return twice the area of a triangle; positive if it is counterclockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _counterclockwise(corners: Sequence[Point]) -> list[Point]:
    area = sum(_turn(corners[0], corners[k - 1], corners[k]) for k in range(2, len(corners)))
    return list(corners if area > 0.0 else reversed(corners))


def _contains(a: Point, b: Point, c: Point, point: Point) -> bool:
    return min(_turn(a, b, point), _turn(b, c, point), _turn(c, a, point)) >= 0.0


def triangulated(corners: Sequence[Point]) -> list[tuple[Point, Point, Point]]:
    """Return the triangles of a simple polygon, counterclockwise, by clipping its ears."""
    left = _counterclockwise(corners)
    found = []
    while len(left) > 2:
        count = len(left)
        for k in range(count):
            a, b, c = left[k - 1], left[k], left[(k + 1) % count]
            others = (point for point in left if point not in (a, b, c))
            if _turn(a, b, c) > 0.0 and not any(_contains(a, b, c, point) for point in others):
                break
        else:  # corners on a line are left over
            break
        found.append((a, b, c))
        del left[k]
    return found


def prism(building: Building) -> list[Corner]:
    """Return a building as triangles, three corners each, counterclockwise from outside: its walls, then its roof."""
    roof = triangulated(building.corners)
    corners, height = _counterclockwise(building.corners), building.height
    points: list[Corner] = []
    for k, b in enumerate(corners):
        (a_x, a_y), (b_x, b_y) = corners[k - 1], b
        low_a, low_b = (a_x, a_y, 0.0), (b_x, b_y, 0.0)
        high_a, high_b = (a_x, a_y, height), (b_x, b_y, height)
        points += (low_a, low_b, high_b, low_a, high_b, high_a)
    points += [(x, y, height) for triangle in roof for x, y in triangle]
    return points
