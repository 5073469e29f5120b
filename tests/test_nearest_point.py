"""The symmetry breaker (7): the nearest uncovered point, random ties, and the time for which a point is kept."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import reference_field as reference
from agents.control.coverage import symmetry_breaker
from agents.control.nearest_point import is_uncovered, nearest_uncovered
from agents.laws.common import direction_to_uncovered
from flights import DESIRED, HERE, R_O, escort, flown_law, target_at
from properties import PROPERTY
from seeded import a_key
from sim.models.field import cover, empty_coverage
from sim.models.vehicles import State

CELL = 0.25
Result = tuple[bool, float, float]


@st.composite
def _searches(draw: st.DrawFn) -> tuple[np.ndarray, float, float, float, float, float, float]:
    """Draw ground with few uncovered cells, both vehicles on it or beside it, r_o, and the cell width."""
    rows, columns = draw(st.integers(1, 40)), draw(st.integers(1, 40))
    cell = draw(st.sampled_from((0.25, 0.4, 1.0)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    share = draw(st.sampled_from((0.0, 0.01, 0.1, 1.0)))
    coverage = np.where(rng.random((rows, columns)) < share, 1.0, 2.0 * DESIRED)
    points = st.floats(-2.0, 42 * cell) | st.sampled_from((0.0, cell, 3.5 * cell))
    return coverage, *(draw(points) for _ in range(4)), draw(st.floats(0.2, 15.0)), cell


@given(_searches(), st.integers(0, 2**53 - 1))
@settings(PROPERTY, max_examples=300)
def test_no_uncovered_point_is_nearer(search, key):
    coverage, p_ax, p_ay, p_gx, p_gy, r_o, cell = search
    found, q_x, q_y = nearest_uncovered(
        coverage, p_ax, p_ay, p_gx, p_gy, r_o, DESIRED, cell, a_key(key), 0
    )
    x, y = reference.centres(coverage, cell)
    candidates = (coverage < DESIRED) & ((x - p_gx) ** 2 + (y - p_gy) ** 2 < r_o**2)  # 1 and 2
    assert found == candidates.any()
    if found:
        assert candidates[int(q_y / cell), int(q_x / cell)]
        assert is_uncovered(coverage, q_x, q_y, p_gx, p_gy, r_o, DESIRED, cell)
        least = reference.distances(coverage, p_ax, p_ay, cell)[candidates].min()
        assert np.hypot(q_x - p_ax, q_y - p_ay) == pytest.approx(least, rel=1e-9)


def _corner(key: int, tick: int = 0) -> Result:
    """Return the nearest of the four cells around a corner of the grid, all uncovered."""
    coverage = empty_coverage(40.0, 40.0, CELL)
    return nearest_uncovered(coverage, *HERE, *HERE, R_O, DESIRED, CELL, a_key(key), tick)


@pytest.mark.parametrize("by", ["key", "tick"])
def test_each_of_four_equals_is_drawn_about_equally(by: str) -> None:
    answers = [
        _corner(key=k, tick=3) if by == "key" else _corner(key=5, tick=k) for k in range(2000)
    ]
    points, counts = np.unique(answers, axis=0, return_counts=True)
    assert {(x, y) for _, x, y in points.tolist()} == {
        (20.0 + i, 20.0 + j) for i in (-0.125, 0.125) for j in (-0.125, 0.125)
    }
    assert stats.chisquare(counts).pvalue > 1e-3


def test_the_symmetry_breaker_points_from_the_uav_to_the_point() -> None:
    assert symmetry_breaker(3.0, 1.0, 1.0, 2.0, 0.5) == (1.0, -0.5)


class _Search:
    """`direction_to_uncovered` with its own map and state; the UAV is at (20, 20)."""

    def __init__(self) -> None:
        self.c = flown_law(escort("coverage"))
        self.coverage = np.full((160, 160), DESIRED)
        self.tick = 0

    def uncover(self, x: float, y: float, value: float = 0.0) -> None:
        self.coverage[int(y / CELL), int(x / CELL)] = value

    def next_direction(self, ugv: tuple[float, float] = HERE) -> Result:
        self.tick += 1
        own, target = State(*HERE, 0.0, 0.0), target_at(*ugv)
        return direction_to_uncovered(
            self.c.uav, self.c.memory, self.coverage, self.tick, own, target
        )


def test_the_point_is_kept_until_it_is_covered() -> None:
    search = _Search()
    search.uncover(25.125, 20.125)
    assert search.next_direction() == (True, 5.125, 0.125)
    search.uncover(18.125, 20.125)  # a nearer one
    assert search.next_direction() == (True, 5.125, 0.125)
    search.uncover(25.125, 20.125, value=0.999 * DESIRED)  # nearly covered
    assert search.next_direction() == (True, 5.125, 0.125)
    search.uncover(25.125, 20.125, value=DESIRED)
    assert search.next_direction() == (True, -1.875, 0.125)


def test_nearest_point_is_kept_within_the_density_support() -> None:
    search = _Search()
    search.uncover(20.125 + R_O, 20.125)  # outside
    assert search.next_direction() == (False, 0.0, 0.0)
    search.uncover(25.125, 20.125)
    search.uncover(12.125, 20.125)
    assert search.next_direction() == (True, 5.125, 0.125)
    assert search.next_direction(ugv=(25.125 - 0.999 * R_O, 20.125)) == (True, 5.125, 0.125)
    assert search.next_direction(ugv=(25.125 - 1.001 * R_O, 20.125)) == (True, -7.875, 0.125)


def test_covered_ground_has_no_nearest_point() -> None:
    search = _Search()
    search.uncover(25.125, 20.125)
    search.next_direction()
    search.uncover(25.125, 20.125, value=DESIRED)
    assert search.next_direction() == (False, 0.0, 0.0)
    search.uncover(25.125, 20.125)
    search.uncover(18.125, 20.125)
    assert search.next_direction() == (True, -1.875, 0.125)


def test_uav_over_its_point_draws_a_keyed_direction() -> None:
    coverage = empty_coverage(40.0, 40.0, CELL)
    cover(coverage, (0.0, 0.0), (40.0, 40.0), CELL, DESIRED)
    coverage[80, 80] = 0.0
    place = (20.125, 20.125)
    angles = []
    for key in range(400):
        c = flown_law(escort("coverage"))
        c.memory["key_0"], c.memory["key_1"] = a_key(key)
        own = State(*place, 0.0, 0.0)
        found, x, y = direction_to_uncovered(c.uav, c.memory, coverage, 0, own, target_at(*place))
        assert found
        assert np.hypot(x, y) == pytest.approx(1.0, rel=1e-12)
        angles.append(np.arctan2(y, x))
    assert stats.kstest(np.array(angles) / (2.0 * np.pi) + 0.5, "uniform").pvalue > 1e-3
