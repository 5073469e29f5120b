"""95 % intervals for what a sweep counts and averages."""

import math
from collections.abc import Sequence
from statistics import fmean, stdev

from scipy import stats


def wilson_interval(hits: int, trials: int) -> tuple[float, float]:
    """The interval of a share, Wilson 1927: honest for few trials and for shares of 0 and 1.

    Args:
        hits: How often it happened.
        trials: Of how many.

    Raises:
        ValueError: If hits lies outside 0 to trials, or there are no trials.
    """
    if trials < 1 or not 0 <= hits <= trials:
        raise ValueError(
            f"hits = {hits} of trials = {trials}: allowed are 1 trial or more, and hits from 0 to trials"
        )
    low, high = stats.binomtest(hits, trials).proportion_ci(method="wilson")
    return float(low), float(high)


def mean_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """The mean and its interval by Student's t, from the spread of the values; of a single one, itself thrice.

    Raises:
        ValueError: If there are none.
    """
    if not values:
        raise ValueError("no values: allowed is one or more")
    mean = fmean(values)
    if len(values) == 1:
        return mean, mean, mean
    t = float(stats.t.ppf(0.975, len(values) - 1))
    half = t * stdev(values) / math.sqrt(len(values))
    return mean, mean - half, mean + half
