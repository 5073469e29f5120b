"""Assumptions of the UAV's filter: the noise of a detection, and the movement of a UGV with known bounds."""

import math
from typing import NamedTuple

import numpy as np

from bus.messages.scenario import Detector, Estimator, Limits
from bus.ticks import ticks_within
from sim.compiling.compile import FloatArray, compiled

SPAN = 60.0
"""Default of the greatest delay of a usable detection [s]."""
LEAST_DEVIATION = 1.0 / math.sqrt(8.0)
"""Least standard deviation of the position per metre that the UGV may have strayed while it was not detected."""
_MOST_TICKS = 100_000  # about 60 MB; a longer span is cut, where ticks are that short
_TIRE_LIMIT = 9.81
"""Acceleration that tires on the ground can reach [m/s²]; used if neither of the UGV's bounds is known."""
_ACCELERATION_TIME = 1.0
"""Duration of an acceleration if the maximum speed is unknown [s]."""
_VARIANCE_FLOOR = 1e-12
"""(1 µm)² [m²]: keeps S regular for a detector without noise."""
_FREE_SPEED = 10.0
"""Standard deviation of the first velocity per axis if the maximum speed is unknown [m/s]."""


class KalmanParameters(NamedTuple):
    """Parameters of one UAV's filter, from `kalman_parameters`."""

    dt: float
    """Length of a tick [s]."""
    variance: float
    """R: variance of a detection, per axis [m²]."""
    first_variance: float
    """Variance of the first velocity, per axis [m²/s²]."""
    q_pp: float
    """Position entry of Q for one tick [m²]."""
    q_pv: float
    """Position-velocity entry of Q [m²/s]."""
    q_vv: float
    """Velocity entry of Q [m²/s²]."""
    speed: float
    """Maximum speed of the UGV, v_g,max [m/s]; infinite if unknown."""
    acceleration: float
    """Assumed acceleration of the UGV [m/s²]."""
    deviation: float
    """Standard deviation of the UGV's random acceleration in one tick, per axis [m/s²]."""
    gate: float
    """Largest normalized innovation squared of an accepted measurement."""
    max_rejections: int
    """Number of consecutive rejections after which the filter reinitializes."""
    enabled: bool
    """False: the newest measurement is used unfiltered until the next one."""


def truncated_variance(*, sigma: float, truncation: float | None) -> float:
    r"""Return the variance per axis of a Gaussian vector in the plane whose norm is truncated at $k$ deviations.

    $$ \sigma^2 \left[ 1 - \frac{(k^2/2)\, e^{-k^2/2}}{1 - e^{-k^2/2}} \right]
       = \sigma^2 \left[ 1 - \frac{h}{e^h - 1} \right], \quad h = k^2/2 $$

    It is half of $E\|n\|^2$, with the Rayleigh density of the norm truncated at $k\sigma$. For small $k$ it approaches
    the variance of a uniform disc, $(k\sigma)^2/4$; at $k = 3$ it is 0.949 σ².

    Args:
        sigma: Standard deviation per axis before the truncation [m].
        truncation: Truncation k; None without truncation.

    Returns:
        The variance per axis [m²].
    """
    h = math.inf if truncation is None else 0.5 * truncation * truncation
    if h > 700.0:  # e^h would overflow, and no draw exceeds such a truncation
        return sigma * sigma
    if h < 1e-4:  # series expansion, since the difference would lose its digits
        return sigma * sigma * h * (0.5 - h / 12.0)
    return sigma * sigma * (1.0 - h / math.expm1(h))


def acceleration_deviation(*, target: Limits, acceleration_share: float, dt: float) -> float:
    r"""Return the standard deviation per axis of the UGV's random acceleration, redrawn at each tick.

    $$ \sigma_u = m\, u_{g,max} \sqrt{T/dt}, \qquad T = \max(dt,\ \tfrac12 v_{g,max}/u_{g,max}) $$

    A real UGV does not change its acceleration at random in each tick: it brakes or accelerates for up to
    $v_{g,max}/u_{g,max}$, half of it on average. Noise of deviation $m\,u_{g,max}$, constant for T, has the same
    density as noise that is constant for one tick and larger by the root, so the filter does not depend on the length
    of a tick.

    Deviation: without the root (T = dt) a UGV that stops at its corners gives an average NEES of 9 on legs of 1 to 8 m
    and 37 on legs below 1 m, where 4 is consistent, because the filter is overconfident; with it 2.5 and 3.2.

    If a bound is missing: without $u_{g,max}$ the UGV may change its velocity by $v_{g,max}$ within a tick,
    $u_{g,max} = v_{g,max}/dt$; without either it has the acceleration of tires, 9.81 m/s²; without $v_{g,max}$ T is
    1 s.

    Args:
        target: Limits of the UGV.
        acceleration_share: Acceleration share m.
        dt: Length of a tick [s].

    Returns:
        The standard deviation [m/s²].
    """
    acceleration = _largest_acceleration(target, dt)
    duration = (
        _ACCELERATION_TIME if target.max_speed is None else 0.5 * target.max_speed / acceleration
    )
    return acceleration_share * acceleration * math.sqrt(max(dt, duration) / dt)


def _largest_acceleration(target: Limits, dt: float) -> float:
    if target.max_acceleration is not None:
        return target.max_acceleration
    return _TIRE_LIMIT if target.max_speed is None else target.max_speed / dt


