"""Counter-based random numbers: each draw is a pure function of seed, purpose, who, tick and index.

So a process that comes back, a batch of worlds and a single world draw the same numbers, and a new purpose leaves the others
alone. Philox4x64-10 of Salmon, Moraes, Dror, Shaw, *Parallel Random Numbers: As Easy as 1, 2, 3* (SC 2011).
"""

import math

import numpy as np

from sim.compile import compiled

# Purposes: what a draw is for. A number, once given, stays.
DETECTION_NOISE = 1
DETECTION_CHANCE = 2
PILOT_KEY = 3
NEAREST_POINT = 4
START_DIRECTION = 5
WANDER = 6
LINK_LOSS = 7
LINK_STATE = 8
LINK_DELAY = 9

_MASK = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_M0 = np.uint64(0xD2E7470EE14C6C93)
_M1 = np.uint64(0xCA5A826395121157)
_W0 = np.uint64(0x9E3779B97F4A7C15)
_W1 = np.uint64(0xBB67AE8584CAA73B)


@compiled
def _high_product(a: np.uint64, b: np.uint64) -> np.uint64:
    """The upper 64 bits of a 64 x 64 bit product."""
    a_low, a_high = a & _MASK, a >> _HALF
    b_low, b_high = b & _MASK, b >> _HALF
    low = a_low * b_low
    middle = a_high * b_low + (low >> _HALF)
    other = a_low * b_high + (middle & _MASK)
    return a_high * b_high + (middle >> _HALF) + (other >> _HALF)


@compiled
def philox(
    key_0: np.uint64, key_1: np.uint64, c_0: np.uint64, c_1: np.uint64, c_2: np.uint64, c_3: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """One block of Philox4x64-10: four 64-bit words from a key of two and a counter of four."""
    for _ in range(10):
        high_0, low_0 = _high_product(_M0, c_0), _M0 * c_0
        high_1, low_1 = _high_product(_M1, c_2), _M1 * c_2
        c_0, c_1, c_2, c_3 = high_1 ^ c_1 ^ key_0, low_1, high_0 ^ c_3 ^ key_1, low_0
        key_0 += _W0
        key_1 += _W1
    return c_0, c_1, c_2, c_3


@compiled
def draw(seed: int, purpose: int, who: int, tick: int, index: int) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Four random words for one seed, purpose, vehicle or link, tick and index."""
    return philox(
        np.uint64(seed),
        (np.uint64(purpose) << _HALF) | np.uint64(who),
        np.uint64(index),
        np.uint64(tick),
        np.uint64(0),
        np.uint64(0),
    )


@compiled
def to_uniform(word: np.uint64) -> float:
    """A word as a number in [0, 1), with 53 bits."""
    return float(word >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled
def uniform(seed: int, purpose: int, who: int, tick: int, index: int) -> float:
    """A number in [0, 1)."""
    return to_uniform(draw(seed, purpose, who, tick, index)[0])


@compiled
def cut_normal_vector(sigma: float, cut: float, seed: int, purpose: int, who: int, tick: int, index: int) -> tuple[float, float]:
    r"""A Gaussian vector of standard deviation sigma per axis, given that its norm is at most cut * sigma.

    Drawn by inversion of the Rayleigh distribution, $\|n\| = \sigma\sqrt{-2\ln(1 - u(1 - e^{-k^2/2}))}$, which is what
    drawing again until the norm fits gives, in one draw. `cut = inf` is the plain Gaussian.
    """
    word_0, word_1, _, _ = draw(seed, purpose, who, tick, index)
    share = to_uniform(word_0) * -math.expm1(-0.5 * cut * cut)
    radius = sigma * min(math.sqrt(-2.0 * math.log1p(-share)), cut)
    angle = 2.0 * math.pi * to_uniform(word_1)
    return radius * math.cos(angle), radius * math.sin(angle)


@compiled
def pilot_key(seed: int, vehicle: int) -> int:
    """The key of a pilot's own random numbers: below 2**53, so that it survives JSON in every language."""
    return np.int64(draw(seed, PILOT_KEY, vehicle, 0, 0)[0] >> np.uint64(11))  # type: ignore[return-value]
