"""What detections tell of the UGV: each puts it into a disc that grows with time. World frame [m], times [s]."""

import math

import numpy as np

from sim.kernels.compile import FloatArray, compiled
from sim.models.vehicles import norm

KEPT = 16
"""Detections that are kept: the newest, and those that bound the distance best."""

MARGIN = 1e-5
"""Taken off every radius [m], so that rounding changes no answer of the proof: more than all of its errors together."""

_NESTED = 1e-6
"""Discs that hold each other but for this [m] are not intersected: the formula of the corners would divide by it."""

_TOUCHING = 1e-9
"""Discs that are no farther apart than this [m] touch: whether they meet would be decided by rounding."""


@compiled
def no_detections() -> FloatArray:
    """Room for the detections that are kept, none yet. Shape (KEPT, 3): where [m], and when taken [s]."""
    kept = np.zeros((KEPT, 3))
    kept[:, 2] = -math.inf
    return kept


@compiled
def certified_distance(
    p_x: float, p_y: float, t: float, detections: FloatArray, eps: float, v_g: float
) -> float:
    r"""Upper bound of the true distance [m], $d_{cert} = \min_i \|p_a - z_i\| + \epsilon + v_g (t - t_i)$.

    Infinite without any.

    Args:
        p_x, p_y: Position of the UAV [m].
        t: Time at which it is there [s].
        detections: Detected positions of the UGV [m] and when they were taken [s], -inf where there is none. (rows, 3)
        eps: Largest error [m].
        v_g: Largest speed of the UGV [m/s].
    """
    k = nearest(p_x, p_y, t, detections, eps, v_g)
    if k < 0:
        return math.inf
    bound: float = (
        norm(p_x - detections[k, 0], p_y - detections[k, 1]) + eps + v_g * (t - detections[k, 2])
    )
    return bound


@compiled
def nearest(
    p_x: float, p_y: float, t: float, detections: FloatArray, eps: float, v_g: float
) -> int:
    """The row whose bound is least; -1 if there is no detection."""
    least, found = math.inf, -1
    for k in range(detections.shape[0]):
        if detections[k, 2] > -math.inf:
            bound = (
                norm(p_x - detections[k, 0], p_y - detections[k, 1])
                + eps
                + v_g * (t - detections[k, 2])
            )
            if bound < least:
                least, found = bound, k
    return found


@compiled
def newest_detection(detections: FloatArray) -> int:
    """The row of the detection that was taken last; -1 if there is none."""
    last, found = -math.inf, -1
    for k in range(detections.shape[0]):
        if detections[k, 2] > last:
            last, found = detections[k, 2], k
    return found


@compiled
def keep_detection(
    detections: FloatArray,
    z_x: float,
    z_y: float,
    t_z: float,
    t: float,
    p_x: float,
    p_y: float,
    eps: float,
    v_g: float,
) -> bool:
    r"""Take a detection that has arrived into the ones that are kept, in any order of arrival.

    One whose disc holds another's is dropped: it can never again give the least bound. If there is no room, the
    one with the
    largest bound at the UAV's position goes, but never the newest. A subset of detections bounds the distance as well.

    Args:
        detections: Kept so far, changed in place. (rows, 3)
        z_x, z_y: Where the UGV was detected [m]: own position when it was taken less the measured p_a - p_g; where
        there are
            walls, clipped to the area, which brings it nearer to every point in it.
        t_z: When it was taken [s].
        t: Now [s].
        p_x, p_y: Position of the UAV now [m].
        eps: Largest error [m].
        v_g: Largest speed of the UGV [m/s].

    Returns:
        Whether it agrees with the others: no two may be farther apart than $2\epsilon + v_g |t_i - t_j|$. If it
        does not, eps or v_g is not what was declared.
    """
    agrees, place, worst, largest = True, -1, -1, -math.inf
    newest = newest_detection(detections)
    dominated = False
    for k in range(detections.shape[0]):
        t_k = detections[k, 2]
        if t_k == -math.inf:
            place = k
            continue
        apart, drift = norm(detections[k, 0] - z_x, detections[k, 1] - z_y), v_g * (t_z - t_k)
        if apart > 2.0 * eps + abs(drift) + MARGIN:
            agrees = False
        if apart <= drift:  # its disc holds the new one
            detections[k, 2] = -math.inf
            place = k
        elif apart <= -drift:
            dominated = True
        else:
            bound = norm(p_x - detections[k, 0], p_y - detections[k, 1]) + eps + v_g * (t - t_k)
            if bound > largest and (k != newest or t_z > t_k):
                worst, largest = k, bound
    if dominated:
        return agrees
    if place < 0:
        own = norm(p_x - z_x, p_y - z_y) + eps + v_g * (t - t_z)
        last = detections[newest, 2]
        if worst < 0 or (own >= largest and t_z <= last):
            return agrees
        place = worst
    detections[place, 0], detections[place, 1], detections[place, 2] = z_x, z_y, t_z
    return agrees


@compiled
def lens_distance(
    p_x: float, p_y: float, a_x: float, a_y: float, r_a: float, b_x: float, b_y: float, r_b: float
) -> float:
    """How far a point of two discs' intersection can be from p [m]: their farthest common point, exactly.

    It is the far point of one disc if that lies in the other, else a corner of the lens; of discs that touch, but
    for rounding,
    the point where they do. Discs that do not meet (no UGV can be in both: an assumption is broken) give the
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
    c_x, c_y, n_x, n_y = (
        a_x + x / gap * along - p_x,
        a_y + y / gap * along - p_y,
        -y / gap * across,
        x / gap * across,
    )
    return min(least, max(norm(c_x + n_x, c_y + n_y), norm(c_x - n_x, c_y - n_y)))
