"""Lines of sight, shadows, distances and paths among random buildings, against shapely."""

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
from sim.models.shadows import Occlusion, hidden_cells

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
        occlusion = Occlusion(*town.tables(), town.z)
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
