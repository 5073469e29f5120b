"""Coverage grids in single precision: half the memory, and what comes of them is nearly the same."""

import numpy as np
import pytest

from outrider import RewardWeights, vector_env
from sim.engine.world_state import grid_in
from sim.kernels.compile import FloatArray
from sim.models.field import accumulate, accumulate_with_gain, coverage_error, coverage_gradient

SETTINGS = {
    "num_envs": 2,
    "agent": "uav_0",
    "estimate": True,
    "gradient": True,
    "rewards": RewardWeights(uncovered=1.0, seen=1.0),
    "end_on_sight_lost": False,
}


def _flown(precision: str) -> tuple[FloatArray, FloatArray, FloatArray, int]:
    """Rows and rewards of a flight of 10 s, the coverage that was reached, and the bytes of a world."""
    env = vector_env("escort", precision=precision, **SETTINGS)
    try:
        actions = np.random.default_rng(5).uniform(-0.2, 0.2, (200, 2, 2))
        env.reset(seed=3)
        rows, rewards = [], []
        for action in actions:
            row, reward, *_ = env.step(action)
            rows.append(row)
            rewards.append(reward)
        loop = env.worlds.loop
        coverage = loop.batch.state.truth.coverage.copy()
        return np.array(rows), np.array(rewards), coverage, loop.bytes_per_world()
    finally:
        env.close()


def _sums(precision: str) -> tuple[FloatArray, list[float]]:
    """A grid after some looks, and all that the kernels sum up of it on the way."""
    grid = grid_in(np.random.default_rng(7).uniform(0.0, 3.0, (161, 201)), precision)
    sums: list[float] = []
    for x, y in np.random.default_rng(8).uniform(4.0, 12.0, (20, 2)):
        accumulate(grid, x, y, 0, 1.0, 3.0, 0.1, 0.05)
        sums.append(accumulate_with_gain(grid, x, y, 9.0, 8.0, 4.0, 2.0, 0, 1.0, 3.0, 0.1, 0.05))
        sums.append(coverage_error(grid, 9.0, 8.0, 4.0, 2.0, 0.1))
        sums.extend(coverage_gradient(grid, x, y, 9.0, 8.0, 4.0, 2.0, 0, 1.0, 3.0, 0.1))
    return grid, sums


def test_in_single_precision_the_kernels_sum_up_the_same_to_a_millionth() -> None:
    (grid, sums), (grid_1, sums_1) = (_sums(precision) for precision in ("double", "single"))
    assert (grid.dtype, grid_1.dtype) == (np.float64, np.float32)
    assert np.abs(grid - grid_1).max() <= 1e-6 * grid.max()
    for part in range(5):
        exact, found = np.array(sums[part::5]), np.array(sums_1[part::5])
        assert np.abs(found - exact).max() <= 1e-6 * np.abs(exact).max() > 0.0
    assert sums != sums_1


@pytest.mark.long
def test_in_single_precision_a_flight_is_the_same_to_a_millionth_in_half_the_memory() -> None:
    (rows, rewards, grids, bytes_), (rows_1, rewards_1, grids_1, bytes_1) = (
        _flown(precision) for precision in ("double", "single")
    )
    assert (grids.dtype, grids_1.dtype) == (np.float64, np.float32)
    assert bytes_ - bytes_1 == grids[0].nbytes // 2
    assert grids.max() > 0.5
    for exact, found in ((rows, rows_1), (rewards, rewards_1), (grids, grids_1)):
        assert np.abs(found - exact).max() <= 1e-6 * np.abs(exact).max()
    assert not np.array_equal(rewards, rewards_1)


@pytest.mark.parametrize("desired", [0.7, 1.9, 2.0, 3.3])
def test_what_is_covered_from_the_start_is_so_in_single_precision(desired: float) -> None:
    grid = grid_in(np.full((3, 3), desired), "single")
    assert grid.dtype == np.float32
    assert (grid >= desired).all()
    assert grid.max() == pytest.approx(desired, rel=1e-6)


@pytest.mark.parametrize("word", ["half", "float32", "", None, np.float32])
def test_another_precision_is_refused_in_one_line(word: object) -> None:
    with pytest.raises(ValueError, match=r"^precision = .*; allowed: 'double', 'single'$"):
        vector_env("escort", num_envs=1, agent="uav_0", precision=word)
