"""Fit of delay and jitter: for each shape, quantiles with the least difference of their logarithms; the best wins.

No shape may have messages that are faster than all recorded ones. A normal distribution has no lower limit: there, at
most one in as many messages as were recorded.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtri

from bus.messages.links import LinkSettings
from sim.channel.description import extra_delays
from sim.channel.jitter import SHAPES, jitter_quantile, jitter_share
from sim.compiling.compile import FloatArray, compiled

LEVELS: FloatArray = 1.0 - 10.0 ** (-3.0 * (np.arange(400, dtype=np.float64) + 0.5) / 400.0)
"""Levels of the compared quantiles, from the smallest to the largest but one in a thousand, spaced by powers of ten."""
STEADY = 1e-6
"""Spread of the delay below which there is no jitter [s]."""
_SHORTEST = 1e-3
"""Lower limit of the waits [s]; shorter ones make no difference at a tick."""


LONGEST = 30.0
"""Largest delay of a link [s]."""


class _Recorded(NamedTuple):
    """Limits of the recorded delays."""

    least: float
    """Smallest delay [s]."""
    most: float
    """Largest delay [s]."""
    messages: int


def fit_delay(arrived: FloatArray) -> dict[str, Any]:
    """Return delay, jitter, jitter shape and its limit.

    Args:
        arrived: Recorded delays in ascending order, from `LONGEST` at most [s].
    """
    least, most = float(arrived[0]), float(arrived[-1])
    if most - least < STEADY:
        return {"delay": float(np.median(arrived))}
    limits = _Recorded(least, most, len(arrived))
    wanted = logs(np.quantile(arrived, LEVELS))
    mean, deviation = float(arrived.mean()), float(arrived.std())
    starts = {
        "exponential": (least, mean - least),
        "uniform": (0.5 * (least + most), 0.5 * (most - least)),
        "normal": (mean, deviation),
        "pareto": (least, mean - least),
    }
    least_off, best = math.inf, LinkSettings()
    for shape, (delay, scale) in starts.items():
        found = minimize(
            _quantiles_off,
            np.array([delay, math.log(max(scale, STEADY))]),
            args=(shape, limits, wanted),
            method="Nelder-Mead",
            options={"xatol": 1e-6, "fatol": 1e-7, "maxiter": 300},
        )
        if found.fun < least_off:
            least_off, best = found.fun, _jittered(found.x, shape, limits)
    if best.jitter < STEADY:
        return {"delay": float(np.median(arrived))}
    fields = ("delay", "jitter", "jitter_shape", "max_jitter")
    return {field: getattr(best, field) for field in fields}


def _quantiles_off(x: FloatArray, shape: str, limits: _Recorded, wanted: FloatArray) -> float:
    """Return the mean difference of the quantiles' logarithms; x as in `_jittered`."""
    return float(np.abs(logs(delay_quantiles(_jittered(x, shape, limits))) - wanted).mean())


def logs(times: FloatArray) -> FloatArray:
    """Return the logarithms of times [s]; those below a millisecond count as one."""
    found: FloatArray = np.log(np.maximum(times, _SHORTEST))
    return found


def _jittered(x: FloatArray, shape: str, limits: _Recorded) -> LinkSettings:
    """Return settings with this delay and logarithm of the jitter, limited to the recorded delays.

    A normal distribution is cut at the largest delay, so that it has up to twice the share below the smallest one.
    """
    delay = min(max(float(x[0]), limits.least), limits.most, LONGEST)
    jitter = min(math.exp(min(float(x[1]), 3.0)), 10.0)
    if shape == "uniform":
        jitter = min(jitter, delay - limits.least)
    elif shape == "normal":
        jitter = min(jitter, (delay - limits.least) / -float(ndtri(0.5 / limits.messages)))
    jitter = max(jitter, 0.1 * STEADY)
    cut = 0.0 if shape == "uniform" else min(max(limits.most - delay, 0.01 * jitter), 60.0)
    return LinkSettings(delay=delay, jitter=jitter, jitter_shape=shape, max_jitter=cut)


def delay_quantiles(settings: LinkSettings, levels: FloatArray = LEVELS) -> FloatArray:
    """Return the quantiles of delay and jitter at these levels [s]; the jitter is above 0."""
    least, most = extra_delays(settings)
    shape = SHAPES[settings.jitter_shape]
    return settings.delay + _extra_quantiles(shape, settings.jitter, least, most, levels)


@compiled
def _extra_quantiles(
    shape: int, scale: float, least: float, most: float, levels: FloatArray
) -> FloatArray:
    low, high = jitter_share(shape, scale, least), jitter_share(shape, scale, most)
    found = np.empty_like(levels)
    for k in range(levels.shape[0]):
        extra = jitter_quantile(shape, scale, low + levels[k] * (high - low))
        found[k] = min(max(extra, least), most)
    return found
