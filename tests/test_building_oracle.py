"""Lines of sight, shadows, distances and paths among random buildings, against shapely.

Buildings in general position are compared except next to their edges; buildings on a grid exactly there.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from sim.models.buildings import (
    building_distance,
    building_table,
    line_of_sight,
    path_meets_building,
)
from sim.models.shadows import all_known, hidden_cells

shapely = pytest.importorskip("shapely", reason="a development tool")

EDGE = 1e-9
"""A result this close to a boundary is not compared [m]."""
Array = npt.NDArray[np.float64]


def convex(rng: np.random.Generator) -> Array:
    """Corners on an ellipse."""
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 9)))
    return np.stack([np.cos(angles), np.sin(angles)], 1) * rng.uniform(0.3, 4.0, 2)


def star(rng: np.random.Generator) -> Array:
    """Corners all around a point of it, near and far."""
    count = rng.integers(3, 10)
    angles = 2.0 * np.pi * (np.arange(count) + rng.uniform(0.0, 0.9, count)) / count
    return np.stack([np.cos(angles), np.sin(angles)], 1) * rng.uniform(0.3, 4.0, (count, 1))


def wings(rng: np.random.Generator) -> Array:
    """Rectangles at right angles, joined: the letters L, T and U, courtyards with a gate, and others."""
    while True:
        low = rng.integers(-4, 3, (4, 2))
        boxes = shapely.box(*low.T, *(low + rng.integers(1, 6, (4, 2))).T)
        joined = shapely.union_all(boxes)
        if joined.geom_type == "Polygon" and not joined.interiors:
            return shapely.get_coordinates(joined)[:-1] * rng.uniform(0.4, 0.8)


def footprint(rng: np.random.Generator) -> Array:
    """One of them, turned and moved, in either orientation."""
    shape = (convex, star, wings)[rng.integers(3)](rng)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    corners = shape @ turn + rng.uniform(0.0, 12.0, 2)
    return corners[:: rng.choice((-1, 1))]


@dataclass(frozen=True)
class Town:
    """Buildings, and a camera that is in none of them."""

    polygons: npt.NDArray[np.object_]
    heights: Array
    camera: Array
    z: float

    def tables(self) -> tuple[np.ndarray, Array]:
        footprints = [shapely.get_coordinates(polygon)[:-1] for polygon in self.polygons]
        return building_table(list(zip(footprints, self.heights, strict=True)))

    def grown(self, margin: float) -> "Town":
        """With buildings that are larger by the margin on all sides."""
        polygons = shapely.buffer(self.polygons, margin, join_style="mitre")
        return Town(polygons, self.heights + margin, self.camera, self.z)


def random_town(rng: np.random.Generator) -> Town:
    count = rng.integers(1, 4)
    polygons = np.array([shapely.Polygon(footprint(rng)) for _ in range(count)])
    heights = rng.uniform(0.5, 12.0, count)
    while True:
        camera, z = rng.uniform(-1.0, 13.0, 2), rng.uniform(0.3, 15.0)
        near = shapely.dwithin(shapely.Point(camera), polygons, 1e-6)
        if not (near & (heights > z - 1e-6)).any():
            return Town(polygons, heights, camera, z)


def hides(town: Town, points: Array, h: Array) -> npt.NDArray[np.bool_]:
    """Whether each ray from a point to the camera is in a building and not above its roof there."""
    hidden = np.zeros(len(points), dtype=bool)
    rays = shapely.linestrings(
        np.stack([points, np.broadcast_to(town.camera, points.shape)], axis=1)
    )
    for polygon, height in zip(town.polygons, town.heights, strict=True):
        shapely.prepare(polygon)
        met = np.flatnonzero(shapely.intersects(polygon, rays))
        pieces = shapely.intersection(rays[met], polygon)
        ends, of = shapely.get_coordinates(pieces, return_index=True)
        away = np.full(len(met), math.inf)
        np.minimum.at(away, of, np.hypot(*(ends - points[met][of]).T))
        ray_height = h[met] + (town.z - h[met]) * away / shapely.length(rays[met])
        hidden[met] |= (ray_height <= height) & (h[met] < height)
    return hidden


def compared(town: Town, points: Array, h: Array) -> tuple[npt.NDArray, npt.NDArray]:
    """Whether each point is hidden, and whether that is sure: not within `EDGE` of a boundary."""
    least, most = (hides(town.grown(margin), points, h) for margin in (-EDGE, EDGE))
    return least, least == most


def test_line_of_sight_is_a_ray_clear_of_all_prisms() -> None:
    rng, counts = np.random.default_rng(5), np.zeros(3, dtype=int)
    for _ in range(1000):
        town, count = random_town(rng), 100
        tables = town.tables()
        points = rng.uniform(-1.0, 13.0, (count, 2))
        h = rng.uniform(0.0, min(town.z, 4.0), count) * (rng.random(count) < 0.7)
        hidden, sure = compared(town, points, h)
        found = np.array(
            [
                not line_of_sight(*tables, *town.camera, town.z, *point, height)
                for point, height in zip(points, h, strict=True)
            ]
        )
        np.testing.assert_array_equal(found[sure], hidden[sure])
        counts += count, sure.sum(), hidden.sum()
    total, sure_ones, hidden_ones = counts
    assert total == 100_000
    assert sure_ones > 0.9999 * total
    assert 0.2 * total < hidden_ones < 0.8 * total


def test_hidden_cells_are_those_without_a_line_of_sight() -> None:
    rng, counts = np.random.default_rng(6), np.zeros(3, dtype=int)
    for _ in range(2000):
        town, cell = random_town(rng), rng.choice((0.1, 0.25, 0.37, 1.0))
        radius, rows, columns = rng.uniform(0.3, 18.0 * cell), *rng.integers(1, 60, 2)
        occlusion = all_known(*town.tables(), town.z)
        cells = hidden_cells(occlusion, *town.camera, radius, cell, (rows, columns))
        x, y = np.meshgrid((np.arange(columns) + 0.5) * cell, (np.arange(rows) + 0.5) * cell)
        away = np.hypot(x - town.camera[0], y - town.camera[1])
        assert not cells[away > radius + EDGE].any()
        inside = away < radius - EDGE
        points = np.stack([x[inside], y[inside]], axis=1)
        hidden, sure = compared(town, points, np.zeros(len(points)))
        np.testing.assert_array_equal(cells[inside][sure], hidden[sure])
        counts += len(points), sure.sum(), hidden.sum()
    total, sure_ones, hidden_ones = counts
    assert sure_ones > 0.999 * total > 100_000
    assert 0.1 * total < hidden_ones < 0.9 * total


def rectangles(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Corners on the grid of half a metre: many touch, or overlap; and heights whose shadows end on a fine grid."""
    low = rng.integers(2, 12, (count, 2)) / 2.0
    size = rng.integers(1, 8, (count, 2)) / 2.0
    return np.concatenate([low, low + size], axis=1), rng.choice((4.0, 8.0, 12.0), count)


