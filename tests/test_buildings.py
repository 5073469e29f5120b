"""Buildings: lines of sight and shadows in cases known by hand, and the coverage of hidden ground.

`test_building_oracle.py` compares random cases with shapely.
"""

import itertools
import math

import numpy as np
import pytest

from bus.registry import SENSORS
from sim.models.buildings import (
    BuildingRow,
    building_distance,
    building_table,
    line_of_sight,
    path_meets_building,
)
from sim.models.field import (
    Demand,
    accumulate,
    accumulate_with_gain,
    coverage_error,
    coverage_gradient,
    empty_coverage,
)
from sim.models.sensor import SensorParameters
from sim.models.shadows import Occlusion, hidden_cells

CELL, R, DESIRED = 0.25, 5.0, 2.0
KINDS = range(len(SENSORS))
HOUSE = ((2.0, 2.0), (4.0, 2.0), (4.0, 4.0), (2.0, 4.0))
YARD = (  # open to the right
    *((2.0, 2.0), (8.0, 2.0), (8.0, 3.0), (3.0, 3.0)),
    *((3.0, 7.0), (8.0, 7.0), (8.0, 8.0), (2.0, 8.0)),
)


def town(seed: int = 3):
    """30 houses in the area of 40 m by 40 m, some of them with a yard, in streets."""
    rng = np.random.default_rng(seed)
    houses = []
    for k in range(30):
        x, y = 1.0 + 8.0 * (k % 5), 0.7 + 6.6 * (k // 5)
        shape = np.array(YARD if k % 4 == 0 else HOUSE) - 2.0
        size = rng.uniform(4.0, 6.0, 2) / shape.max(axis=0)
        corners = [tuple(corner) for corner in shape * size + (x, y)]
        houses.append((corners, rng.uniform(3.0, 8.0)))
    return houses


def occlusion(buildings, z: float) -> Occlusion:
    return Occlusion(*building_table(buildings), z)


def centers(cell: float, rows: int, columns: int):
    return np.meshgrid((np.arange(columns) + 0.5) * cell, (np.arange(rows) + 0.5) * cell)


# Tables


def test_row_holds_the_footprint_in_a_circle() -> None:
    rows, corners = building_table([(HOUSE, 3.0), (YARD[::-1], 5.0)])
    assert rows.dtype.names == BuildingRow._fields
    for row, height, wanted in zip(rows, (3.0, 5.0), (HOUSE, YARD), strict=True):
        part = corners[row["first"] : row["first"] + row["corners"]]
        assert row["height"] == height
        assert {tuple(corner) for corner in part.tolist()} == set(wanted)
        away = np.hypot(part[:, 0] - row["x"], part[:, 1] - row["y"])
        assert away.max() <= row["reach"] <= away.max() + 1e-6


@pytest.mark.parametrize(
    ("corners", "height", "message"),
    [
        ((), 3.0, "no area"),
        (((0.0, 0.0), (1.0, 1.0), (2.0, 2.0)), 3.0, "no area"),
        (HOUSE, 0.0, "height = 0.0"),
        (HOUSE, math.inf, "height = inf"),
        (HOUSE, math.nan, "height = nan"),
    ],
)
def test_building_without_volume_raises(corners, height, message) -> None:
    with pytest.raises(ValueError, match=rf"buildings\[1\].*{message}"):
        building_table([(HOUSE, 3.0), (corners, height)])


def test_no_buildings_hide_and_stop_nothing() -> None:
    tables = building_table([])
    assert line_of_sight(*tables, 0.0, 0.0, 5.0, 9.0, 9.0, 0.0)
    assert building_distance(*tables, 1.0, 1.0, 0.0) == math.inf
    assert path_meets_building(*tables, (0.0, 0.0), (9.0, 9.0), 0.0) == math.inf
    assert not hidden_cells(Occlusion(*tables, 5.0), 5.0, 5.0, R, CELL, (40, 40)).any()


# Lines of sight, distances and paths


@pytest.mark.parametrize(
    ("camera", "point", "seen"),
    [
        ((0.0, 3.0, 10.0), (6.0, 3.0, 0.0), True),  # 3.33 m high where it leaves the house
        ((0.0, 3.0, 8.0), (6.0, 3.0, 0.0), False),  # 2.67 m high there
        ((0.0, 3.0, 8.0), (6.0, 3.0, 1.0), True),  # 3.33 m high there
        ((0.0, 3.0, 3.0), (6.0, 3.0, 0.0), False),  # as high as the roof
        ((0.0, 3.0, 2.0), (6.0, 3.0, 1.0), False),  # lower than the roof
        ((0.0, 3.0, 2.0), (1.9, 3.0, 0.0), True),  # in front of it
        ((0.0, 3.0, 2.0), (2.0, 3.0, 0.0), False),  # on its wall
        ((0.0, 4.0, 2.0), (6.0, 4.0, 0.0), False),  # along its wall
        ((0.0, 4.1, 2.0), (6.0, 4.1, 0.0), True),  # beside it
        ((3.0, 3.0, 9.0), (3.0, 3.0, 2.9), False),  # below its roof
        ((3.0, 3.0, 9.0), (3.0, 3.0, 3.0), True),  # on its roof
        ((3.0, 3.0, 9.0), (0.0, 3.0, 0.0), True),  # beyond its wall, from above the roof
        ((3.0, 3.0, 9.0), (1.6, 3.0, 0.0), False),
        ((0.0, 0.0, 2.0), (1.0, 5.0, 4.0 - 2.5), True),
    ],
)
def test_line_of_sight_by_hand(camera, point, seen) -> None:
    assert line_of_sight(*building_table([(HOUSE, 3.0)]), *camera, *point) == seen


def test_a_low_building_does_not_hide_the_high_one_behind() -> None:
    tables = building_table([(HOUSE, 3.0), ([(6.0, 2.0), (7.0, 2.0), (7.0, 4.0)], 9.0)])
    assert line_of_sight(*tables, 0.0, 3.0, 8.0, 5.5, 3.0, 1.5)
    assert not line_of_sight(*tables, 0.0, 3.0, 8.0, 7.5, 3.0, 1.5)


def test_distance_counts_higher_buildings_only() -> None:
    tables = building_table([(HOUSE, 3.0), (YARD, 5.0)])
    assert building_distance(*tables, 1.0, 1.0, 2.0) == pytest.approx(math.sqrt(2.0))
    assert building_distance(*tables, 5.0, 5.0, 2.0) == pytest.approx(math.sqrt(2.0))
    assert building_distance(*tables, 5.0, 5.0, 3.0) == 2.0  # to the wall of the yard
    assert building_distance(*tables, 3.0, 3.0, 3.0) == 0.0
    assert building_distance(*tables, 5.0, 5.0, 5.0) == math.inf


def test_path_meets_higher_buildings_only() -> None:
    tables = building_table([(HOUSE, 3.0), (YARD, 5.0)])
    assert path_meets_building(*tables, (6.0, 5.0), (1.0, 5.0), 3.0) == pytest.approx(0.6)
    assert path_meets_building(*tables, (6.0, 3.5), (1.0, 3.5), 2.0) == pytest.approx(0.4)
    assert path_meets_building(*tables, (2.5, 5.0), (2.6, 5.0), 3.0) == 0.0
    assert path_meets_building(*tables, (6.0, 5.0), (4.0, 5.0), 2.0) == math.inf
    assert path_meets_building(*tables, (6.0, 5.0), (1.0, 5.0), 5.0) == math.inf


# Shadows


def test_shadow_from_above_a_corner_is_the_scaled_footprint() -> None:
    """F = 10 / (10 - 5) = 2; all walls and their shadows run through centers of cells, and are hidden."""
    corners = [(2.5, 2.5), (4.5, 2.5), (4.5, 4.5), (2.5, 4.5)]
    x, y = centers(1.0, 9, 9)
    wanted = (x >= 2.5) & (x <= 6.5) & (y >= 2.5) & (y <= 6.5)
    for turned in (corners, corners[::-1], corners[1:] + corners[:1]):
        found = hidden_cells(occlusion([(turned, 5.0)], 10.0), 2.5, 2.5, 9.0, 1.0, (9, 9))
        np.testing.assert_array_equal(found, wanted)


def test_shadow_of_walls_in_line_with_the_camera() -> None:
    """The camera is lower than the roof, and on the line of the lower wall."""
    corners = [(3.5, 1.5), (5.5, 1.5), (5.5, 3.5), (3.5, 3.5)]
    x, y = centers(1.0, 12, 12)
    wanted = (x >= 3.5) & (y >= 1.5) & (y - 1.5 <= x - 1.5)
    found = hidden_cells(occlusion([(corners, 5.0)], 4.0), 1.5, 1.5, 30.0, 1.0, (12, 12))
    np.testing.assert_array_equal(found, wanted)


def test_shadow_of_a_yard_leaves_its_ground_visible() -> None:
    """F = 2 about a camera in the yard: the walls hide nothing on their inner sides."""
    x, y = centers(CELL, 48, 48)
    found = hidden_cells(occlusion([(YARD, 5.0)], 10.0), 5.0, 5.0, 20.0, CELL, (48, 48))
    yard = (x > 3.0) & (y > 3.0) & (y < 7.0)
    assert not found[yard].any()
    assert found[(x > 2.0) & (x < 3.0) & (y > 2.0) & (y < 8.0)].all()
    scaled = (x > -1.0) & (x < 8.0) & (y > -1.0) & (y < 11.0)
    np.testing.assert_array_equal(found & (x < 8.0), ~yard & scaled)


def test_lower_camera_sees_less() -> None:
    shadows = [
        hidden_cells(occlusion(town(), z), 16.2, 13.0, 9.0, CELL, (160, 160))
        for z in (40.0, 12.0, 8.1, 8.0, 5.0, 0.5)
    ]
    for higher, lower in itertools.pairwise(shadows):
        assert (lower | ~higher).all()
    assert shadows[0].sum() < shadows[1].sum() < shadows[-1].sum()


def test_shadow_is_the_union_of_the_shadows_of_each() -> None:
    buildings, place = town(), (18.3, 20.1)
    together = hidden_cells(occlusion(buildings, 9.0), *place, R, CELL, (160, 160))
    alone = [hidden_cells(occlusion([one], 9.0), *place, R, CELL, (160, 160)) for one in buildings]
    assert together.any()
    np.testing.assert_array_equal(together, np.any(alone, axis=0))


@pytest.mark.parametrize("shape", [(160, 160), (1, 160), (160, 1), (17, 5), (3, 90)])
@pytest.mark.parametrize("place", [(0.0, 0.0), (4.1, -2.2), (-2.0, 4.3), (39.9, 41.0), (3.3, 7.0)])
def test_shadow_at_the_edge_of_the_area_is_that_of_a_larger_one(shape, place) -> None:
    blocks = occlusion([*town(), ([(-3.0, -1.0), (-0.5, -2.0), (0.2, 0.3)], 4.0)], 6.0)
    whole = hidden_cells(blocks, *place, R, CELL, (200, 200))
    part = hidden_cells(blocks, *place, R, CELL, shape)
    np.testing.assert_array_equal(part, whole[: shape[0], : shape[1]])


# Coverage


def sights(seed: int):
    """Partly covered ground, the position of a camera, and what buildings hide from it."""
    rng = np.random.default_rng(seed)
    for _ in range(20):
        ground = rng.uniform(0.0, 1.5 * DESIRED, (160, 160))
        p_x, p_y = rng.uniform(-1.0, 41.0, 2)
        blocks = occlusion(town(), rng.uniform(8.5, 15.0))
        yield ground, p_x, p_y, blocks, hidden_cells(blocks, p_x, p_y, R, CELL, ground.shape)


@pytest.mark.parametrize("kind", KINDS, ids=SENSORS.keys())
def test_hidden_cells_gain_no_coverage(kind: int) -> None:
    sensor, hidden_ones = SensorParameters(kind, 1.0, R), 0
    for ground, p_x, p_y, blocks, hidden in sights(1):
        plain, found = ground.copy(), ground.copy()
        accumulate(plain, p_x, p_y, sensor, CELL, 0.05)
        accumulate(found, p_x, p_y, sensor, CELL, 0.05, blocks)
        assert found.tobytes() == np.where(hidden, ground, plain).tobytes()
        hidden_ones += hidden.sum()
    assert hidden_ones > 1000


@pytest.mark.parametrize("kind", KINDS, ids=SENSORS.keys())
def test_gain_is_the_fall_of_the_error_on_visible_ground(kind: int) -> None:
    sensor = SensorParameters(kind, 1.0, R)
    for ground, p_x, p_y, blocks, _ in sights(2):
        demand, plain, found = (
            Demand(p_x + 1.5, p_y - 1.0, 9.75, DESIRED),
            ground.copy(),
            ground.copy(),
        )
        accumulate(plain, p_x, p_y, sensor, CELL, 0.05, blocks)
        gain = accumulate_with_gain(found, p_x, p_y, demand, sensor, CELL, 0.05, blocks)
        assert found.tobytes() == plain.tobytes()
        before, after = (coverage_error(grid, *demand, CELL) for grid in (ground, found))
        assert gain == pytest.approx(before - after, rel=1e-6)


@pytest.mark.parametrize("kind", KINDS, ids=SENSORS.keys())
def test_gradient_ignores_hidden_cells(kind: int) -> None:
    """Hidden ground pulls as little as covered ground."""
    sensor = SensorParameters(kind, 1.0, R)
    for ground, p_x, p_y, blocks, hidden in sights(3):
        rest = (p_x, p_y, p_x + 1.5, p_y - 1.0, 9.75, DESIRED, sensor, CELL)
        covered = np.where(hidden, DESIRED, ground)
        found = coverage_gradient(ground, *rest, blocks)
        assert found == coverage_gradient(covered, *rest)
        if hidden.any():
            assert found != coverage_gradient(ground, *rest)


@pytest.mark.parametrize("buildings", [[], [(np.array(HOUSE) + 50.0, 8.0)]], ids=["none", "far"])
def test_coverage_without_a_building_in_reach_keeps_its_bits(buildings) -> None:
    sensor, blocks = SensorParameters(0, 1.0, R), occlusion(buildings, 9.0)
    for ground, p_x, p_y, _, _ in sights(4):
        demand = Demand(p_x + 1.5, p_y - 1.0, 9.75, DESIRED)
        results = []
        for last in ((), (None,), (blocks,)):
            grids = ground.copy(), ground.copy()
            accumulate(grids[0], p_x, p_y, sensor, CELL, 0.05, *last)
            gain = accumulate_with_gain(grids[1], p_x, p_y, demand, sensor, CELL, 0.05, *last)
            pull = coverage_gradient(ground, p_x, p_y, *demand, sensor, CELL, *last)
            results.append(
                (grids[0].tobytes(), grids[1].tobytes(), np.array([gain, *pull]).tobytes())
            )
        assert results[0] == results[1] == results[2]


def test_ground_behind_a_wall_draws_no_uav() -> None:
    """Only the ground to the right lacks coverage, and a wall hides it from a camera that is lower."""
    ground = empty_coverage(40.0, 40.0, CELL)
    ground[:, :84] = DESIRED
    wall = [(20.5, 0.0), (20.75, 0.0), (20.75, 40.0), (20.5, 40.0)]
    rest = (20.0, 20.0, 20.0, 20.0, 9.75, DESIRED, SensorParameters(0, 1.0, R), CELL)
    assert coverage_gradient(ground, *rest, occlusion([(wall, 8.0)], 6.0)) == (0.0, 0.0, 0.0)
    assert coverage_gradient(ground, *rest, occlusion([(wall, 0.1)], 6.0))[0] > 0.0
