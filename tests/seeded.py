"""Keys of random numbers for the tests, by a small number."""

import numpy as np

from sim.models.randomness import Key


def a_key(number: int, other: int = 0) -> Key:
    """As compiled functions take it."""
    return np.uint64(number), np.uint64(other)


def a_told_key(number: int) -> str:
    """The same as a briefing carries it."""
    return number.to_bytes(16, "little").hex()
