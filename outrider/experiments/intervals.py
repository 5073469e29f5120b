"""Confidence intervals of shares and means, 95 % by default."""

import math
from collections.abc import Sequence
from statistics import fmean, stdev

import numpy as np
from scipy import stats

_RESAMPLES = 2000


def wilson_interval(hits: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Return the confidence interval of a share, Wilson 1927: valid for few trials and for shares of 0 and 1.

    Args:
        hits: Number of hits.
        trials: Number of trials.
        level: Confidence level.

    Raises:
        ValueError: If hits is outside 0 to trials, or there are no trials.
    """
    if trials < 1 or not 0 <= hits <= trials:
        raise ValueError(
            f"hits = {hits}, trials = {trials}: out of range; allowed: 1 trial or more, and hits from 0 to trials"
        )
    low, high = stats.binomtest(hits, trials).proportion_ci(level, method="wilson")
    return float(low), float(high)


def mean_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Return the mean and its interval by Student's t; for a single value, the interval is NaN.

    Raises:
        ValueError: If there are no values.
    """
    if not values:
        raise ValueError("values: empty; allowed: one value or more")
    mean = fmean(values)
    if len(values) == 1:
        return mean, math.nan, math.nan
    t = float(stats.t.ppf(0.975, len(values) - 1))
    half = t * stdev(values) / math.sqrt(len(values))
    return mean, mean - half, mean + half


def interquartile_interval(tasks: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """Return the interquartile mean of all scores, and its interval by the stratified bootstrap.

    As defined by Agarwal et al. 2021 (rliable): seeds are resampled within each task, and the interval is given by
    percentiles of 2000 resamples. Equal scores give equal intervals. For a single seed, the interval is NaN.

    Args:
        tasks: Scores of each task, one per seed.

    Raises:
        ValueError: If there are no scores, or the tasks differ in their number of seeds.
    """
    if not tasks or not all(len(one) == len(tasks[0]) > 0 for one in tasks):
        raise ValueError(
            "tasks: empty, or with different numbers of seeds; allowed: one task or more, with equal numbers of seeds"
        )
    scores = np.array(tasks, dtype=np.float64)
    middle, count = float(stats.trim_mean(scores, 0.25, axis=None)), scores.shape[1]
    if count == 1:
        return middle, math.nan, math.nan
    draws = np.random.default_rng(0).integers(0, count, (_RESAMPLES, *scores.shape))
    drawn = np.take_along_axis(scores[None], draws, axis=2).reshape(_RESAMPLES, -1)
    low, high = np.percentile(stats.trim_mean(drawn, 0.25, axis=1), [2.5, 97.5]).tolist()
    return middle, low, high
