"""Expectations of the law `lookahead` for the next seconds: docs/explanation/lookahead.md.

Positions in the world's frame [m], velocities [m/s], times [s] except for ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.laws.common import border_margin
from agents.uav_parameters import Target, UavParameters
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.models.field import density
from sim.models.vehicles import clip_norm, norm

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
    ratio = max(1, math.ceil(uav.sensor.sensing_range / (_CELLS * uav.cell) - 1e-9))
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
