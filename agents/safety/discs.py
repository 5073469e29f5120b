"""The UGV's place by its detections: each puts it into a disc that grows with time. World frame [m], times in ticks."""

import math
from typing import NamedTuple

import numpy as np

from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, record_type
from sim.models.safety import SafetyBounds
from sim.models.vehicles import norm

KEPT = 16
"""Detections that are kept: the newest, and those that bound the distance best."""

MOST_KEPT = 1_000_000
"""Ticks for which own positions are kept at most, and after which no detection is of use."""

NEVER = -1
"""The tick of what has not been: of an empty row of detections, of a place in a track where nothing was noted."""

MARGIN = 1e-5
"""Taken off every radius [m], so that rounding changes no answer of the proof: more than all of its errors together."""

AS_EXPECTED = 1e-10
"""A state nearer than this [m, m/s] to the expected one is that. The course goes on from the state, so that a lost
command is seen at once or has no consequence; a thousand ticks of this are less than `MARGIN`."""

_NESTED = 1e-6
"""Discs that hold each other but for this [m] are not intersected: the formula of the corners would divide by it."""

_TOUCHING = 1e-9
"""Discs that are no farther apart than this [m] touch: whether they meet would be decided by rounding."""


class KeptDetection(NamedTuple):
    """A row of the detections that are kept."""

    x: float
    y: float
    """The place of the detected UGV [m]."""
    taken: int
    """In which tick; NEVER: the row is empty."""


class Disc(NamedTuple):
    """The UGV was surely in here at that tick; from then on, and before, the disc grows at v_g."""

    x: float
    y: float
    """Centre [m]."""
    radius: float
    """At the tick [m]."""
    tick: int


def no_detections() -> RecordArray:
    """Room for the detections that are kept, none yet: rows of `KeptDetection`. Shape (KEPT,)."""
    kept = np.zeros(KEPT, dtype=record_type(KeptDetection))
    kept["taken"] = NEVER
    return kept


@compiled
def drift(promise: SafetyBounds, ticks: int) -> float:
    """The longest way of the UGV in so many ticks [m]."""
    return promise.v_g * (ticks * promise.dt)


@compiled
def disc_of(promise: SafetyBounds, detections: RecordArray, row: int) -> Disc:
    """The disc that a detection puts the UGV into."""
    found = detections[row]
    return Disc(found.x, found.y, promise.placed_error, found.taken)


@compiled
def radius_at(promise: SafetyBounds, disc: Disc, tick: int) -> float:
    """Radius of a disc that holds the UGV at this tick [m]; also at one before the disc's own."""
    return disc.radius + drift(promise, abs(tick - disc.tick))


@compiled
def bound_of(
    promise: SafetyBounds, detections: RecordArray, row: int, tick: int, x: float, y: float
) -> float:
    """Upper bound of the distance from (x, y) to the UGV at a tick [m], by one detection."""
    disc = disc_of(promise, detections, row)
    return norm(x - disc.x, y - disc.y) + radius_at(promise, disc, tick)


@compiled
def certified_distance(
    promise: SafetyBounds, detections: RecordArray, tick: int, x: float, y: float
) -> float:
    r"""Upper bound of the true distance [m], $d_{cert} = \min_i \|p_a - z_i\| + \epsilon + 2 w + v_g (t - t_i)$.

    One w is that of where the UAV is now, one of where it was at the detection. Infinite without any.

    Args:
        promise: The declared numbers.
        detections: As kept. (rows,)
        tick: Now.
        x, y: Position of the UAV, as it is told [m].
    """
    k = nearest(promise, detections, tick, x, y)
    if k < 0:
        return math.inf
    return promise.max_tracking_error + bound_of(promise, detections, k, tick, x, y)


@compiled
def nearest(promise: SafetyBounds, detections: RecordArray, tick: int, x: float, y: float) -> int:
    """The row whose bound is least; -1 if there is no detection."""
    least, found = math.inf, -1
    for k in range(detections.shape[0]):
        if detections[k].taken != NEVER:
            bound = bound_of(promise, detections, k, tick, x, y)
            if bound < least:
                least, found = bound, k
    return found


@compiled
def newest_detection(detections: RecordArray) -> int:
    """The row of the detection that was taken last; -1 if there is none."""
    last, found = NEVER, -1
    for k in range(detections.shape[0]):
        if detections[k].taken > last:
            last, found = detections[k].taken, k
    return found


@compiled
def keep_detection(
    promise: SafetyBounds,
    detections: RecordArray,
    z_x: float,
    z_y: float,
    taken: int,
    tick: int,
    p_x: float,
    p_y: float,
) -> bool:
    r"""Take a detection that has arrived into the ones that are kept, in any order of arrival.

    One whose disc holds another's is dropped: it can never again give the least bound. If there is no room, the one
    with the largest bound at the UAV's position goes, but never the newest. A subset of detections bounds the
    distance as well.

    Args:
        promise: The declared numbers.
        detections: Kept so far, changed in place. (rows,)
        z_x, z_y: Where the UGV was detected [m]: own position when it was taken less the measured p_a - p_g; where
            there are walls, clipped to the area, which brings it nearer to every point in it.
        taken: The tick in which it was taken.
        tick: Now.
        p_x, p_y: Position of the UAV now [m].

    Returns:
        True if it agrees with the others: no two may be farther apart than $2\epsilon + v_g |t_i - t_j|$. If it
        does not, eps or v_g is not what was declared.
    """
    agrees, place, worst, largest = True, -1, -1, -math.inf
    newest = newest_detection(detections)
    dominated = False
    for k in range(detections.shape[0]):
        kept = detections[k]
        if kept.taken == NEVER:
            place = k
            continue
        apart, driven = norm(kept.x - z_x, kept.y - z_y), drift(promise, taken - kept.taken)
        if apart > 2.0 * promise.placed_error + abs(driven) + MARGIN:
            agrees = False
        if apart <= driven and taken > kept.taken:  # its disc holds the new one
            detections[k].taken = NEVER
            place = k
        elif apart <= -driven:
            dominated = True
        else:
            bound = bound_of(promise, detections, k, tick, p_x, p_y)
            if bound > largest and (k != newest or taken > kept.taken):
                worst, largest = k, bound
    if dominated:
        return agrees
    if place < 0:
        own = norm(p_x - z_x, p_y - z_y) + promise.placed_error + drift(promise, tick - taken)
        if worst < 0 or (own >= largest and taken <= detections[newest].taken):
            return agrees
        place = worst
    row = detections[place]
    row.x, row.y, row.taken = z_x, z_y, taken
    return agrees


@compiled
def lens_distance(
    p_x: float, p_y: float, a_x: float, a_y: float, r_a: float, b_x: float, b_y: float, r_b: float
) -> float:
    """The largest distance from p of a point in two discs' intersection [m]: their farthest common point, exactly.

    It is the far point of one disc if that lies in the other, else a corner of the lens; of discs that touch, but for
    rounding, the point where they do. Discs that do not meet (no UGV can be in both: an assumption is broken) give the
    smaller of the two bounds; an infinite radius is no disc.

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
