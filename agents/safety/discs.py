"""Bounds on the UGV's position: each measurement confines it to a disc that grows with time.

Positions in the world's frame [m], times in ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, record_type
from sim.models.safety import SafetyBounds
from sim.models.vehicles import State, norm

KEPT = 16
"""Number of kept discs: the newest, and those with the tightest bounds on the distance."""

MOST_KEPT = 1_000_000
"""Largest number of ticks for which own positions are kept; older detections are unusable."""

NEVER = -1
"""Tick of an empty row."""

MARGIN = 1e-5
"""Margin subtracted from every radius [m], larger than all rounding errors together."""

AS_EXPECTED = 1e-10
"""Largest deviation from the expected state that counts as none [m, m/s].

The prediction starts from the current state, so a lost command is either detected at once or has no consequence. A
thousand ticks of this deviation are less than `MARGIN`.
"""

_NESTED = 1e-6
"""Tolerance for nested discs [m]: they are not intersected, since the formula for the corners would divide by it."""

_TOUCHING = 1e-9
"""Gap up to which discs count as touching [m], so that rounding does not decide whether they meet."""


class Disc(NamedTuple):
    """Disc that certainly contained the UGV at a tick; before and after it, the radius grows at v_g."""

    x: float
    y: float
    """Centre [m]."""
    radius: float
    """Radius at the tick [m]."""
    tick: int
    """Tick of the measurement; NEVER: the row is empty."""


class KnownDiscs(NamedTuple):
    """Discs that certainly contain the UGV."""

    newest: Disc
    """Disc of the newest measurement."""
    nearest: Disc
    """Disc of the measurement with the least bound."""
    end: Disc
    """Disc around the end of the last plan; its radius is infinite before the first."""
    single: bool
    """True if the newest measurement also has the least bound."""


def no_discs() -> RecordArray:
    """Return empty rows of `Disc`. Shape (KEPT,)."""
    discs = np.zeros(KEPT, dtype=record_type(Disc))
    discs["tick"] = NEVER
    return discs


@compiled
def drift(bounds: SafetyBounds, ticks: int) -> float:
    """Return the largest distance that the UGV travels in this number of ticks [m]."""
    return bounds.v_g * (ticks * bounds.dt)


@compiled
def disc_in(discs: RecordArray, row: int) -> Disc:
    """Return the disc in a row."""
    disc = discs[row]
    return Disc(disc.x, disc.y, disc.radius, disc.tick)


@compiled
def radius_at(bounds: SafetyBounds, disc: Disc, tick: int) -> float:
    """Return the radius of a disc at a tick, before or after the disc's own [m]."""
    return disc.radius + drift(bounds, abs(tick - disc.tick))


@compiled
def bound_of(
    bounds: SafetyBounds, discs: RecordArray, row: int, tick: int, x: float, y: float
) -> float:
    """Return an upper bound of the distance from (x, y) to the UGV at a tick [m], by one measurement."""
    disc = discs[row]
    return norm(x - disc.x, y - disc.y) + radius_at(bounds, disc, tick)


@compiled
def certified_distance(
    bounds: SafetyBounds, discs: RecordArray, tick: int, x: float, y: float
) -> float:
    r"""Return an upper bound of the true distance [m].

    $$ d_{cert} = \min_i \|p_a - z_i\| + \epsilon + 2 w + v_g (t - t_i) $$

    One w is the current tracking error, the other the tracking error at the detection. Infinite without measurements.

    Args:
        bounds: Bounds of the filter.
        discs: Kept discs. Shape (rows,).
        tick: Current tick.
        x, y: Reference position of the UAV [m].
    """
    k = nearest(bounds, discs, tick, x, y)
    if k < 0:
        return math.inf
    return bounds.max_tracking_error + bound_of(bounds, discs, k, tick, x, y)


@compiled
def nearest(bounds: SafetyBounds, discs: RecordArray, tick: int, x: float, y: float) -> int:
    """Return the row with the least bound; -1 without measurements."""
    least, found = math.inf, -1
    for k in range(discs.shape[0]):
        if discs[k].tick != NEVER:
            bound = bound_of(bounds, discs, k, tick, x, y)
            if bound < least:
                least, found = bound, k
    return found


@compiled
def newest_disc(discs: RecordArray) -> int:
    """Return the row of the newest measurement; -1 without measurements."""
    last, found = NEVER, -1
    for k in range(discs.shape[0]):
        if discs[k].tick > last:
            last, found = discs[k].tick, k
    return found


