"""Candidate trajectories of the law `lookahead` and their value: docs/explanation/lookahead.md.

Positions in the world's frame [m], velocities [m/s], times [s] except for ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.laws.common import border_margin
from agents.uav_parameters import Target, UavParameters
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.models.field import density
from sim.models.sensor import sensor_quality
from sim.models.vehicles import Motion, clip_norm, norm, stopping_distance

PERIOD = 0.5
"""Time between two decisions [s]."""
STEPS = 15
"""Largest number of steps of a candidate, none shorter than `PERIOD`."""
LEGS = 8
"""Largest number of legs of a candidate; each has a constant desired velocity and lasts at least `PERIOD`."""

_TAIL = 5.0
"""Time after the horizon for which coverage still counts [s]; ignored for a single step."""
_RATE = 0.06
"""Rate at which later gains are discounted [1/s]."""
_DOUBT = 2.0
"""Number of velocity variances that are compared with the squared velocity."""
_STRAY_COST = 10.0
"""Cost of a metre beyond the limit of the safety filter, per second [m²]."""
_SLACK = 0.1
"""Distance beyond the limit at which the cost starts [m], since the exact filter permits slightly more."""

_CELLS = 3.5
"""Largest number of coarse cells in the sensor's range; so at most `WINDOW` in a line across its disc."""
WINDOW = 8


class Ahead(NamedTuple):
    """Data shared by all candidates of a decision, from `look_ahead`."""

    step: float
    """Duration of a step [s]."""
    leg: float
    """Duration of a leg [s]."""
    v_ref: float
    """Largest speed of a candidate [m/s]."""
    margin: float
    """Safety distance to the border of Q [m]."""
    cell: float
    """Width of a coarse cell [m]."""
    x: float
    y: float
    """Lower left corner of the coarse map [m]."""
    legs: IntArray
    """Leg of each step. Shape (steps,)."""
    track: FloatArray
    """Expected positions of the UGV at the end of each step [m]. Shape (steps, 2)."""
    lack: FloatArray
    """max(C* - C, 0) now, averaged over each coarse cell. Shape (rows, columns)."""
    weight: FloatArray
    """Expected density (9) from the end of each step on, integrated over time [s]. Shape (steps, rows, columns)."""


@compiled
def leg_ticks(horizon: float, dt: float) -> int:
    """Return the duration of a leg for this horizon [ticks]."""
    return max(1, math.ceil(max(PERIOD, horizon / LEGS) / dt - 1e-9))


@compiled
def kept_time(persistence: float, time: float) -> float:
    """Return the part of a future time for which the UGV is expected to keep its velocity [s]."""
    return persistence * (1.0 - math.exp(-time / persistence))


@compiled
def expected_spread(target: Target, persistence: float, time: float) -> float:
    """Return the standard deviation per axis of the UGV's position after this time [m].

    The lost part of the velocity points in any direction, so half of its square adds to each axis.
    """
    kept = kept_time(persistence, time)
    lost = norm(target.v_x, target.v_y) * (time - kept)
    return math.sqrt(target.p_variance + target.v_variance * kept * kept + 0.5 * lost * lost)


@compiled
def expected_velocity(target: Target) -> tuple[float, float]:
    """Return the estimated velocity of the UGV [m/s], the shorter the more uncertain it is."""
    squared = target.v_x * target.v_x + target.v_y * target.v_y
    if squared == 0.0:
        return 0.0, 0.0
    share = squared / (squared + _DOUBT * target.v_variance)
    return share * target.v_x, share * target.v_y