def on_grid(rng: np.random.Generator, boxes: Array, heights: Array) -> tuple[Array, float]:
    """Camera on the grid, at 8 m or 16 m, that is in no building."""
    while True:
        camera, z = rng.integers(0, 20, 2) / 2.0, rng.choice((8.0, 16.0))
        inside = (boxes[:, :2] <= camera).all(1) & (camera <= boxes[:, 2:]).all(1)
        if not (inside & (heights >= z)).any():
            return camera, float(z)


def table(boxes: Array, heights: Array) -> tuple[np.ndarray, Array]:
    corners = [shapely.get_coordinates(shapely.box(*box))[:-1] for box in boxes]
    return building_table(list(zip(corners, heights, strict=True)))


def test_a_wall_hides_a_point_only_if_the_ray_enters_its_inside() -> None:
    rng, on_wall, seen = np.random.default_rng(9), 0, 0
    for _ in range(300):
        boxes, heights = rectangles(rng, 1)
        camera, z = on_grid(rng, boxes, heights)
        building, height = shapely.box(*boxes[0]), heights[0]
        share = 1.0 if height >= z else height / z
        for point in rng.integers(0, 20, (20, 2)) / 2.0:
            end = point + share * (camera - point)
            ray = shapely.LineString([point, end]) if (point != camera).any() else None
            hidden = (
                building.contains(shapely.Point(point))
                if ray is None
                else shapely.relate_pattern(ray, building, "T********")
            )
            assert line_of_sight(*table(boxes, heights), *camera, z, *point, 0.0) != hidden
            touches = building.boundary.intersects(shapely.Point(point))
            on_wall, seen = on_wall + touches, seen + (touches and not hidden)
    assert 0.2 * on_wall < seen < on_wall > 200


