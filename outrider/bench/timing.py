"""Rates, and the pair of numbers that a measurement gives."""

import time
from collections.abc import Callable

Pair = tuple[float, float | None]
"""A value, and the reference measured right after it; None where there is nothing to measure it with."""


def rate(work: Callable[[], object], count: int) -> float:
    """Calls of `work` a second, over so many."""
    started = time.perf_counter()
    for _ in range(count):
        work()
    return count / (time.perf_counter() - started)
