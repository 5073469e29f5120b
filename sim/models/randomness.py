"""Counter-based random numbers: pure functions of key, purpose, tick and index.

A reconnected process, a batch of worlds and a single world therefore draw the same numbers, and a new purpose does not
change the others. Philox4x64-10 of Salmon, Moraes, Dror, Shaw, *Parallel Random Numbers: As Easy as 1, 2, 3* (SC 2011).

Philox is fast but not a cipher: its output is only as secret as its key. Values that must not reveal others therefore
have separate keys of 128 bits, derived one-way by `sim.engine.run_keys`.
"""

import math

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import compiled, constant

Key = tuple[np.uint64, np.uint64]
"""Key of random numbers. A vehicle's process receives only its pilot's key; the others stay in the simulator."""

WordArray = npt.NDArray[np.uint64]
"""Keys in arrays: the last axis has two words."""

# Purposes of the run: each has a separate key for each vehicle. Numbers must never change.
DETECTION_NOISE = constant(0)
DETECTION_CHANCE = constant(1)
PILOT = constant(2)
DETECTION_LINK = constant(3)
COMMAND_LINK = constant(4)
OPERATOR_LINK = constant(5)
RADIO_LINK = constant(6)
DISTURBANCE = constant(7)
HAZARD_FIELDS = constant(8)
GROUND_UPDATE = constant(9)
BUILDING_FIELDS = constant(10)
RUN_PURPOSES = 11
"""Number of these purposes."""
RANGES = 11
"""Purpose of an episode's randomized fields, in place of a purpose and with a field's number in place of a vehicle."""
TEAM_LINK = 12
"""Purpose of the links between UAVs of a team; no other part of a run needs these keys."""
BODY = 13
"""Purpose of the UAVs' bodies outside the compiled tick."""

# Purposes that share a key: of a pilot, of a link, of wind and position error, of the hazards, or of the buildings.
# Numbers must never change.
NEAREST_POINT = constant(16)
START_DIRECTION = constant(17)
WANDER = constant(18)
LINK_LOSS = constant(19)
LINK_STATE = constant(20)
LINK_DELAY = constant(21)
LINK_TRACE = constant(22)
GUST = constant(23)
OWN_POSITION = constant(24)
LOOKAHEAD_CANDIDATE = constant(25)
TILE_CHANCE = constant(26)
HAZARD_PLACE = constant(27)
BUILDING_SIDE = constant(28)
BUILDING_HEIGHT = constant(29)

FIRST, SECOND = constant(0), constant(1)
"""Indices of random numbers."""

_MASK = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_M0 = np.uint64(0xD2E7470EE14C6C93)
_M1 = np.uint64(0xCA5A826395121157)
_W0 = np.uint64(0x9E3779B97F4A7C15)
_W1 = np.uint64(0xBB67AE8584CAA73B)


@compiled
def _high_product(a: np.uint64, b: np.uint64) -> np.uint64:
    """Return the upper 64 bits of a 64 x 64 bit product."""
    a_low, a_high = a & _MASK, a >> _HALF
    b_low, b_high = b & _MASK, b >> _HALF
    low = a_low * b_low
    middle = a_high * b_low + (low >> _HALF)
    other = a_low * b_high + (middle & _MASK)
    return a_high * b_high + (middle >> _HALF) + (other >> _HALF)


@compiled
def philox(
    key_0: np.uint64,
    key_1: np.uint64,
    c_0: np.uint64,
    c_1: np.uint64,
    c_2: np.uint64,
    c_3: np.uint64,
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Return one block of Philox4x64-10: four 64-bit words from a key of two and a counter of four."""
    for _ in range(10):
        high_0, low_0 = _high_product(_M0, c_0), _M0 * c_0
        high_1, low_1 = _high_product(_M1, c_2), _M1 * c_2
        c_0, c_1, c_2, c_3 = high_1 ^ c_1 ^ key_0, low_1, high_0 ^ c_3 ^ key_1, low_0
        key_0 += _W0
        key_1 += _W1
    return c_0, c_1, c_2, c_3


@compiled
def key_of(keys: WordArray, purpose: int) -> Key:
    """Return one key of a vehicle. Shape of `keys`: (RUN_PURPOSES, 2)."""
    return keys[purpose, 0], keys[purpose, 1]


def words_of(key: str) -> Key:
    """Return the key that a message holds as 32 hexadecimal digits.

    Raises:
        ValueError: If it is not one.
    """
    if len(key) != 32:
        raise ValueError(f"key = {key!r}: not a key; allowed: 32 hexadecimal digits")
    first, second = np.frombuffer(bytes.fromhex(key), dtype="<u8")
    return np.uint64(first), np.uint64(second)


@compiled
def draw(
    key: Key, purpose: int, tick: int, index: int
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Return four random words for one key, purpose, tick and index."""
    return philox(
        key[0], key[1], np.uint64(index), np.uint64(tick), np.uint64(purpose), np.uint64(0)
    )


@compiled
def to_uniform(word: np.uint64) -> float:
    """Return a word as a number in [0, 1), with 53 bits."""
    return float(word >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled
def uniform(key: Key, purpose: int, tick: int, index: int) -> float:
    """Return a uniform random number in [0, 1)."""
    return to_uniform(draw(key, purpose, tick, index)[0])


@compiled
def cut_normal_vector(
    sigma: float, cut: float, key: Key, purpose: int, tick: int, index: int
) -> tuple[float, float]:
    r"""Return a Gaussian vector with standard deviation sigma per axis, conditioned on a norm of at most cut * sigma.

    Computed by inversion of the Rayleigh distribution, $\|n\| = \sigma\sqrt{-2\ln(1 - u(1 - e^{-k^2/2}))}$, which is
    equivalent to rejection sampling. `cut = inf` is the plain Gaussian.
    """
    word_0, word_1, _, _ = draw(key, purpose, tick, index)
    share = to_uniform(word_0) * -math.expm1(-0.5 * cut * cut)
    radius = sigma * min(math.sqrt(-2.0 * math.log1p(-share)), cut)
    angle = 2.0 * math.pi * to_uniform(word_1)
    return radius * math.cos(angle), radius * math.sin(angle)
