"""Random keys for the tests, from a small number."""

import numpy as np

from sim.models.randomness import Key


def a_key(number: int, other: int = 0) -> Key:
    """Return a key as compiled functions read it."""
    return np.uint64(number), np.uint64(other)


def key_text(number: int) -> str:
    """Return the same key as a briefing contains it."""
    return number.to_bytes(16, "little").hex()
