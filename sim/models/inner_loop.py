r"""Inner loop of a UAV: tracks a reference that moves by (1), against wind and position errors. SI units.

The commands move the reference. The tracking error x = p - p_reference satisfies, in each tick,

$$ \ddot x = u + w_a, \qquad u = -k_p (x + b) - k_d \dot x, \qquad \|u\| \le u_r $$

with the wind's acceleration w_a and the position error b, which the loop cannot distinguish from a tracking error. The
proof is in docs/explanation/proof.md, "Wind, tracking and a wrong own position".
"""

import functools
import math
from typing import NamedTuple

import numpy as np

from bus.messages.base import Message, Positive
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import Pair
from sim.models.vehicles import clip_norm

_ENOUGH = 1e-6
"""Share of its initial value at which the sum over a response is truncated; the remainder is bounded."""
_MOST = 2**20
"""Maximum number of ticks until a response has decayed."""
_RESERVE_TOLERANCE = 1e-9
"""Relative tolerance when the reserve is compared with the required one."""


class InnerLoop(Message, frozen=True, kw_only=True):
    """Inner loop of a UAV, which tracks the reference state against wind and position errors."""

    position_gain: Positive = 1.0
    """Gain k_p from position error to acceleration [1/s²]."""
    velocity_gain: Positive = 2.0
    """Gain k_d from velocity error to acceleration [1/s]."""
    reserve: Positive = 0.5
    """Largest feedback acceleration u_r, in addition to max_acceleration [m/s²]."""


class Disturbance:
    """Tracking error of a UAV and its causes in the next tick; a record."""

    error: Pair
    """True position minus reference position [m]."""
    error_rate: Pair
    """True velocity minus reference velocity [m/s]."""
    wind: Pair
    """Acceleration of the wind [m/s²]."""
    position_error: Pair
    """Error of the measured own position [m]."""
    gust: Pair
    """Wind minus its mean, before the limit [m/s²]."""
    drift: Pair
    """Position error before the limit [m]."""
    unknown: bool
    """True if a robot flies the UAV and its state is unknown: the UAV then senses nothing."""


class Responses(NamedTuple):
    """Sums of the responses of tracking error and feedback to an acceleration in one tick."""

    error: float
    """Sum for the tracking error [s²]."""
    feedback: float
    """Sum for the feedback, dimensionless."""


@compiled
def step_error(loop: InnerLoop, row: Disturbance, dt: float) -> None:
    """Advance the tracking error by one tick, exactly for accelerations that are constant within it.

    Args:
        loop: Gains and reserve.
        row: Tracking error and its causes; changed.
        dt: Duration of a tick [s].
    """
    off, rate, measured = row.error, row.error_rate, row.position_error
    feedback = clip_norm(
        -loop.position_gain * (off[0] + measured[0]) - loop.velocity_gain * rate[0],
        -loop.position_gain * (off[1] + measured[1]) - loop.velocity_gain * rate[1],
        loop.reserve,
    )
    for axis in range(2):
        a = feedback[axis] + row.wind[axis]
        off[axis] += (rate[axis] + 0.5 * a * dt) * dt
        rate[axis] += a * dt


@functools.lru_cache(maxsize=256)
def _responses(k_p: float, k_d: float, dt: float) -> Responses:
    r"""Return the sums $\sum_k |h_k|$ of the responses to an acceleration of 1 m/s² in one tick, from the next tick on.

    Never too small: the remainder after n ticks, with $\|A^n\| = q$, is at most q / (1 - q) times the present sum of
    the states' largest components, for each row of the response. Infinite if the loop is unstable, or slower than
    `_MOST` ticks.
    """
    if k_d * dt >= 2.0 or k_p * dt >= 2.0 * k_d:  # Jury's criterion: the loop is unstable
        return Responses(math.inf, math.inf)
    half = 0.5 * dt * dt
    step: FloatArray = np.array([[1.0 - half * k_p, dt - half * k_d], [-dt * k_p, 1.0 - dt * k_d]])
    states, power = np.array([[half, dt]]), step
    while not (share := float(np.abs(power).sum(axis=1).max())) <= _ENOUGH:
        if len(states) >= _MOST:
            return Responses(math.inf, math.inf)
        states, power = np.concatenate((states, states @ power.T)), power @ power
    left = share / (1.0 - share) * float(np.abs(states).max(axis=1).sum())
    return Responses(
        error=float(np.abs(states[:, 0]).sum()) + left,
        feedback=float(np.abs(states @ (k_p, k_d)).sum()) + (k_p + k_d) * left,
    )


def needed_reserve(loop: InnerLoop, wind: float, position_error: float, dt: float) -> float:
    """Return the largest acceleration that the feedback of an inner loop can require [m/s²]; infinite if unstable.

    Arguments as in `tracking_error`; the loop's reserve is ignored.
    """
    pushed = wind + loop.position_gain * position_error
    if pushed == 0.0:
        return 0.0
    answer = _responses(loop.position_gain, loop.velocity_gain, dt).feedback
    return loop.position_gain * position_error + answer * pushed


def tracking_error(loop: InnerLoop, wind: float, position_error: float, dt: float) -> float:
    r"""Return a bound on a UAV's distance from its reference [m], for bounded wind and position error.

    $$ w = (W + k_p \epsilon_a) \sum_k |h_k| + (u + W) \frac{dt^2}{8} $$

    h is the response of the tracking error to an acceleration of 1 m/s² in one tick, u the largest feedback, and the
    last term the deviation between two ticks. Without oscillation the bound is $W / k_p + \epsilon_a$ plus that term.

    Args:
        loop: Gains and reserve.
        wind: Largest acceleration of the wind, W [m/s²].
        position_error: Largest position error, eps_a [m].
        dt: Duration of a tick [s].

    Returns:
        The bound; infinite if the loop is unstable at this tick duration, or requires more than its reserve.
    """
    pushed = wind + loop.position_gain * position_error
    most = needed_reserve(loop, wind, position_error, dt)
    if pushed == 0.0:
        return position_error
    if not most <= loop.reserve * (1.0 + _RESERVE_TOLERANCE):
        return math.inf
    answer = _responses(loop.position_gain, loop.velocity_gain, dt).error
    return answer * pushed + 0.125 * (most + wind) * dt * dt
