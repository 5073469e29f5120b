"""Counter-based random numbers.

Draws match NumPy's Philox, are independent, and give a truncated Gaussian vector.
"""

import math
from hashlib import blake2b

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from properties import PROPERTY
from seeded import a_key
from sim.engine.run_keys import check_secret, derive_key, derive_keys, new_secret
from sim.models import randomness
from sim.models.randomness import (
    RUN_PURPOSES,
    cut_normal_vector,
    draw,
    key_of,
    philox,
    to_uniform,
    uniform,
    words_of,
)

words = st.integers(0, 2**64 - 1)
seeds = st.integers(0, 2**53 - 1)
small = st.integers(0, 2**32 - 1)
PURPOSES = {
    name: value
    for name, value in vars(randomness).items()
    if name.isupper() and name not in ("FIRST", "SECOND") and isinstance(value, int | np.int64)
}
SECRET = bytes(range(16)).hex()


def _numpy_philox(key: tuple[int, int], counter: tuple[int, int, int, int]) -> tuple[int, ...]:
    """Return the block of this counter; NumPy increments before it draws."""
    whole = sum(word << 64 * place for place, word in enumerate(counter))
    before = (whole - 1) % 2**256
    generator = np.random.Philox(key=key[0] | key[1] << 64, counter=before)
    return tuple(int(word) for word in generator.random_raw(4))


@given(words, words, words, words, words, words)
@settings(PROPERTY, max_examples=300)
def test_philox_is_numpys(key_0: int, key_1: int, c_0: int, c_1: int, c_2: int, c_3: int) -> None:
    found = philox(*map(np.uint64, (key_0, key_1, c_0, c_1, c_2, c_3)))
    assert tuple(map(int, found)) == _numpy_philox((key_0, key_1), (c_0, c_1, c_2, c_3))


@given(words, words, small, seeds, seeds)
@settings(PROPERTY)
def test_a_draw_is_the_block_of_its_key_purpose_tick_and_index(key_0, key_1, purpose, tick, index):
    key, wanted = a_key(key_0, key_1), _numpy_philox((key_0, key_1), (index, tick, purpose, 0))
    assert tuple(map(int, draw(key, purpose, tick, index))) == wanted
    assert uniform(key, purpose, tick, index) == to_uniform(np.uint64(wanted[0]))


def test_purposes_have_distinct_numbers() -> None:
    numbers = [number for name, number in PURPOSES.items() if name != "RUN_PURPOSES"]
    assert len(set(numbers)) == len(numbers)
    assert sorted(numbers)[:RUN_PURPOSES] == list(range(RUN_PURPOSES))


@given(words)
@settings(PROPERTY)
def test_a_word_becomes_a_number_below_one_with_53_bits(word: int) -> None:
    number = to_uniform(np.uint64(word))
    assert 0.0 <= number < 1.0
    assert number * 2.0**53 == word >> 11


@pytest.mark.parametrize("cut", [0.5, 1.0, 3.0, math.inf])
def test_truncated_noise_norm_is_truncated_rayleigh(cut: float) -> None:
    noise = np.array([cut_normal_vector(0.3, cut, a_key(4), 1, k, 0) for k in range(4000)])
    radius, angle = np.hypot(*noise.T) / 0.3, np.arctan2(noise[:, 1], noise[:, 0])
    rayleigh = stats.kstest(radius, lambda r: np.expm1(-0.5 * r**2) / np.expm1(-0.5 * cut**2))
    assert rayleigh.pvalue > 1e-3
    assert stats.kstest(angle / math.tau + 0.5, "uniform").pvalue > 1e-3
    assert abs(stats.spearmanr(radius, angle).statistic) < 4.0 / math.sqrt(4000)


@given(st.floats(1e-6, 1e3), st.floats(1e-3, 9.0), seeds, small)
@settings(PROPERTY, max_examples=500)
def test_cut_noise_never_goes_beyond_its_cut(sigma, cut, seed, tick):
    noise = cut_normal_vector(sigma, cut, a_key(seed), 1, tick, 0)
    assert math.hypot(*noise) <= cut * sigma * (1.0 + 1e-15)


def test_key_is_blake2b_of_seed_purpose_vehicle_and_secret() -> None:
    keys = derive_keys((5, 2**53 - 1), 3, SECRET)
    assert keys.shape == (2, RUN_PURPOSES, 3, 2)
    message = b"".join(
        number.to_bytes(size, "little") for number, size in ((2**53 - 1, 8), (4, 4), (2, 4))
    )
    secret = {"key": bytes.fromhex(SECRET), "person": b"outrider"}
    digest = blake2b(message, digest_size=16, **secret).hexdigest()
    assert derive_key(2**53 - 1, 4, 2, SECRET) == digest
    assert key_of(keys[1, :, 2], 4) == words_of(digest) == tuple(keys[1, 4, 2])


def test_seed_purpose_vehicle_and_secret_change_the_key() -> None:
    secrets = ("", SECRET, SECRET[:-1] + "e", SECRET + "00")
    keys = np.concatenate([derive_keys(range(20), 4, secret) for secret in secrets]).reshape(-1, 2)
    assert len({tuple(key) for key in keys.tolist()}) == len(keys) == 4 * 20 * RUN_PURPOSES * 4


@pytest.mark.parametrize("bad", ["", "00", "g" * 32, "0" * 31, "0" * 34])
def test_what_is_no_key_is_refused(bad: str) -> None:
    with pytest.raises(ValueError, match="hexadecimal"):
        words_of(bad)


def test_a_new_secret_has_128_bits_and_is_another_one_each_time() -> None:
    made = {new_secret() for _ in range(100)}
    assert len(made) == 100
    assert all(check_secret(secret) == secret and len(secret) == 32 for secret in made)


@pytest.mark.parametrize(
    "bad", ["0" * 30, "0" * 33, "0" * 130, "x" * 32, " " * 32, "0" * 31 + "\n"]
)
def test_what_is_no_secret_is_refused_and_not_repeated(bad: str) -> None:
    with pytest.raises(ValueError, match="32 to 128") as refusal:
        check_secret(bad, "the file")
    assert str(refusal.value).startswith("the file: ")
    assert bad not in str(refusal.value)


def test_a_secret_may_be_empty_long_or_in_capitals() -> None:
    assert check_secret("") == ""
    assert check_secret(SECRET.upper()) == SECRET
    assert check_secret("ab" * 64) == "ab" * 64
