"""Intervals for what a sweep counts and averages.

95 % unless told otherwise, without anything but the standard library.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist, fmean, stdev

_SMALL = {1: 12.706204736, 2: 4.302652730, 3: 3.182446305, 4: 2.776445105, 5: 2.570581836}
"""Student's t at 97.5 % for so few degrees of freedom that the series below is not exact enough."""


def wilson_interval(hits: int, trials: int, *, confidence: float = 0.95) -> tuple[float, float]:
    r"""The interval of a share, Wilson 1927.

    Honest for few trials and for shares of 0 and 1, where hits/trials ± error is not.

    $$ \frac{\hat p + z^2/2n \pm z \sqrt{\hat p (1 - \hat p)/n + z^2/4n^2}}{1 + z^2/n} $$

    Args:
        hits: How often it happened.
        trials: Of how many.
        confidence: Of the interval.

    Raises:
        ValueError: If hits lies outside 0 to trials, or there are no trials.
    """
    if trials < 1 or not 0 <= hits <= trials:
        raise ValueError(
            f"hits = {hits} of trials = {trials}: allowed are 1 trial or more, and hits from 0 to trials"
        )
    z = NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    share, square = hits / trials, z * z / trials
    middle = share + 0.5 * square
    half = z * math.sqrt(share * (1.0 - share) / trials + 0.25 * square / trials)
    low = 0.0 if hits == 0 else (middle - half) / (1.0 + square)
    high = 1.0 if hits == trials else (middle + half) / (1.0 + square)
    return low, high


def student_t(degrees: int) -> float:
    """Student's t at 97.5 % (Hill 1970, the first terms of the expansion about the normal's quantile), exact to 0.1 %."""
    if degrees in _SMALL:
        return _SMALL[degrees]
    z, n = NormalDist().inv_cdf(0.975), float(degrees)
    first = (z**3 + z) / 4.0
    second = (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0
    third = (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0
    return z + first / n + second / n**2 + third / n**3


def mean_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """The mean and its 95 % interval, from the spread of the values; of a single one, itself thrice.

    Raises:
        ValueError: If there are none.
    """
    if not values:
        raise ValueError("no values: allowed is one or more")
    mean = fmean(values)
    if len(values) == 1:
        return mean, mean, mean
    half = student_t(len(values) - 1) * stdev(values) / math.sqrt(len(values))
    return mean, mean - half, mean + half
