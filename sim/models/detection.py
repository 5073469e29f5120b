"""Noisy relative detections of the UGV by the UAV: certain inside r_v, with a probability falling to 0 at range r."""

import math

from sim.compiling.compile import compiled
from sim.models.randomness import (
    DETECTION_CHANCE,
    DETECTION_NOISE,
    FIRST,
    Key,
    cut_normal_vector,
    uniform,
)
from sim.models.vehicles import norm

_TRUNCATION_TOLERANCE = 1e-6
"""Relative tolerance for rounding when an error is compared with the largest one."""


@compiled
def detection_chance(distance: float, r_v: float, sensing_range: float, dropout: float) -> float:
    """Return the probability that the UGV is detected.

    Args:
        distance: Distance between the vehicles [m].
        r_v: Visibility radius [m]: inside, detections fail only by dropout.
        sensing_range: The sensor's range r [m]: no detections beyond; in between, the probability falls linearly.
        dropout: Share of detections that fail at random.
    """
    if distance < r_v:
        return 1.0 - dropout
    if distance >= sensing_range:
        return 0.0
    return (1.0 - dropout) * (sensing_range - distance) / (sensing_range - r_v)


@compiled
def detect(
    p_delta_x: float,
    p_delta_y: float,
    r_v: float,
    sensing_range: float,
    dropout: float,
    sigma: float,
    cut: float,
    noise_key: Key,
    chance_key: Key,
    tick: int,
) -> tuple[bool, float, float]:
    """Attempt one detection of the UGV by the UAV.

    Args:
        p_delta_x, p_delta_y: True p_a - p_g [m].
        r_v, sensing_range, dropout: As in `detection_chance`.
        sigma: Standard deviation of the noise per axis [m].
        cut: The noise vector's norm is at most cut * sigma; infinite: not truncated.
        noise_key, chance_key: Keys of this UAV for the noise, and for failures.
        tick: Tick of the random numbers.

    Returns:
        True if the UGV was detected, and the noisy p_a - p_g [m]; NaN without a detection.
    """
    chance = detection_chance(norm(p_delta_x, p_delta_y), r_v, sensing_range, dropout)
    if uniform(chance_key, DETECTION_CHANCE, tick, FIRST) >= chance:
        return False, math.nan, math.nan
    if sigma == 0.0:
        return True, p_delta_x, p_delta_y
    n_x, n_y = cut_normal_vector(sigma, cut, noise_key, DETECTION_NOISE, tick, FIRST)
    return True, p_delta_x + n_x, p_delta_y + n_y


def error_share(sigma: float, cut: float, error: float) -> float:
    r"""Return the share of detections whose error is larger, as a vector norm.

    The norm of a normal vector exceeds $\epsilon$ with the probability $\exp(-\epsilon^2 / (2 \sigma^2))$.

    Args:
        sigma: Standard deviation of the noise per axis [m].
        cut: Truncation of the norm, in standard deviations; infinite: not truncated.
        error: Error [m].
    """
    if sigma == 0.0 or error >= sigma * cut * (1.0 - _TRUNCATION_TOLERANCE):
        return 0.0
    beyond = math.exp(-0.5 * cut * cut)
    return (math.exp(-0.5 * (error / sigma) ** 2) - beyond) / (1.0 - beyond)
