r"""A UAV's inner loop: keeps it near a reference that moves by (1), against wind and a wrong own position. SI units.

The commands step the reference. The error x = p - p_reference has, in each tick,

$$ \ddot x = u + w_a, \qquad u = -k_p (x + b) - k_d \dot x, \qquad \|u\| \le u_r $$

with the wind's acceleration w_a and the error b of the own position, which the loop cannot tell from one of its own.
The proof is in docs/explanation/proof.md, "Wind and position errors".
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
"""The sum over a response ends where it has fallen to this share; what is left is bounded."""
_MOST = 2**20
"""Ticks after which a response must have died away."""
_DUST = 1e-9
"""The share by which a reserve may fall short of what is needed and still be that."""


class InnerLoop(Message, frozen=True, kw_only=True):
    """Inner loop of a UAV, which tracks the reference state against wind and position errors."""

    position_gain: Positive = 1.0
    """Gain k_p of the position error [1/s²]."""
    velocity_gain: Positive = 2.0
    """Gain k_d of the velocity error [1/s]."""
    reserve: Positive = 0.5
    """Largest feedback acceleration u_r, in addition to max_acceleration [m/s²]."""


class Disturbance:
    """Record: tracking error of a UAV, and what acts on it in the coming tick."""

    error: Pair
    """True position minus reference position [m]."""
    error_rate: Pair
    """True velocity minus reference velocity [m/s]."""
    wind: Pair
    """Acceleration by the wind [m/s²]."""
    position_error: Pair
    """Error of the measured own position [m]."""
    gust: Pair
    """Wind minus its mean, before its limit [m/s²]."""
    drift: Pair
    """Position error before its limit [m]."""


class Responses(NamedTuple):
    """The sums of the error's and the feedback's answers to one tick's acceleration, and the feedback's own at once."""

    error: float
    """[s²]"""
    feedback: float
    """Without unit."""


@compiled
def step_error(loop: InnerLoop, row: Disturbance, dt: float) -> None:
    """Advance the tracking error over a tick, exactly, as the accelerations are held over it.

    Args:
        loop: Gains and reserve.
        row: The error and its causes; changed.
        dt: Length of the tick [s].
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
    r"""The sums $\sum_k |h_k|$ of the answers to an acceleration of 1 m/s² in one tick, from the tick after it on.

    Never too small: what is left out after n ticks, with $\|A^n\| = q$, is at most q / (1 - q) times the sum so far of
    the states' largest components, for each row of the answer. Infinite if the loop is unstable, or slower than `_MOST`
    ticks.
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
    """The largest acceleration that the feedback of an inner loop ever asks for [m/s²]; infinite if it is unstable.

    Arguments as in `tracking_error`; the loop's reserve is not looked at.
    """
    pushed = wind + loop.position_gain * position_error
    if pushed == 0.0:
        return 0.0
    answer = _responses(loop.position_gain, loop.velocity_gain, dt).feedback
    return loop.position_gain * position_error + answer * pushed


def tracking_error(loop: InnerLoop, wind: float, position_error: float, dt: float) -> float:
    r"""A bound on a UAV's distance from its reference [m], whatever wind and own position do within their bounds.

    $$ w = (W + k_p \epsilon_a) \sum_k |h_k| + (u + W) \frac{dt^2}{8} $$

    h is the error's answer to an acceleration of 1 m/s² in one tick, u the largest feedback, and the last term what
    lies between two ticks. Without an oscillation it is $W / k_p + \epsilon_a$ but for that term.

    Args:
        loop: Gains and reserve.
        wind: Largest acceleration of the wind, W [m/s²].
        position_error: Largest error of the own position, eps_a [m].
        dt: Length of a tick [s].

    Returns:
        Infinite where the loop is unstable at this tick, or asks for more than its reserve.
    """
    pushed = wind + loop.position_gain * position_error
    most = needed_reserve(loop, wind, position_error, dt)
    if pushed == 0.0:
        return position_error
    if not most <= loop.reserve * (1.0 + _DUST):
        return math.inf
    answer = _responses(loop.position_gain, loop.velocity_gain, dt).error
    return answer * pushed + 0.125 * (most + wind) * dt * dt
