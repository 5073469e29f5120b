"""Intervals, of 95 % if nothing else is said, for what sweeps and suites count and average."""

import math
from collections.abc import Sequence
from statistics import fmean, stdev

import numpy as np
from scipy import stats

_RESAMPLES = 2000


def wilson_interval(hits: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """The interval of a share, Wilson 1927: honest for few trials and for shares of 0 and 1.

    Args:
        hits: How often it happened.
        trials: Of how many.
        level: Share of all cases in which the interval holds the chance.

    Raises:
        ValueError: If hits lies outside 0 to trials, or there are no trials.
    """
    if trials < 1 or not 0 <= hits <= trials:
        raise ValueError(
            f"hits = {hits} of trials = {trials}: allowed are 1 trial or more, and hits from 0 to trials"
        )
    low, high = stats.binomtest(hits, trials).proportion_ci(level, method="wilson")
    return float(low), float(high)


def mean_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """The mean and its interval by Student's t, from the spread of the values; of a single one NaN.

    Raises:
        ValueError: If there are none.
    """
    if not values:
        raise ValueError("no values: allowed is one or more")
    mean = fmean(values)
    if len(values) == 1:
        return mean, math.nan, math.nan
    t = float(stats.t.ppf(0.975, len(values) - 1))
    half = t * stdev(values) / math.sqrt(len(values))
    return mean, mean - half, mean + half


def interquartile_interval(tasks: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """The interquartile mean, of the middle half of all scores, and its interval by the stratified bootstrap.

    As Agarwal et al. 2021 (rliable) define it: seeds are drawn anew within each task, with percentiles of 2000 such
    draws, the same ones for the same scores. Of a single seed it is NaN.

    Args:
        tasks: The scores of each, as many as there are seeds.

    Raises:
        ValueError: If there are none, or not as many in each task.
    """
    if not tasks or not all(len(one) == len(tasks[0]) > 0 for one in tasks):
        raise ValueError(
            "the scores: allowed is one task or more, each with as many seeds, one or more"
        )
    scores = np.array(tasks, dtype=np.float64)
    middle, count = float(stats.trim_mean(scores, 0.25, axis=None)), scores.shape[1]
    if count == 1:
        return middle, math.nan, math.nan
    draws = np.random.default_rng(0).integers(0, count, (_RESAMPLES, *scores.shape))
    drawn = np.take_along_axis(scores[None], draws, axis=2).reshape(_RESAMPLES, -1)
    low, high = np.percentile(stats.trim_mean(drawn, 0.25, axis=1), [2.5, 97.5]).tolist()
    return middle, low, high
