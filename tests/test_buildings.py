"""Buildings: lines of sight and shadows in cases known by hand, and the coverage of hidden ground.

`test_building_oracle.py` compares random cases with shapely.
"""

import math

import numpy as np
import pytest

from bus.registry import SENSORS
from sim.models.buildings import (
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
)
from sim.models.sensor import SensorParameters
from sim.models.shadows import Occlusion, all_known, hidden_cells

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
    return all_known(*building_table(buildings), z)


def centers(cell: float, rows: int, columns: int):
    return np.meshgrid((np.arange(columns) + 0.5) * cell, (np.arange(rows) + 0.5) * cell)


# Tables


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


@pytest.mark.parametrize("buildings", [[], [(HOUSE, 3.0)]], ids=["none", "as low"])
def test_buildings_that_are_not_higher_stop_nothing(buildings) -> None:
    tables = building_table(buildings)
    assert building_distance(*tables, 3.0, 3.0, 3.0) == math.inf
    assert path_meets_building(*tables, (0.0, 0.0), (9.0, 9.0), 3.0) == math.inf
    assert line_of_sight(*tables, 0.0, 0.0, 5.0, 9.0, 9.0, 3.0)
    assert not hidden_cells(all_known(*building_table([]), 5.0), 5.0, 5.0, R, CELL, (40, 40)).any()


# Lines of sight


@pytest.mark.parametrize(
    ("camera", "point", "seen"),
    [
        ((0.0, 3.0, 10.0), (6.0, 3.0, 0.0), True),  # 3.33 m high where it leaves the house
        ((0.0, 3.0, 8.0), (6.0, 3.0, 0.0), False),  # 2.67 m high there
        ((0.0, 3.0, 3.0), (6.0, 3.0, 0.0), False),  # as high as the roof
        ((0.0, 3.0, 2.0), (2.0, 3.0, 0.0), True),  # on its wall
        ((6.0, 3.0, 2.0), (2.0, 3.0, 0.0), False),  # on its far wall
        ((2.0, 3.0, 9.0), (2.0, 3.0, 0.0), True),  # on its wall, from straight above
        ((0.0, 4.0, 2.0), (6.0, 4.0, 0.0), True),  # along its wall
        ((0.0, 4.1, 2.0), (6.0, 4.1, 0.0), True),  # beside it
        ((3.0, 3.0, 9.0), (3.0, 3.0, 2.9), False),  # below its roof
        ((3.0, 3.0, 9.0), (3.0, 3.0, 3.0), True),  # on its roof
        ((3.0, 3.0, 9.0), (0.0, 3.0, 0.0), True),  # beyond its wall, from above the roof
    ],
)
def test_line_of_sight_by_hand(camera, point, seen) -> None:
    assert line_of_sight(*building_table([(HOUSE, 3.0)]), *camera, *point) == seen


# Shadows


def test_shadow_from_above_a_corner_is_the_scaled_footprint() -> None:
    """F = 10 / (10 - 5) = 2; all walls and their shadows run through centers of cells, which are visible."""
    corners = [(2.5, 2.5), (4.5, 2.5), (4.5, 4.5), (2.5, 4.5)]
    x, y = centers(1.0, 9, 9)
    wanted = (x > 2.5) & (x < 6.5) & (y > 2.5) & (y < 6.5)
    for turned in (corners, corners[::-1], corners[1:] + corners[:1]):
        found = hidden_cells(occlusion([(turned, 5.0)], 10.0), 2.5, 2.5, 9.0, 1.0, (9, 9))
        np.testing.assert_array_equal(found, wanted)


def test_shadow_of_walls_in_line_with_the_camera() -> None:
    """The camera is lower than the roof, and on the line of the lower wall."""
    corners = [(3.5, 1.5), (5.5, 1.5), (5.5, 3.5), (3.5, 3.5)]
    x, y = centers(1.0, 12, 12)
    wanted = (x > 3.5) & (y > 1.5) & (y - 1.5 < x - 1.5)
    found = hidden_cells(occlusion([(corners, 5.0)], 4.0), 1.5, 1.5, 30.0, 1.0, (12, 12))
    np.testing.assert_array_equal(found, wanted)


def test_a_building_that_is_not_known_hides_nothing() -> None:
    houses = town()
    rows, corners = building_table(houses)
    known = np.arange(len(houses)) % 3 == 0
    place = 11.0, 9.0, 30.0, CELL, (160, 160)
    wanted = hidden_cells(occlusion(houses[::3], 9.0), *place)
    assert hidden_cells(Occlusion(rows, corners, known, 9.0), *place).tobytes() == wanted.tobytes()
    assert wanted.any()
    none = np.zeros_like(known)
    assert not hidden_cells(Occlusion(rows, corners, none, 9.0), *place).any()


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
        demand = Demand(p_x + 1.5, p_y - 1.0, 9.75, DESIRED)
        plain, found = ground.copy(), ground.copy()
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
def test_coverage_without_a_building_in_range_keeps_its_bits(buildings) -> None:
    sensor, blocks = SensorParameters(0, 1.0, R), occlusion(buildings, 9.0)
    for ground, p_x, p_y, _, _ in sights(4):
        demand = Demand(p_x + 1.5, p_y - 1.0, 9.75, DESIRED)
        results = []
        for last in ((), (None,), (blocks,)):
            grids = ground.copy(), ground.copy()
            accumulate(grids[0], p_x, p_y, sensor, CELL, 0.05, *last)
            gain = accumulate_with_gain(grids[1], p_x, p_y, demand, sensor, CELL, 0.05, *last)
            pull = coverage_gradient(ground, p_x, p_y, *demand, sensor, CELL, *last)
            results.append([array.tobytes() for array in (*grids, np.array([gain, *pull]))])
        assert results[0] == results[1] == results[2]