def hidden_around(boxes: Array, heights: Array, camera: Array, z: float, point: Array) -> bool:
    """Whether the points around a point of the grid are all in the shadow of some building."""
    direction = np.arctan2(*(camera - point)[::-1])
    angles = np.concatenate([direction + np.arange(4) * np.pi / 2.0, np.arange(4) * np.pi / 2.0])
    angles = (angles[:, None] + (-1e-3, 1e-3)).ravel()
    around = point + 1e-6 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    hidden = np.zeros(len(around), dtype=bool)
    for box, height in zip(boxes, heights, strict=True):
        corners = shapely.get_coordinates(shapely.box(*box))
        factor = z / (z - height) if height < z else 2.0**30
        both = np.concatenate([corners, camera + factor * (corners - camera)])
        hidden |= shapely.contains_xy(shapely.MultiPoint(both).convex_hull, around)
    return bool(hidden.all())


def test_touching_buildings_hide_what_is_hidden_all_around() -> None:
    """Points on walls and corners, between buildings that share a wall, on the edges of shadows; as cells too."""
    rng, counts = np.random.default_rng(10), np.zeros(2, dtype=int)
    for _ in range(300):
        boxes, heights = rectangles(rng, rng.integers(1, 5))
        camera, z = on_grid(rng, boxes, heights)
        tables = table(boxes, heights)
        cells = hidden_cells(all_known(*tables, z), *camera, 30.0, 1.0, (10, 10))
        for row, column in rng.integers(0, 10, (15, 2)):
            point = np.array((column + 0.5, row + 0.5))
            hidden = hidden_around(boxes, heights, camera, z, point)
            assert line_of_sight(*tables, *camera, z, *point, 0.0) != hidden
            assert cells[row, column] == hidden
            counts += 1, hidden
    assert 0.2 * counts[0] < counts[1] < 0.8 * counts[0]


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.0, 2.5])
def test_rounding_hides_no_point_on_a_wall(turn: float) -> None:
    """The UGV of a run stops where it meets a wall, give or take a rounding error."""
    rng = np.random.default_rng(11)
    rotate = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    wall = np.array([(5.0, 7.0), (15.0, 7.0), (15.0, 9.0), (5.0, 9.0)]) @ rotate + 100.0
    tables = building_table([(wall, 10.0)])
    for share, x, depth in rng.uniform((0.0, -5.0, 0.01), (1.0, 25.0, 7.0), (1000, 3)):
        point = wall[0] + share * (wall[1] - wall[0])
        camera = np.array((x, 7.0 - depth)) @ rotate + 100.0
        assert line_of_sight(*tables, *camera, 14.0, *point, 0.0)
        beyond = np.array((x, 9.0 + depth)) @ rotate + 100.0
        assert not line_of_sight(*tables, *beyond, 14.0, *point, 0.0)


def test_building_distance_is_that_to_the_nearest_high_one() -> None:
    rng = np.random.default_rng(7)
    for _ in range(500):
        town, lowest = random_town(rng), rng.uniform(0.0, 12.0)
        high = town.polygons[town.heights > lowest]
        points = rng.uniform(-3.0, 15.0, (20, 2))
        found = [building_distance(*town.tables(), *point, lowest) for point in points]
        wanted = [
            shapely.distance(shapely.Point(point), high).min(initial=math.inf) for point in points
        ]
        np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_path_meets_a_high_building_where_it_first_touches() -> None:
    rng, met = np.random.default_rng(8), 0
    for _ in range(500):
        town, lowest = random_town(rng), rng.uniform(0.0, 12.0)
        high = shapely.union_all(town.polygons[town.heights > lowest])
        for start, end in rng.uniform(-1.0, 13.0, (20, 2, 2)):
            found = path_meets_building(*town.tables(), tuple(start), tuple(end), lowest)
            path = shapely.LineString([start, end])
            touched = shapely.intersection(path, high)
            if touched.is_empty:
                assert found == math.inf
                continue
            met += 1
            wanted = shapely.distance(shapely.Point(start), touched) / path.length
            assert found == pytest.approx(wanted, abs=1e-9)
    assert met > 1000