def assumed_acceleration(*, target: Limits, acceleration_share: float, dt: float) -> float:
    r"""Return the assumed acceleration of the UGV [m/s²]: $m\,u_{g,max}$, see `acceleration_deviation`."""
    return acceleration_share * _largest_acceleration(target, dt)


@compiled
def strayed_distance(elapsed: float, speed: float, acceleration: float) -> float:
    r"""Return the largest distance between a UGV and its straight continuation.

    The UGV reverses at the assumed acceleration.

    $$ d(t) = \tfrac12 a t^2 \ \text{until}\ t = 2 v_{g,max}/a, \quad \text{then}\ 2 v_{g,max} (t - v_{g,max}/a),
       \qquad a = m\, u_{g,max} $$

    Args:
        elapsed: Time t [s].
        speed: Maximum speed v_g,max [m/s].
        acceleration: Assumed acceleration a [m/s²].

    Returns:
        The distance [m].
    """
    if elapsed * acceleration < 2.0 * speed:
        return 0.5 * acceleration * elapsed * elapsed
    return 2.0 * speed * (elapsed - speed / acceleration)


@compiled
def bounded_scales(
    position_variance: float,
    velocity_variance: float,
    variance_before: float,
    elapsed: float,
    dt: float,
    max_speed: float,
    acceleration: float,
) -> tuple[float, float]:
    r"""Return the factors that bound the predicted standard deviations of position and velocity per axis.

    The velocity's is at most v_g,max. The position's grows by at most v_g,max dt in a tick, and is at least 1/√8 of the
    distance that the UGV can have strayed from its course. So a UGV that reversed causes a NEES of at most 8, and its
    detections are accepted again. Without the lower bound the covariance ignores the speed of the mean: NEES 16 after
    2 minutes.

    Args:
        position_variance: Predicted variance of the position [m²].
        velocity_variance: Predicted variance of the velocity [m²/s²].
        variance_before: Variance of the position before the prediction [m²].
        elapsed: Time since the newest accepted measurement [s].
        dt: Length of a tick [s].
        max_speed: v_g,max [m/s]; infinite if unknown: then nothing is bounded.
        acceleration: Assumed acceleration of the UGV [m/s²].
    """
    if not max_speed < math.inf:
        return 1.0, 1.0
    position, velocity = math.sqrt(position_variance), math.sqrt(velocity_variance)
    least = LEAST_DEVIATION * strayed_distance(elapsed, max_speed, acceleration)
    most = math.sqrt(variance_before) + max_speed * dt
    return min(max(least, position), most) / position, min(1.0, max_speed / velocity)


def process_noise(*, dt: float, deviation: float) -> FloatArray:
    r"""Return Q of one axis over one tick, with a random acceleration constant over it.

    $$ Q = \sigma_u^2 \begin{bmatrix} dt^4/4 & dt^3/2 \\ dt^3/2 & dt^2 \end{bmatrix} $$

    Args:
        dt: Length of a tick [s].
        deviation: σ_u of the acceleration per axis [m/s²].
    """
    push = np.array([0.5 * dt * dt, dt])
    return np.asarray(deviation**2 * np.outer(push, push))


def history_depth(span: float, dt: float) -> int:
    """Return the number of past ticks, including the present one, whose measurements are usable.

    Args:
        span: Greatest delay of a measurement [s].
        dt: Length of a tick [s].

    Raises:
        ValueError: If the span is negative.
    """
    if not span >= 0.0:
        raise ValueError(f"span = {span}: negative; allowed: 0 s or more")
    return 1 + (_MOST_TICKS if span / dt > _MOST_TICKS else ticks_within(span, dt))


def kalman_parameters(
    *, detector: Detector, target: Limits, dt: float, settings: Estimator
) -> KalmanParameters:
    """Return the parameters of one UAV's filter.

    Args:
        detector: Detector of the UAV; its noise and truncation determine R.
        target: Limits of the UGV.
        dt: Length of a tick [s].
        settings: Gate, maximum rejections, acceleration share, and whether to filter at all.

    Raises:
        ValueError: If dt is not positive and finite.
    """
    if not 0.0 < dt < math.inf:
        raise ValueError(f"dt = {dt}: not a tick length; allowed: positive and finite")
    (speed, _), acceleration_share = target.numbers, settings.acceleration_share
    deviation = acceleration_deviation(target=target, acceleration_share=acceleration_share, dt=dt)
    Q = process_noise(dt=dt, deviation=deviation)
    return KalmanParameters(
        dt=float(dt),
        variance=max(
            truncated_variance(sigma=detector.noise, truncation=detector.truncation),
            _VARIANCE_FLOOR,
        ),
        # A vehicle at full speed in an unknown direction: v²/2 per axis.
        first_variance=_FREE_SPEED**2 if target.max_speed is None else 0.5 * speed**2,
        q_pp=Q.item(0, 0),
        q_pv=Q.item(0, 1),
        q_vv=Q.item(1, 1),
        speed=speed,
        acceleration=float(
            assumed_acceleration(target=target, acceleration_share=acceleration_share, dt=dt)
        ),
        deviation=deviation,
        gate=float(settings.gate),
        max_rejections=settings.max_rejections,
        enabled=settings.enabled,
    )
