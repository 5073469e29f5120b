"""Counter-based random numbers: NumPy's Philox, every draw on its own, and the cut Gaussian vector against its theory."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from properties import PROPERTY
from scipy import stats

from sim import randomness
from sim.randomness import cut_normal_vector, draw, philox, pilot_key, to_uniform, uniform

words = st.integers(0, 2**64 - 1)
seeds = st.integers(0, 2**53 - 1)
small = st.integers(0, 2**32 - 1)
PURPOSES = {name: value for name, value in vars(randomness).items() if name.isupper() and isinstance(value, int)}


def _numpy_philox(key: tuple[int, int], counter: tuple[int, int, int, int]) -> tuple[int, ...]:
    """The block of this counter; NumPy counts up before it draws."""
    whole = sum(word << 64 * place for place, word in enumerate(counter))
    before = (whole - 1) % 2**256
    generator = np.random.Philox(key=key[0] | key[1] << 64, counter=before)
    return tuple(int(word) for word in generator.random_raw(4))


@given(words, words, words, words, words, words)
@settings(PROPERTY, max_examples=300)
def test_philox_is_numpys(key_0: int, key_1: int, c_0: int, c_1: int, c_2: int, c_3: int) -> None:
    found = philox(*map(np.uint64, (key_0, key_1, c_0, c_1, c_2, c_3)))
    assert tuple(map(int, found)) == _numpy_philox((key_0, key_1), (c_0, c_1, c_2, c_3))


@given(seeds, small, small, seeds, seeds)
@settings(PROPERTY)
def test_a_draw_is_the_block_of_its_seed_purpose_vehicle_tick_and_index(
    seed: int, purpose: int, who: int, tick: int, index: int
) -> None:
    wanted = _numpy_philox((seed, purpose << 32 | who), (index, tick, 0, 0))
    assert tuple(map(int, draw(seed, purpose, who, tick, index))) == wanted
    assert uniform(seed, purpose, who, tick, index) == to_uniform(np.uint64(wanted[0]))


def test_every_draw_is_another_one() -> None:
    arguments = itertools.product(range(3), range(1, 7), range(3), range(20), range(3))
    assert len({draw(*each)[0] for each in arguments}) == 3 * 6 * 3 * 20 * 3


def test_each_purpose_has_a_number_of_its_own() -> None:
    assert PURPOSES
    assert len(set(PURPOSES.values())) == len(PURPOSES)


@pytest.mark.parametrize("argument", range(5), ids=("seed", "purpose", "who", "tick", "index"))
def test_neighbours_in_each_argument_are_independent(argument: int) -> None:
    base = np.array([11, 1, 0, 5, 0])
    step = np.zeros(5, dtype=np.int64)
    step[argument] = 1
    drawn = np.array([uniform(*(base + k * step).tolist()) for k in range(4000)])
    assert stats.kstest(drawn, "uniform").pvalue > 1e-3
    assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 4.0 / math.sqrt(4000)


@given(words)
@settings(PROPERTY)
def test_a_word_becomes_a_number_below_one_with_53_bits(word: int) -> None:
    number = to_uniform(np.uint64(word))
    assert 0.0 <= number < 1.0
    assert number * 2.0**53 == word >> 11


@pytest.mark.parametrize("cut", [0.5, 1.0, 3.0, math.inf])
def test_the_norm_of_cut_noise_follows_the_cut_rayleigh_distribution(cut: float) -> None:
    noise = np.array([cut_normal_vector(0.3, cut, 4, 1, 0, k, 0) for k in range(4000)])
    radius, angle = np.hypot(*noise.T) / 0.3, np.arctan2(noise[:, 1], noise[:, 0])
    assert stats.kstest(radius, lambda r: -np.expm1(-0.5 * r**2) / -np.expm1(-0.5 * cut**2)).pvalue > 1e-3
    assert stats.kstest(angle / math.tau + 0.5, "uniform").pvalue > 1e-3
    assert abs(stats.spearmanr(radius, angle).statistic) < 4.0 / math.sqrt(4000)


def test_noise_without_a_cut_is_gaussian_on_each_axis() -> None:
    noise = np.array([cut_normal_vector(0.3, math.inf, 4, 1, 0, k, 0) for k in range(4000)])
    for axis in range(2):
        assert stats.kstest(noise[:, axis] / 0.3, "norm").pvalue > 1e-3
    assert abs(np.corrcoef(noise.T)[0, 1]) < 4.0 / math.sqrt(4000)


@given(st.floats(1e-6, 1e3), st.floats(1e-3, 9.0), seeds, small)
@settings(PROPERTY, max_examples=500)
def test_cut_noise_never_goes_beyond_its_cut(sigma: float, cut: float, seed: int, tick: int) -> None:
    assert math.hypot(*cut_normal_vector(sigma, cut, seed, 1, 0, tick, 0)) <= cut * sigma * (1.0 + 1e-15)


def test_a_pilots_key_survives_json_and_is_nobody_elses() -> None:
    keys = [pilot_key(seed, vehicle) for seed in range(30) for vehicle in range(4)]
    assert all(0 <= key < 2**53 for key in keys)
    assert len(set(keys)) == len(keys)