@compiled
def add_disc(
    bounds: SafetyBounds, discs: RecordArray, new: Disc, tick: int, p_x: float, p_y: float
) -> bool:
    r"""Add the disc of a measurement to the kept ones, in any order of arrival.

    A disc that contains another is dropped: it can never again give the least bound. If all rows are occupied, the disc
    with the largest bound at the UAV's position is dropped, but never the newest. A subset of the measurements still
    gives a valid bound.

    Args:
        bounds: Bounds of the filter.
        discs: Kept discs, changed in place. Shape (rows,).
        new: Disc around the measured position: own position at the detection minus the detected p_a - p_g. With walls
            it is clipped to the area, which brings it nearer to every point inside.
        tick: Current tick.
        p_x, p_y: Current position of the UAV [m].

    Returns:
        True if it is consistent with the others: no two may be farther apart than $2\epsilon + v_g |t_i - t_j|$.
        Otherwise eps or v_g exceeds its declared value.
    """
    agrees, row, worst, largest = True, -1, -1, -math.inf
    newest = newest_disc(discs)
    dominated = False
    for k in range(discs.shape[0]):
        kept = discs[k]
        if kept.tick == NEVER:
            row = k
            continue
        apart, driven = norm(kept.x - new.x, kept.y - new.y), drift(bounds, new.tick - kept.tick)
        if apart > 2.0 * bounds.placed_error + abs(driven) + MARGIN:
            agrees = False
        if apart <= driven and new.tick > kept.tick:  # the kept disc contains the new one
            discs[k].tick = NEVER
            row = k
        elif apart <= -driven:
            dominated = True
        else:
            bound = bound_of(bounds, discs, k, tick, p_x, p_y)
            if bound > largest and (k != newest or new.tick > kept.tick):
                worst, largest = k, bound
    if dominated:
        return agrees
    if row < 0:
        new_bound = norm(p_x - new.x, p_y - new.y) + new.radius + drift(bounds, tick - new.tick)
        if worst < 0 or (new_bound >= largest and new.tick <= discs[newest].tick):
            return agrees
        row = worst
    disc = discs[row]
    disc.x, disc.y, disc.radius, disc.tick = new.x, new.y, new.radius, new.tick
    return agrees


@compiled
def known_discs(
    bounds: SafetyBounds, discs: RecordArray, end: Disc, newest: int, tick: int, own: State
) -> KnownDiscs:
    """Return the discs that best bound the distance from a state at a tick.

    Args:
        bounds: Bounds of the filter.
        discs: Kept discs. Shape (rows,).
        end: Disc around the end of the last plan.
        newest: Row of the newest measurement.
        tick: Tick of the state.
        own: State of the UAV at that tick.
    """
    near = nearest(bounds, discs, tick, own.p_x, own.p_y)
    return KnownDiscs(disc_in(discs, newest), disc_in(discs, near), end, near == newest)


@compiled
def farthest(
    bounds: SafetyBounds, known: KnownDiscs, tick: int, x: float, y: float, enough: float
) -> float:
    """Return an upper bound of the distance from (x, y) to the UGV at a tick [m], from all known discs.

    Args:
        bounds: Bounds of the filter.
        known: Discs that contain the UGV.
        tick: Tick of the bound.
        x, y: Position from which the distance is bounded [m].
        enough: Bound that needs no further tightening [m].
    """
    n, e, b = known.newest, known.end, known.nearest
    n_r = radius_at(bounds, n, tick)
    bound: float = norm(x - n.x, y - n.y) + n_r
    if bound <= enough:
        return bound
    e_r = radius_at(bounds, e, tick)
    bound = min(bound, lens_distance(x, y, n.x, n.y, n_r, e.x, e.y, e_r))
    if bound <= enough or known.single:
        return bound
    b_r = radius_at(bounds, b, tick)
    bound = min(bound, lens_distance(x, y, n.x, n.y, n_r, b.x, b.y, b_r))
    return min(bound, lens_distance(x, y, b.x, b.y, b_r, e.x, e.y, e_r))


@compiled
def lens_distance(
    p_x: float, p_y: float, a_x: float, a_y: float, r_a: float, b_x: float, b_y: float, r_b: float
) -> float:
    """Return the largest distance from p to a point in the intersection of two discs [m].

    The farthest common point is the far point of one disc if it lies in the other, else a corner of the lens. For discs
    that touch within rounding, it is the point of contact. Discs that do not meet give the smaller of the two bounds:
    no UGV can be in both, so an assumption is violated. An infinite radius means no disc.

    Args:
        p_x, p_y: Point p [m].
        a_x, a_y, r_a: Centre and radius of the first disc [m].
        b_x, b_y, r_b: Centre and radius of the second disc [m].
    """
    d_a, d_b = norm(p_x - a_x, p_y - a_y), norm(p_x - b_x, p_y - b_y)
    x, y = b_x - a_x, b_y - a_y
    gap = norm(x, y)
    least = min(d_a + r_a, d_b + r_b)
    if gap <= abs(r_a - r_b) + _NESTED or gap > r_a + r_b + _TOUCHING or d_a == 0.0 or d_b == 0.0:
        return least
    s = r_a / d_a
    if norm(a_x + s * (a_x - p_x) - b_x, a_y + s * (a_y - p_y) - b_y) <= r_b:
        return d_a + r_a
    s = r_b / d_b
    if norm(b_x + s * (b_x - p_x) - a_x, b_y + s * (b_y - p_y) - a_y) <= r_a:
        return d_b + r_b
    along = 0.5 * (gap + (r_a * r_a - r_b * r_b) / gap)
    across = math.sqrt(max(0.0, r_a * r_a - along * along))
    c_x, c_y = a_x + x / gap * along - p_x, a_y + y / gap * along - p_y
    n_x, n_y = -y / gap * across, x / gap * across
    return min(least, max(norm(c_x + n_x, c_y + n_y), norm(c_x - n_x, c_y - n_y)))
