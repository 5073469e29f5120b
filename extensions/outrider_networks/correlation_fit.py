"""Fit of the correlation time of delays, from the autocorrelation of their normal scores.

The simulated delay is the quantile of a normal process with the correlation exp(-t/T). The normal scores of the
recorded delays' ranks estimate this process, whatever the distribution of the delay is.
"""

import math

import msgspec
import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

from bus.messages.links import LinkSettings
from outrider_networks.delay_fit import STEADY
from outrider_networks.nearest import wait_factor
from outrider_networks.samples import Sample, drawn_sample
from sim.compiling.compile import FloatArray

_SURE = 3.0
"""Standard deviations by which the autocorrelation of independent delays is exceeded."""
_MOST_LAG = 1000
_WORSE = 1.05
"""Ratio of the factors of the waits up to which correlated delays are preferred to independent ones."""


def with_correlation(settings: LinkSettings, sample: Sample) -> LinkSettings:
    """Return the settings with the correlation time of the recording.

    Of several, it is the one that brings the waits closest to the recorded ones; none if all of them move the waits
    away from the recorded ones.

    Args:
        settings: Fitted settings with independent delays.
        sample: Recorded messages.
    """
    if settings.jitter == 0.0:
        return settings
    found = [
        msgspec.structs.replace(settings, jitter_time=float(f"{time:.3g}"))
        for time in correlation_times(sample)
    ]
    if not found:
        return settings
    factors = [
        wait_factor(sample, drawn_sample(one, sample.interval)) for one in (settings, *found)
    ]
    best = min(range(1, len(factors)), key=lambda k: factors[k])
    return found[best - 1] if factors[best] <= _WORSE * factors[0] else settings


def correlation_times(sample: Sample) -> list[float]:
    """Return the correlation times [s] by the next message, and by the lag at which the correlation is below 1/e.

    Both are equal for the simulated process. There is none if delays are independent.
    """
    r = autocorrelation(sample, 1)
    if math.isnan(r) or r <= _SURE / math.sqrt(len(sample.delay)):
        return []
    found, lag = [_time(r, sample.interval)], 1
    while r > math.exp(-1.0):
        lag += 1
        later = autocorrelation(sample, lag)
        if lag > min(_MOST_LAG, len(sample.delay) // 4) or math.isnan(later):
            return found
        r = later
    return [*found, _time(max(r, 1e-3), lag * sample.interval)] if lag > 1 else found


def _time(r: float, lag: float) -> float:
    """Return the time T for which exp(-lag/T) = r."""
    return lag / -math.log(min(r, 1.0 - 1e-6))


def autocorrelation(sample: Sample, lag: int) -> float:
    """Return the correlation of the normal scores of delays this many messages apart; NaN if there is none."""
    scores = _scores(sample)
    before, after = scores[:-lag], scores[lag:]
    both = ~np.isnan(before) & ~np.isnan(after)
    if both.sum() < 3 or sample.arrived[-1] - sample.arrived[0] < STEADY:
        return math.nan
    return float((before[both] * after[both]).mean() / np.nanvar(scores))


def _scores(sample: Sample) -> FloatArray:
    """Return the normal score of each delay's rank; NaN: lost. Shape (messages,)."""
    there = ~np.isnan(sample.delay)
    scores = np.full(len(sample.delay), np.nan)
    scores[there] = ndtri((rankdata(sample.delay[there]) - 0.5) / there.sum())
    return scores
