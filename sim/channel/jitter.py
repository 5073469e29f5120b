"""Distributions of the random extra delay: shares and quantiles."""

import math

from sim.compiling.compile import compiled

UNIFORM, NORMAL, EXPONENTIAL, PARETO = range(4)
SHAPES = {"uniform": UNIFORM, "normal": NORMAL, "exponential": EXPONENTIAL, "pareto": PARETO}
"""Distributions of the extra delay with the scale j: uniform from -j to j; normal with standard deviation j;
exponential with mean j; Lomax (Pareto of the second kind, from 0) with mean j and tail index 2.5, whose variance is
finite and whose skewness is not.
"""

_TAIL = 2.5


@compiled
def normal_quantile(share: float) -> float:
    """Return the quantile of the standard normal distribution; 0 < share < 1.

    Abramowitz and Stegun, *Handbook of Mathematical Functions*, 26.2.23, with an error below 4.5e-4, then two steps of
    Halley's method, which leave rounding errors.
    """
    tail = min(share, 1.0 - share)
    t = math.sqrt(-2.0 * math.log(tail))
    top = (0.010328 * t + 0.802853) * t + 2.515517
    bottom = ((0.001308 * t + 0.189269) * t + 1.432788) * t + 1.0
    x = top / bottom - t
    for _ in range(2):
        off = 0.5 * math.erfc(-x / math.sqrt(2.0)) - tail
        step = off * math.sqrt(2.0 * math.pi) * math.exp(0.5 * x * x)
        x -= step / (1.0 + 0.5 * x * step)
    return x if share < 0.5 else -x


@compiled
def jitter_share(shape: int, scale: float, extra: float) -> float:
    """Return the share of extra delays up to `extra` [s]; shape and scale [s] as in `SHAPES`."""
    x = extra / scale
    if shape == UNIFORM:
        return min(max(0.5 * (x + 1.0), 0.0), 1.0)
    if shape == NORMAL:
        return 0.5 * math.erfc(-x / math.sqrt(2.0))
    if x <= 0.0:
        return 0.0
    if shape == EXPONENTIAL:
        return -math.expm1(-x)
    return 1.0 - float((1.0 + x / (_TAIL - 1.0)) ** -_TAIL)


@compiled
def jitter_quantile(shape: int, scale: float, share: float) -> float:
    """Return the extra delay [s] up to which this share of them lies; the inverse of `jitter_share`."""
    inner = min(max(share, 1e-300), 1.0 - 2.0**-53)
    if shape == UNIFORM:
        return scale * (2.0 * share - 1.0)
    if shape == NORMAL:
        return scale * normal_quantile(inner)
    if shape == EXPONENTIAL:
        return -scale * math.log1p(-inner)
    return scale * (_TAIL - 1.0) * (float((1.0 - inner) ** (-1.0 / _TAIL)) - 1.0)
