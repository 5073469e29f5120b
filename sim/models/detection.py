"""Noisy relative detections of the UGV by the UAV: certain inside r_v, falling to nothing at the sensor's range r."""

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


@compiled
def detection_chance(distance: float, r_v: float, reach: float, dropout: float) -> float:
    """The chance that one look finds the UGV.

    Args:
        distance: Between the vehicles [m].
        r_v: Visibility radius [m]: inside, only dropouts are missed.
        reach: The sensor's range r [m]: from here on nothing is found; between, the chance falls linearly.
        dropout: Share of looks that fail for no reason.
    """
    if distance < r_v:
        return 1.0 - dropout
    if distance >= reach:
        return 0.0
    return (1.0 - dropout) * (reach - distance) / (reach - r_v)


@compiled
def detect(
    p_delta_x: float,
    p_delta_y: float,
    r_v: float,
    reach: float,
    dropout: float,
    sigma: float,
    cut: float,
    noise_key: Key,
    chance_key: Key,
    tick: int,
) -> tuple[bool, float, float]:
    """One look of the UAV at its UGV.

    Args:
        p_delta_x, p_delta_y: The true p_a - p_g [m].
        r_v, reach, dropout: As in `detection_chance`.
        sigma: Standard deviation of the noise per axis [m].
        cut: The noise vector's norm is at most cut * sigma; infinite: no cut.
        noise_key, chance_key: Of this UAV: of the noise, and of whether a look fails.
        tick: Of the draws.

    Returns:
        Whether the UGV was found, and the noisy p_a - p_g [m]; NaN where it was not.
    """
    chance = detection_chance(norm(p_delta_x, p_delta_y), r_v, reach, dropout)
    if uniform(chance_key, DETECTION_CHANCE, tick, FIRST) >= chance:
        return False, math.nan, math.nan
    if sigma == 0.0:
        return True, p_delta_x, p_delta_y
    n_x, n_y = cut_normal_vector(sigma, cut, noise_key, DETECTION_NOISE, tick, FIRST)
    return True, p_delta_x + n_x, p_delta_y + n_y
