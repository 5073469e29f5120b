"""Position of the UGV by its measurements: each puts it into a disc that grows with time.

Positions in the world's frame [m], times in ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, record_type
from sim.models.safety import SafetyBounds
from sim.models.vehicles import Motion, norm

KEPT = 16
"""Number of discs that are kept: the newest, and those that bound the distance best."""

MOST_KEPT = 1_000_000
"""Ticks for which own positions are kept at most, and after which no detection is of use."""

NEVER = -1
"""Tick of an empty row."""

MARGIN = 1e-5
"""Taken off every radius [m], so that rounding changes no answer of the proof: more than all of its errors together."""

AS_EXPECTED = 1e-10
"""A state nearer than this [m, m/s] to the expected one is that. The prediction starts from the state, so that a lost
command is seen at once or has no consequence; a thousand ticks of this are less than `MARGIN`."""

_NESTED = 1e-6
"""Discs that hold each other but for this [m] are not intersected: the formula of the corners would divide by it."""

_TOUCHING = 1e-9
"""Discs that are no farther apart than this [m] touch: whether they meet would be decided by rounding."""


class Disc(NamedTuple):
    """Disc in which the UGV surely was at a tick; from then on, and before, it grows at v_g."""

    x: float
    y: float
    """Centre [m]."""
    radius: float
    """At the tick [m]."""
    tick: int
    """NEVER: the row is empty."""


class KnownDiscs(NamedTuple):
    """Discs, each of which surely holds the UGV."""

    newest: Disc
    """Of the newest measurement."""
    nearest: Disc
    """Of the measurement with the least bound."""
    end: Disc
    """Around the end of the last plan; its radius is infinite before the first."""
    single: bool
    """True if the newest measurement is also the nearest."""


def no_discs() -> RecordArray:
    """Return empty rows of `Disc`, for those that are kept. Shape (KEPT,)."""
    discs = np.zeros(KEPT, dtype=record_type(Disc))
    discs["tick"] = NEVER
    return discs


@compiled
def drift(bounds: SafetyBounds, ticks: int) -> float:
    """Return the longest way of the UGV in this number of ticks [m]."""
    return bounds.v_g * (ticks * bounds.dt)


@compiled
def disc_in(discs: RecordArray, row: int) -> Disc:
    """Return the disc in a row."""
    disc = discs[row]
    return Disc(disc.x, disc.y, disc.radius, disc.tick)


@compiled
def radius_at(bounds: SafetyBounds, disc: Disc, tick: int) -> float:
    """Return the radius of a disc that holds the UGV at this tick [m]; also at one before the disc's own."""
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

    One w is the tracking error now, the other that at the detection. Infinite without any measurement.

    Args:
        bounds: Bounds of the filter.
        discs: As kept. (rows,)
        tick: Now.
        x, y: Reference position of the UAV [m].
    """
    k = nearest(bounds, discs, tick, x, y)
    if k < 0:
        return math.inf
    return bounds.max_tracking_error + bound_of(bounds, discs, k, tick, x, y)


@compiled
def nearest(bounds: SafetyBounds, discs: RecordArray, tick: int, x: float, y: float) -> int:
    """Return the row whose bound is least; -1 if there is no measurement."""
    least, found = math.inf, -1
    for k in range(discs.shape[0]):
        if discs[k].tick != NEVER:
            bound = bound_of(bounds, discs, k, tick, x, y)
            if bound < least:
                least, found = bound, k
    return found


@compiled
def newest_disc(discs: RecordArray) -> int:
    """Return the row of the newest measurement; -1 if there is none."""
    last, found = NEVER, -1
    for k in range(discs.shape[0]):
        if discs[k].tick > last:
            last, found = discs[k].tick, k
    return found


@compiled
def add_disc(
    bounds: SafetyBounds, discs: RecordArray, new: Disc, tick: int, p_x: float, p_y: float
) -> bool:
    r"""Add the disc of a measurement to those that are kept, in any order of arrival.

    One that holds another is dropped: it can never again give the least bound. If there is no room, the one with the
    largest bound at the UAV's position goes, but never the newest. A subset of measurements bounds the distance as
    well.

    Args:
        bounds: Bounds of the filter.
        discs: Kept so far, changed in place. (rows,)
        new: The disc around the measured position: own position at the detection less the detected p_a - p_g; where
            there are walls, clipped to the area, which brings it nearer to every point in it.
        tick: Now.
        p_x, p_y: Position of the UAV now [m].

    Returns:
        True if it agrees with the others: no two may be farther apart than $2\epsilon + v_g |t_i - t_j|$. If it
        does not, eps or v_g is not what was declared.
    """
    agrees, place, worst, largest = True, -1, -1, -math.inf
    newest = newest_disc(discs)
    dominated = False
    for k in range(discs.shape[0]):
        kept = discs[k]
        if kept.tick == NEVER:
            place = k
            continue
        apart, driven = norm(kept.x - new.x, kept.y - new.y), drift(bounds, new.tick - kept.tick)
        if apart > 2.0 * bounds.placed_error + abs(driven) + MARGIN:
            agrees = False
        if apart <= driven and new.tick > kept.tick:  # its disc holds the new one
            discs[k].tick = NEVER
            place = k
        elif apart <= -driven:
            dominated = True
        else:
            bound = bound_of(bounds, discs, k, tick, p_x, p_y)
            if bound > largest and (k != newest or new.tick > kept.tick):
                worst, largest = k, bound
    if dominated:
        return agrees
    if place < 0:
        own = norm(p_x - new.x, p_y - new.y) + new.radius + drift(bounds, tick - new.tick)
        if worst < 0 or (own >= largest and new.tick <= discs[newest].tick):
            return agrees
        place = worst
    row = discs[place]
    row.x, row.y, row.radius, row.tick = new.x, new.y, new.radius, new.tick
    return agrees


@compiled
def known_discs(
    bounds: SafetyBounds, discs: RecordArray, end: Disc, newest: int, tick: int, here: Motion
) -> KnownDiscs:
    """Return the discs that bound the distance from a state at this tick best.

    Args:
        bounds: Bounds of the filter.
        discs: As kept. (rows,)
        end: Around the end of the last plan.
        newest: Row of the newest measurement.
        tick: Tick of the state.
        here: State of the UAV then.
    """
    near = nearest(bounds, discs, tick, here.p_x, here.p_y)
    return KnownDiscs(disc_in(discs, newest), disc_in(discs, near), end, near == newest)


@compiled
def farthest(
    bounds: SafetyBounds, known: KnownDiscs, tick: int, x: float, y: float, enough: float
) -> float:
    """Return an upper bound of the distance from (x, y) to the UGV at a tick [m], from all that is known.

    Args:
        bounds: Bounds of the filter.
        known: The discs that hold the UGV.
        tick: Tick of the bound.
        x, y: Position from which the distance is bounded [m].
        enough: A bound that is not more than this need not be made tighter [m].
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
    """Return the largest distance from p of a point in two discs' intersection [m].

    Their farthest common point is the far point of one disc if that lies in the other, else a corner of the lens; of
    discs that touch, but for rounding, the point where they do. Discs that do not meet (no UGV can be in both: an
    assumption is broken) give the smaller of the two bounds; an infinite radius is no disc.

    Args:
        p_x, p_y: From where [m].
        a_x, a_y, r_a: Centre and radius of one disc [m].
        b_x, b_y, r_b: Of the other.
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