@compiled
def copy(source: FloatArray, to: FloatArray) -> None:
    """Copy an array of the same shape; for `to[:] = source` numba would also compile the error message."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            to[i, j] = source[i, j]


@compiled
def add_density(
    weight: FloatArray, x: float, y: float, cell: float, spread: float, r_o: float, share: float
) -> None:
    """Add the density (9) around a UGV at an uncertain position.

    The density is averaged over four positions with the given variance, two offset along each axis.

    Args:
        weight: Changed in place. Shape (rows, columns).
        x, y: Centre of the first cell relative to the UGV's expected position [m].
        cell: Width of a cell [m].
        spread: Standard deviation per axis [m].
        r_o: Radius of the density [m].
        share: Weight of the added density.
    """
    rows, columns = weight.shape
    off, quarter = math.sqrt(2.0) * spread, 0.25 * share
    for j in range(rows):
        b = y + j * cell
        low, same, high = (b - off) * (b - off), b * b, (b + off) * (b + off)
        line = weight[j]
        for i in range(columns):
            a = x + i * cell
            left, right = (a - off) * (a - off), (a + off) * (a + off)
            line[i] += quarter * (
                (density(left + same, r_o) + density(right + same, r_o))
                + (density(a * a + low, r_o) + density(a * a + high, r_o))
            )


@compiled
def add_lack(
    lack: FloatArray, coverage: FloatArray, desired: float, column: int, row: int, ratio: int
) -> None:
    """Add max(C* - C, 0), averaged over squares of `ratio` by `ratio` cells.

    Outside the area nothing is lacking.

    Args:
        lack: Changed in place. Shape (rows, columns).
        coverage: C on the grid. Shape (rows, columns).
        desired: C*.
        column, row: Index of the first square, from the grid's corner.
        ratio: Cells per square in each direction.
    """
    rows, columns = coverage.shape
    share = 1.0 / (ratio * ratio)
    for b in range(lack.shape[0]):
        for j in range(max(0, (row + b) * ratio), min(rows, (row + b + 1) * ratio)):
            for a in range(lack.shape[1]):
                first, end = max(0, (column + a) * ratio), min(columns, (column + a + 1) * ratio)
                total = 0.0
                for i in range(first, end):
                    total += max(0.0, desired - coverage[j, i])
                lack[b, a] += total * share


@compiled
def look_ahead(
    uav: UavParameters,
    horizon: float,
    v_ref: float,
    coverage: FloatArray,
    tick: int,
    target: Target,
    persistence: float,
) -> Ahead:
    """Compute the data shared by all candidates of a decision.

    Args:
        uav: Constants of the UAV.
        horizon: Prediction horizon [s].
        v_ref: Largest speed of a candidate [m/s].
        coverage: The UAV's own coverage map C. Shape (rows, columns).
        tick: Current tick.
        target: Estimate of the UGV.
        persistence: Time for which the UGV keeps a velocity [s].
    """
    steps = max(1, min(STEPS, math.ceil(horizon / PERIOD - 1e-9)))
    step = horizon / steps
    tail = math.ceil(_TAIL / step - 1e-9) if steps > 1 else 0
    v_x, v_y = expected_velocity(target)
    kept = kept_time(persistence, horizon)
    way_x, way_y = clip_norm(kept * v_x, kept * v_y, 2.0 * uav.density_radius)
    ratio = max(1, math.ceil(uav.sensor.reach / (_CELLS * uav.cell) - 1e-9))
    cell = ratio * uav.cell
    size = math.ceil((2.0 * uav.density_radius + max(abs(way_x), abs(way_y))) / cell) + 2
    size = max(size, WINDOW)
    column = math.floor((target.p_x + 0.5 * way_x) / cell - 0.5 * size)
    row = math.floor((target.p_y + 0.5 * way_y) / cell - 0.5 * size)
    lack, total = np.zeros((size, size)), np.zeros((size, size))
    add_lack(lack, coverage, uav.desired_coverage, column, row, ratio)
    weight, track = np.empty((steps, size, size)), np.empty((steps, 2))
    legs, leg = np.empty(steps, dtype=np.int64), leg_ticks(horizon, uav.dt)
    for k in range(steps + tail - 1, -1, -1):
        time = (k + 1) * step
        kept, spread = kept_time(persistence, time), expected_spread(target, persistence, time)
        g_x = min(max(target.p_x + kept * v_x, 0.0), uav.width)
        g_y = min(max(target.p_y + kept * v_y, 0.0), uav.height)
        x, y = (column + 0.5) * cell - g_x, (row + 0.5) * cell - g_y
        add_density(total, x, y, cell, spread, uav.density_radius, step * math.exp(-_RATE * time))
        if k < steps:
            copy(total, weight[k])
            track[k, 0], track[k, 1] = g_x, g_y
            legs[k] = int((tick + (k + 0.5) * step / uav.dt) / leg) - tick // leg
    return Ahead(
        step,
        leg * uav.dt,
        v_ref,
        border_margin(uav, v_ref),
        cell,
        column * cell,
        row * cell,
        legs,
        track,
        lack,
        weight,
    )


@compiled
def fly_step(
    own: Motion, w_x: float, w_y: float, u_max: float, step: float
) -> tuple[Motion, float, float]:
    """Advance the UAV by one step towards a velocity, at maximum acceleration until it is reached: (1).

    Returns:
        The state at the end of the step, and the midpoint of its path [m].
    """
    d_x, d_y = clip_norm(w_x - own.v_x, w_y - own.v_y, u_max * step)
    turning = norm(d_x, d_y) / u_max
    w_x, w_y = own.v_x + d_x, own.v_y + d_y
    x = own.p_x + w_x * step - 0.5 * d_x * turning
    y = own.p_y + w_y * step - 0.5 * d_y * turning
    return Motion(x, y, w_x, w_y), 0.5 * (own.p_x + x), 0.5 * (own.p_y + y)


@compiled
def strayed(uav: UavParameters, margin: float, own: Motion, g_x: float, g_y: float) -> float:
    """Return the distance of a state beyond the limit of the safety filter and beyond the border margin [m].

    Whatever the UGV does, the filter must be able to stop the UAV while the UGV is visible: as in (18), with the UAV's
    current outward velocity instead of its maximum speed.
    """
    x, y = own.p_x - g_x, own.p_y - g_y
    distance = norm(x, y)
    outward = max(0.0, (x * own.v_x + y * own.v_y) / distance) if distance > 0.0 else 0.0
    over = max(
        0.0,
        distance
        + stopping_distance(outward + uav.target_max_speed, uav.max_acceleration)
        - uav.max_distance
        - _SLACK,
    )
    inside = min(own.p_x, uav.width - own.p_x, own.p_y, uav.height - own.p_y)
    return over + max(0.0, margin - inside)


@compiled
def worth(
    uav: UavParameters,
    ahead: Ahead,
    own: Motion,
    motion: FloatArray,
    lack: FloatArray,
    gains: FloatArray,
) -> float:
    r"""Return the reduction of the expected integral of e(t) by a candidate, minus its cost [m² s].

    Each step is credited at once with its gain over all later times, so it changes only the sensor's disc:

    $$ \sum_k \int \left[ h(C^* - C_{k-1}) - h(C^* - C_k) \right] \Phi_k\, dq $$

    with $\Phi_k$ the density that remains after step k, `Ahead.weight`.

    Args:
        uav: Constants of the UAV.
        ahead: Data from `look_ahead`.
        own: State of the UAV.
        motion: Velocity of each leg [m/s]. Shape (any, 2).
        lack: Work array of the shape of `ahead.lack`.
        gains: Work array. Shape (8,).
    """
    step, cell = ahead.step, ahead.cell
    size, width = (
        lack.shape[0],
        gains.size,
    )  # not constants, or numba would not vectorize the loop over cells
    for j in range(size):
        row, now = lack[j], ahead.lack[j]
        for i in range(size):
            row[i] = now[i]
    for n in range(width):
        gains[n] = 0.0
    cost = 0.0
    for k in range(ahead.legs.size):
        leg = ahead.legs[k]
        own, x, y = fly_step(own, motion[leg, 0], motion[leg, 1], uav.max_acceleration, step)
        cost += (
            step
            * _STRAY_COST
            * strayed(uav, ahead.margin, own, ahead.track[k, 0], ahead.track[k, 1])
        )
        i = min(max(math.floor((x - uav.sensor.reach - ahead.x) / cell), 0), size - width)
        first = max(math.floor((y - uav.sensor.reach - ahead.y) / cell), 0)
        end = min(math.floor((y + uav.sensor.reach - ahead.y) / cell) + 1, size)
        left = ahead.x + (i + 0.5) * cell - x
        for j in range(first, end):
            up = ahead.y + (j + 0.5) * cell - y
            row, weight = lack[j, i : i + width], ahead.weight[k, j, i : i + width]
            for n in range(width):
                off = left + n * cell
                quality = sensor_quality(uav.sensor, off * off + up * up) * step
                before = row[n]
                seen = quality if quality < before else before
                row[n] = before - seen
                gains[n] += weight[n] * seen * (before + before - seen)
    total = 0.0
    for n in range(width):
        total += gains[n]
    return total * cell * cell - cost
