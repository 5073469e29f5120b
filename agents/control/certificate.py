r"""The certificate: a filter around any inner control that keeps $\|p_a - p_g\| < r_v$. Beyond Klodt 2015.

The proof is in docs/certificate.md. What is known of the UGV is a set: each detection z, taken at t_z with an error of at most
$\epsilon$, puts it into a disc of radius $\rho(t) = \epsilon + v_g (t - t_z)$ around z.
The filter always holds a **plan**: a motion of the UAV that ends at rest and is checked against those discs to its end. A
command of the inner control acts only if a plan still exists after it; else the plan acts. At a plan's end the hand-over
inequality says that the next plan exists, whatever has been detected meanwhile.

All positions in the world's frame [m], times [s], speeds [m/s], accelerations [m/s²].
"""

import functools
import math
from typing import NamedTuple

import numpy as np

from sim.compile import FloatArray, compiled
from sim.vehicles import brake, clip_norm, norm, speed_to_stop_within, step_vehicle

KEPT = 16
"""Detections that are kept: the newest, and those that bound the distance best."""

(_VALID, _TURN, _CRUISE, _BRAKE, _TURN_X, _TURN_Y, _BRAKE_X, _BRAKE_Y) = range(8)
(_P_X, _P_Y, _V_X, _V_Y, _END_X, _END_Y, _END_RADIUS, _END_TIME) = range(8, 16)
_OFF_PLAN = 16
PLAN_SIZE = 17

_REST = 1e-9
"""A vehicle slower than this [m/s] is at rest."""

_ROUNDING = 1e-12
"""Ticks by which a quotient may exceed a whole number and still be that number."""

_ON_PLAN = 1e-6
"""A state nearer than this [m, m/s] to the predicted one is the predicted one."""

_MARGIN = 1e-6
"""Taken off every radius [m], so that rounding changes no answer of the proof."""

_GRID = 0.005
"""Step of the distances [m] over which the hand-over is checked when a scenario loads, and its margin."""

_SPEEDS = (1.0, 0.6, 0.35, 0.2)
"""Shares of v_a at which a plan may return; a fast one runs too far where the way is short."""

INNER, PLAN, BEST_EFFORT = 0, 1, 2
"""Who acts: the inner control; the plan (certified); nobody certified, the filter does what it can."""

CERTIFIED, NO_DETECTION, TOO_OLD, CONTRADICTED, OFF_PLAN, NO_PLAN = range(6)
UNCERTIFIED = {
    NO_DETECTION: "no detection has arrived yet",
    TOO_OLD: "the newest detection is older than declared (age > A)",
    CONTRADICTED: "detections contradict each other: their errors are larger than eps, or the UGV is faster than v_g",
    OFF_PLAN: "the UAV is not where its commands should have brought it: one was late or lost (delay > tau_c)",
    NO_PLAN: "outside the certified set: no plan keeps the UGV within r_v from here",
}
"""Why a tick is not certified, by the code that `uncertified_reason` gives."""


class Promise(NamedTuple):
    """The declared numbers of one certificate, and the two that follow from them; from `certificate`."""

    dt: float
    """Length of a tick [s]."""
    eps: float
    """Largest error of a detection, as a vector's norm [m]."""
    age: float
    """Largest age of the newest arrived detection, A [s]."""
    delay: float
    """From the tick that a command answers to the one in which it acts, tau_c [s], a whole number of ticks."""
    r_v: float
    """Visibility radius less the margin that was asked for [m]."""
    v_a: float
    """Largest speed of the UAV [m/s]."""
    u_a: float
    """Largest acceleration of the UAV [m/s²]."""
    v_g: float
    """Largest speed of the UGV [m/s]."""
    width: float
    """Of the area with its walls, from 0 [m]; infinite: there are none on this axis."""
    height: float
    """Likewise."""
    handover: float
    """R_h: a plan may end where the UGV is surely within this [m]; NaN if there is none."""
    reach: float
    """E: and where the newest detection's own bound is at most this [m]; NaN if there is none."""


@compiled
def certified_distance(p_x: float, p_y: float, t: float, detections: FloatArray, eps: float, v_g: float) -> float:
    r"""Upper bound of the true distance [m], $d_{cert} = \min_i \|p_a - z_i\| + \epsilon + v_g (t - t_i)$; infinite without any.

    Args:
        p_x, p_y: Position of the UAV [m].
        t: Time at which it is there [s].
        detections: Detected positions of the UGV [m] and when they were taken [s], -inf where there is none. (rows, 3)
        eps: Largest error [m].
        v_g: Largest speed of the UGV [m/s].
    """
    k = _nearest(p_x, p_y, t, detections, eps, v_g)
    if k < 0:
        return math.inf
    bound: float = norm(p_x - detections[k, 0], p_y - detections[k, 1]) + eps + v_g * (t - detections[k, 2])
    return bound


@compiled
def _nearest(p_x: float, p_y: float, t: float, detections: FloatArray, eps: float, v_g: float) -> int:
    """The row whose bound is least; -1 if there is no detection."""
    least, found = math.inf, -1
    for k in range(detections.shape[0]):
        if detections[k, 2] > -math.inf:
            bound = norm(p_x - detections[k, 0], p_y - detections[k, 1]) + eps + v_g * (t - detections[k, 2])
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
    detections: FloatArray, z_x: float, z_y: float, t_z: float, t: float, p_x: float, p_y: float, eps: float, v_g: float
) -> bool:
    r"""Take a detection that has arrived into the ones that are kept, in any order of arrival.

    One whose disc holds another's is dropped: it can never again give the least bound. If there is no room, the one with the
    largest bound at the UAV's position goes, but never the newest. A subset of detections bounds the distance as well.

    Args:
        detections: Kept so far, changed in place. (rows, 3)
        z_x, z_y: Where the UGV was detected [m]: own position when it was taken less the measured p_a - p_g; where there are
            walls, clipped to the area, which brings it nearer to every point in it.
        t_z: When it was taken [s].
        t: Now [s].
        p_x, p_y: Position of the UAV now [m].
        eps: Largest error [m].
        v_g: Largest speed of the UGV [m/s].

    Returns:
        Whether it agrees with the others: no two may be farther apart than $2\epsilon + v_g |t_i - t_j|$. If it does not, eps or
        v_g is not what was declared.
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
        if apart > 2.0 * eps + abs(drift) + _MARGIN:
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
def lens_distance(p_x: float, p_y: float, a_x: float, a_y: float, r_a: float, b_x: float, b_y: float, r_b: float) -> float:
    """How far a point of two discs' intersection can be from p [m]: their farthest common point, exactly.

    It is the far point of one disc if that lies in the other, else a corner of the lens. Discs that do not meet (no UGV can be in
    both: an assumption is broken) give the smaller of the two bounds; an infinite radius is no disc.

    Args:
        p_x, p_y: From where [m].
        a_x, a_y, r_a: Centre and radius of one disc [m].
        b_x, b_y, r_b: Of the other.
    """
    d_a, d_b = norm(p_x - a_x, p_y - a_y), norm(p_x - b_x, p_y - b_y)
    x, y = b_x - a_x, b_y - a_y
    gap = norm(x, y)
    least = min(d_a + r_a, d_b + r_b)
    if gap <= abs(r_a - r_b) + _MARGIN or gap >= r_a + r_b or d_a == 0.0 or d_b == 0.0:
        return least  # one holds the other, perhaps but for a micrometre, which the formula below would divide by
    s = r_a / d_a
    if norm(a_x + s * (a_x - p_x) - b_x, a_y + s * (a_y - p_y) - b_y) <= r_b:
        return d_a + r_a
    s = r_b / d_b
    if norm(b_x + s * (b_x - p_x) - a_x, b_y + s * (b_y - p_y) - a_y) <= r_a:
        return d_b + r_b
    along = 0.5 * (gap + (r_a * r_a - r_b * r_b) / gap)
    across = math.sqrt(max(0.0, r_a * r_a - along * along))
    c_x, c_y, n_x, n_y = a_x + x / gap * along - p_x, a_y + y / gap * along - p_y, -y / gap * across, x / gap * across
    return min(least, max(norm(c_x + n_x, c_y + n_y), norm(c_x - n_x, c_y - n_y)))


@compiled
def rest_to_rest(way: float, v_a: float, u_a: float, dt: float) -> tuple[int, int, float]:
    r"""The fastest motion of whole ticks over `way` [m] along a line, from rest to rest.

    It takes at most $way / v_a + v_a / u_a + 2 dt$.

    Returns:
        Ticks in which it speeds up (and in which it brakes), ticks at constant speed, and that speed [m/s].
    """
    if way <= 0.0:
        return 0, 0, 0.0
    full, moving = max(1, math.ceil(v_a / (u_a * dt) - _ROUNDING)), math.ceil(way / (v_a * dt) - _ROUNDING)
    if moving >= full:
        return full, moving - full, way / (moving * dt)
    half = max(1, math.ceil(math.sqrt(way / u_a) / dt - _ROUNDING))
    return half, 0, way / (half * dt)


@compiled
def handover_peak(radius: float, rho: float, way: float, turn: int, cruise: int, v_g: float, dt: float) -> float:
    """The largest distance [m] while the UAV flies from rest to a new detection, given that two discs hold the UGV at the start.

    Args:
        radius: Of the disc around the UAV, at rest [m].
        rho: Of the disc around the new detection [m].
        way: To that detection [m].
        turn, cruise: Ticks of the motion, as from `rest_to_rest`.
        v_g: Largest speed of the UGV [m/s].
        dt: Length of a tick [s].
    """
    speed = way / max(1, turn + cruise)  # metres in a tick
    peak, x, v = radius, 0.0, 0.0
    for k in range(1, 2 * turn + cruise + 1):
        w = speed * min(1.0, k / turn, (2 * turn + cruise - k) / turn)
        x, v = x + 0.5 * (v + w), w
        peak = max(peak, lens_distance(x, 0.0, 0.0, 0.0, radius, way, 0.0, rho) + v_g * k * dt)
    return peak


@compiled
def handover_reach(radius: float, eps: float, rho: float, v_a: float, u_a: float, v_g: float, dt: float) -> float:
    r"""E [m]: where the newest detection's own bound is at most this, the plan to any later one ends within `radius` in time.

    $$ E = \frac{v_a}{v_g}\left(R_h - \rho_A (1 - v_g/v_a) - v_g (v_a/u_a + 2 dt)\right) - 2 \epsilon $$

    Arguments as in `handover_radius`; `radius` is R_h [m].
    """
    if v_g == 0.0:
        return math.inf
    return v_a / v_g * (radius - rho * (1.0 - v_g / v_a) - v_g * (v_a / u_a + 2.0 * dt)) - 2.0 * eps - _MARGIN


@compiled
def handover_fits(radius: float, r_v: float, eps: float, rho: float, v_a: float, u_a: float, v_g: float, dt: float) -> bool:
    """Whether every motion from rest to a newer detection stays within r_v, if the UGV is within `radius` [m] at its start.

    Over all ways in steps of half a centimetre: between two of them the motion with the same ticks scales with the way, so
    that no point of it and no disc moves by more than a step. The farther a detection, the younger it is: way + rho <= E + 2 eps.
    Arguments as in `handover_radius`.
    """
    reach = handover_reach(radius, eps, rho, v_a, u_a, v_g, dt)
    turn, cruise = 0, 0
    for k in range(1, int((radius + rho) / _GRID) + 2):
        last_turn, last_cruise, way = turn, cruise, k * _GRID
        turn, cruise, _ = rest_to_rest(way, v_a, u_a, dt)
        rest = min(rho, reach + 2.0 * eps - way + _GRID)
        if rest < 0.0 or radius + rest < way - _GRID:
            break
        for i in range(max(1, last_turn), turn + 1):
            for j in range(last_cruise, cruise + 1):
                if handover_peak(radius, rest + _GRID, way, i, j, v_g, dt) > r_v - _GRID:
                    return False
    return True


@compiled
def handover_radius(r_v: float, eps: float, rho: float, v_a: float, u_a: float, v_g: float, dt: float) -> float:
    """R_h [m]: from rest, with the UGV surely within it, every plan to a newer detection stays within r_v; NaN if there is none.

    Downwards in steps of half a centimetre, as long as R_h <= E: the plan to a later detection ends where the next may begin. E
    falls faster than R_h, so where that fails no smaller radius helps.

    Args:
        r_v: Visibility radius [m].
        eps: Largest error of a detection [m].
        rho: Largest radius of the newest detection's disc, eps + v_g (A + tau_c) [m].
        v_a, u_a, v_g: Bounds [m/s], [m/s²], [m/s].
        dt: Length of a tick [s].
    """
    radius = r_v
    while radius > rho:
        radius -= _GRID
        if not handover_reach(radius, eps, rho, v_a, u_a, v_g, dt) >= radius:
            return math.nan
        if handover_fits(radius, r_v, eps, rho, v_a, u_a, v_g, dt):
            return radius
    return math.nan


@functools.lru_cache(maxsize=1024)
def certificate(
    *,
    r_v: float,
    v_a: float,
    u_a: float,
    v_g: float,
    dt: float,
    eps: float,
    age: float,
    delay: float = 0.0,
    margin: float = 0.0,
    width: float = math.inf,
    height: float = math.inf,
) -> Promise:
    r"""The certificate of one UAV. What fails is NaN in it and named by `check_assumptions`.

    Args:
        r_v: Visibility radius [m].
        v_a: Largest speed of the UAV [m/s].
        u_a: Its largest acceleration [m/s²].
        v_g: Largest speed of the UGV [m/s].
        dt: Length of a tick [s].
        eps: Largest error of a detection [m].
        age: Largest age of the newest arrived detection, A [s].
        delay: From the tick that a command answers to the one in which it acts [s]; rounded up to whole ticks.
        margin: Taken off r_v [m], for what the theorem does not cover (jitter and loss of commands).
        width, height: Of an area with walls [m]: plans stay in it, and `keep_detection` is given what is clipped to it.
    """
    delay = math.ceil(delay / dt - _ROUNDING) * dt
    r_v, v_a, u_a, v_g, eps = float(r_v - margin), float(v_a), float(u_a), float(v_g), float(eps)
    radius = reach = math.nan
    if all(math.isfinite(x) for x in (r_v, v_a, v_g, eps, age)) and 0.0 <= v_g < v_a and u_a > 0.0:
        rho = eps + v_g * (age + delay)
        radius = float(handover_radius(r_v, eps, rho, v_a, u_a, v_g, dt))
        reach = float(handover_reach(radius, eps, rho, v_a, u_a, v_g, dt))
    return Promise(dt, eps, float(age), delay, r_v - _MARGIN, v_a, u_a, v_g, float(width), float(height), radius, reach)


@compiled
def certified_radius(handover: float, v_a: float, u_a: float, v_g: float, dt: float, delay: float) -> float:
    r"""r_cert [m]: while d_cert is less, every inner control acts, whatever the velocity.

    $$ r_{cert} = R_h - \frac{v_a^2}{2 u_a} - \frac{v_a v_g}{u_a} - (\tfrac32 v_a + 2 v_g) dt - (v_a + v_g) \tau_c $$

    With $R_h \to r_v - v_g^2 / (2 u_a)$ this is (18) as dt and tau_c go to 0. Beyond it the filter decides by the velocity that
    the UAV really has: r_cert is for display, for tuning and for tests.

    Args:
        handover: R_h [m].
        v_a, u_a, v_g: Bounds [m/s], [m/s²], [m/s].
        dt: Length of a tick [s].
        delay: tau_c [s].
    """
    stop = 0.5 * v_a * v_a / u_a + v_a * v_g / u_a
    return handover - stop - (1.5 * v_a + 2.0 * v_g) * dt - (v_a + v_g) * delay


@compiled
def servo(
    p_x: float, p_y: float, v_x: float, v_y: float, z_x: float, z_y: float, v_a: float, u_a: float, dt: float
) -> tuple[float, float]:
    r"""To z as fast as it can still stop there, $u = clip((v^* - v_a)/dt, u_a)$, $v^* = -s (p_a - z)/\|p_a - z\|$ [m/s²].

    s is the speed from which the UAV stops at z, at most v_a. Acts where nothing is certified, as the best that can be done.
    """
    x, y = z_x - p_x, z_y - p_y
    way = norm(x, y)
    speed = min(v_a, speed_to_stop_within(way, u_a, dt)) / way if way > _REST else 0.0
    return clip_norm((speed * x - v_x) / dt, (speed * y - v_y) / dt, u_a)


@compiled
def state_ahead(
    pending: FloatArray, p_x: float, p_y: float, v_x: float, v_y: float, v_a: float, u_a: float, dt: float
) -> tuple[float, float, float, float]:
    """Position [m] and velocity [m/s] of the UAV when the next command will act, after those that are on their way.

    Args:
        pending: These commands, the oldest first [m/s²]. Shape (tau_c / dt, 2).
        p_x, p_y: Position now [m].
        v_x, v_y: Velocity now [m/s].
        v_a, u_a: Bounds [m/s], [m/s²].
        dt: Length of a tick [s].
    """
    for k in range(pending.shape[0]):
        p_x, p_y, v_x, v_y, _, _ = step_vehicle(p_x, p_y, v_x, v_y, pending[k, 0], pending[k, 1], v_a, u_a, dt)
    return p_x, p_y, v_x, v_y


@compiled
def no_detections() -> FloatArray:
    """Room for the detections that are kept, none yet. Shape (KEPT, 3): where [m], and when taken [s]."""
    kept = np.zeros((KEPT, 3))
    kept[:, 2] = -math.inf
    return kept


@compiled
def no_plan() -> FloatArray:
    """The filter's memory before its first plan. Shape (PLAN_SIZE,)."""
    plan = np.zeros(PLAN_SIZE)
    plan[_END_RADIUS] = math.inf
    return plan


@compiled
def farthest(
    promise: Promise, detections: FloatArray, plan: FloatArray, new: int, near: int, t: float, x: float, y: float, enough: float
) -> float:
    """Upper bound of the distance from (x, y) to the UGV at time t [m], from the newest disc, the nearest and the last plan's.

    Args:
        promise: The declared numbers.
        detections: As kept. (KEPT, 3)
        plan: The filter's memory, whose last plan left a disc that surely held the UGV. (PLAN_SIZE,)
        new: Row of the newest detection.
        near: Row of the one with the least bound.
        t: Time of the bound [s].
        x, y: From where [m].
        enough: A bound that is not more than this need not be made tighter [m].
    """
    c = promise
    n_x, n_y, n_r = detections[new, 0], detections[new, 1], c.eps + c.v_g * (t - detections[new, 2])
    bound: float = norm(x - n_x, y - n_y) + n_r
    if bound <= enough:
        return bound
    e_r = plan[_END_RADIUS] + c.v_g * (t - plan[_END_TIME])
    bound = min(bound, lens_distance(x, y, n_x, n_y, n_r, plan[_END_X], plan[_END_Y], e_r))
    if bound <= enough or near == new:
        return bound
    b_x, b_y, b_r = detections[near, 0], detections[near, 1], c.eps + c.v_g * (t - detections[near, 2])
    bound = min(bound, lens_distance(x, y, n_x, n_y, n_r, b_x, b_y, b_r))
    return min(bound, lens_distance(x, y, b_x, b_y, b_r, plan[_END_X], plan[_END_Y], e_r))


@compiled
def _adopt(
    plan: FloatArray,
    turn: int,
    cruise: int,
    brake_ticks: int,
    turn_x: float,
    turn_y: float,
    brake_x: float,
    brake_y: float,
    end_x: float,
    end_y: float,
    end_radius: float,
    t: float,
) -> None:
    plan[_VALID], plan[_TURN], plan[_CRUISE], plan[_BRAKE] = 1.0, turn, cruise, brake_ticks
    plan[_TURN_X], plan[_TURN_Y], plan[_BRAKE_X], plan[_BRAKE_Y] = turn_x, turn_y, brake_x, brake_y
    plan[_END_X], plan[_END_Y], plan[_END_RADIUS], plan[_END_TIME] = end_x, end_y, end_radius, t


@compiled
def _is_in_area(promise: Promise, x: float, y: float) -> bool:
    """Whether a point is within the walls. A plan never touches them: a wall would take the UAV off it."""
    c = promise
    in_width = c.width == math.inf or -_REST <= x <= c.width + _REST
    return in_width and (c.height == math.inf or -_REST <= y <= c.height + _REST)


@compiled
def _summit(p: float, v: float, a: float, duration: float) -> float:
    """Where p + v s + a s²/2 turns back within the duration; p if it does not."""
    if a == 0.0 or not 0.0 < -v / a < duration:
        return p
    return p - 0.5 * v * v / a


@compiled
def _end_radius(
    promise: Promise, detections: FloatArray, plan: FloatArray, new: int, near: int, t: float, x: float, y: float, duration: float
) -> float:
    """How far the UGV is at most from a plan's end, now [m], if the plan may end there; else infinite."""
    c = promise
    if not _is_in_area(promise, x, y):
        return math.inf
    single = norm(x - detections[new, 0], y - detections[new, 1]) + c.eps + c.v_g * (t - detections[new, 2])
    growth = c.v_g * duration
    if not single + growth <= c.reach:
        return math.inf
    bound = farthest(promise, detections, plan, new, near, t, x, y, c.handover - growth)
    return bound if bound + growth <= c.handover else math.inf


@compiled
def plan_stop(
    promise: Promise,
    detections: FloatArray,
    plan: FloatArray,
    new: int,
    near: int,
    t: float,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
) -> bool:
    """Whether the UAV may brake to a stop from this state at time t; if so, that is the plan.

    Along a straight line on which it only slows down, the bound is largest at one of the ends: the distance to a fixed point is
    convex in the way, and the way concave in time.
    """
    c = promise
    speed = norm(v_x, v_y)
    ticks = 0 if speed <= _REST else max(1, math.ceil(speed / (c.u_a * c.dt) - _ROUNDING))
    duration = ticks * c.dt
    end_x, end_y = p_x + 0.5 * v_x * duration, p_y + 0.5 * v_y * duration
    end_radius = _end_radius(promise, detections, plan, new, near, t, end_x, end_y, duration)
    if end_radius == math.inf or not _is_in_area(promise, p_x, p_y):
        return False
    if not farthest(promise, detections, plan, new, near, t, p_x, p_y, c.r_v) <= c.r_v:
        return False
    share = -1.0 / duration if ticks else 0.0
    _adopt(plan, 0, 0, ticks, 0.0, 0.0, share * v_x, share * v_y, end_x, end_y, end_radius, t)
    return True


@compiled
def _turn_is_safe(
    promise: Promise,
    detections: FloatArray,
    plan: FloatArray,
    new: int,
    near: int,
    t: float,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    a_x: float,
    a_y: float,
    ticks: int,
) -> bool:
    """Whether the bound stays within r_v, and the way within the walls, in a turn with constant acceleration.

    Ticks that the bound cannot reach r_v by, as it grows by no more than v_a + v_g, are not looked at.
    """
    c = promise
    duration = ticks * c.dt
    last_x, last_y = p_x + (v_x + 0.5 * a_x * duration) * duration, p_y + (v_y + 0.5 * a_y * duration) * duration
    if not _is_in_area(promise, last_x, last_y):
        return False
    if not _is_in_area(promise, _summit(p_x, v_x, a_x, duration), _summit(p_y, v_y, a_y, duration)):
        return False
    k = 0
    while k <= ticks:
        s = k * c.dt
        x, y = p_x + (v_x + 0.5 * a_x * s) * s, p_y + (v_y + 0.5 * a_y * s) * s
        room = c.r_v - c.v_g * s - farthest(promise, detections, plan, new, near, t, x, y, c.r_v - c.v_g * s)
        if not room >= 0.0:
            return False
        k += max(1, int(room / ((c.v_a + c.v_g) * c.dt)))
    return True


@compiled
def _plan_at_speed(
    promise: Promise,
    detections: FloatArray,
    plan: FloatArray,
    new: int,
    near: int,
    t: float,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    speed: float,
) -> bool:
    c = promise
    z_x, z_y = detections[new, 0], detections[new, 1]
    if norm(v_x, v_y) <= _REST:
        x, y = z_x - p_x, z_y - p_y
        way = norm(x, y)
        turn, cruise, speed = rest_to_rest(way, speed, c.u_a, c.dt)
        v_x, v_y, stop = 0.0, 0.0, turn
        w_x, w_y = (speed * x / way, speed * y / way) if turn else (0.0, 0.0)
    else:
        stop = max(1, math.ceil(speed / (c.u_a * c.dt) - _ROUNDING))
        q_x, q_y = p_x, p_y  # where the turn ends: found with the heading by iteration
        w_x, w_y, turn = 0.0, 0.0, 0
        for _ in range(4):
            way = norm(z_x - q_x, z_y - q_y)
            if way <= _REST:
                return False
            w_x, w_y = speed * (z_x - q_x) / way, speed * (z_y - q_y) / way
            turn = max(1, math.ceil(norm(w_x - v_x, w_y - v_y) / (c.u_a * c.dt) - _ROUNDING))
            q_x, q_y = p_x + 0.5 * (v_x + w_x) * turn * c.dt, p_y + 0.5 * (v_y + w_y) * turn * c.dt
        left = ((z_x - q_x) * w_x + (z_y - q_y) * w_y) / (speed * speed * c.dt) - 0.5 * stop  # ticks at constant speed
        if not left >= 0.0:
            return False
        cruise = int(left)
    duration = (turn + cruise + stop) * c.dt
    level = (0.5 * turn + cruise + 0.5 * stop) * c.dt
    end_x, end_y = p_x + 0.5 * v_x * turn * c.dt + w_x * level, p_y + 0.5 * v_y * turn * c.dt + w_y * level
    end_radius = _end_radius(promise, detections, plan, new, near, t, end_x, end_y, duration)
    if end_radius == math.inf:
        return False
    a_x, a_y = ((w_x - v_x) / (turn * c.dt), (w_y - v_y) / (turn * c.dt)) if turn else (0.0, 0.0)
    if not _turn_is_safe(promise, detections, plan, new, near, t, p_x, p_y, v_x, v_y, a_x, a_y, turn):
        return False
    b_x, b_y = (-w_x / (stop * c.dt), -w_y / (stop * c.dt)) if stop else (0.0, 0.0)
    _adopt(plan, turn, cruise, stop, a_x, a_y, b_x, b_y, end_x, end_y, end_radius, t)
    return True


@compiled
def plan_return(
    promise: Promise,
    detections: FloatArray,
    plan: FloatArray,
    new: int,
    near: int,
    t: float,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
) -> bool:
    """Whether the UAV may turn to the newest detection, fly there and stop, from this state at time t; if so, that is the plan.

    The turn takes the velocity along a straight line to the one that leads from the turn's end to the detection; bounds are kept,
    since both ends keep them. After it the way is straight, and the bound is largest at one of its ends.
    """
    for share in _SPEEDS:
        if _plan_at_speed(promise, detections, plan, new, near, t, p_x, p_y, v_x, v_y, share * promise.v_a):
            return True
    return False


@compiled
def _follow(plan: FloatArray, v_x: float, v_y: float, u_a: float, dt: float) -> tuple[float, float]:
    """The plan's command for this tick, which it then has behind it; at its end the UAV stays where it is."""
    if plan[_TURN] > 0.0:
        plan[_TURN] -= 1.0
        return plan[_TURN_X], plan[_TURN_Y]
    if plan[_CRUISE] > 0.0:
        plan[_CRUISE] -= 1.0
        return 0.0, 0.0
    if plan[_BRAKE] > 0.0:
        plan[_BRAKE] -= 1.0
        return plan[_BRAKE_X], plan[_BRAKE_Y]
    return brake(v_x, v_y, u_a, dt)


@compiled
def safe_control(
    promise: Promise,
    detections: FloatArray,
    plan: FloatArray,
    t: float,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    u_x: float,
    u_y: float,
) -> tuple[float, float, int]:
    """The command that acts in the tick from t on: the inner control's if a plan still exists after it, else the plan's.

    With delayed commands t, p and v are those of the tick in which this command will act: `state_ahead`.

    Args:
        promise: The declared numbers.
        detections: All that have arrived, as kept by `keep_detection`. (KEPT, 3)
        plan: The filter's memory, changed in place. (PLAN_SIZE,)
        t: When the command acts [s].
        p_x, p_y: Position of the UAV then [m].
        v_x, v_y: Its velocity then [m/s].
        u_x, u_y: What the inner control wants [m/s²].

    Returns:
        The command [m/s²], and who acts: INNER, PLAN or BEST_EFFORT.
    """
    c = promise
    new = newest_detection(detections)
    if new < 0:
        u_x, u_y = brake(v_x, v_y, c.u_a, c.dt)
        return u_x, u_y, BEST_EFFORT
    off = max(abs(p_x - plan[_P_X]), abs(p_y - plan[_P_Y]), abs(v_x - plan[_V_X]), abs(v_y - plan[_V_Y]))
    plan[_OFF_PLAN] = 0.0
    if plan[_VALID] != 0.0 and not off <= _ON_PLAN:
        plan[_VALID], plan[_OFF_PLAN] = 0.0, 1.0
    going = plan[_VALID] != 0.0 and plan[_TURN] + plan[_CRUISE] + plan[_BRAKE] > 0.0
    near = _nearest(p_x, p_y, t, detections, c.eps, c.v_g)
    w_x, w_y = clip_norm(u_x, u_y, c.u_a)
    x, y, s_x, s_y, _, _ = step_vehicle(p_x, p_y, v_x, v_y, w_x, w_y, c.v_a, c.u_a, c.dt)
    acts = PLAN
    within = plan[_VALID] != 0.0 or farthest(promise, detections, plan, new, near, t, p_x, p_y, c.r_v) <= c.r_v
    if within and (
        plan_stop(promise, detections, plan, new, near, t + c.dt, x, y, s_x, s_y)
        or plan_return(promise, detections, plan, new, near, t + c.dt, x, y, s_x, s_y)
    ):
        acts = INNER
    elif (
        plan_return(promise, detections, plan, new, near, t, p_x, p_y, v_x, v_y)
        or going
        or plan_stop(promise, detections, plan, new, near, t, p_x, p_y, v_x, v_y)
    ):
        w_x, w_y = _follow(plan, v_x, v_y, c.u_a, c.dt)
    else:
        w_x, w_y = servo(p_x, p_y, v_x, v_y, detections[new, 0], detections[new, 1], c.v_a, c.u_a, c.dt)
        acts, plan[_VALID] = BEST_EFFORT, 0.0
    if acts != INNER:
        x, y, s_x, s_y, _, _ = step_vehicle(p_x, p_y, v_x, v_y, w_x, w_y, c.v_a, c.u_a, c.dt)
    plan[_P_X], plan[_P_Y], plan[_V_X], plan[_V_Y] = x, y, s_x, s_y
    return w_x, w_y, acts


@compiled
def uncertified_reason(
    promise: Promise, detections: FloatArray, plan: FloatArray, t: float, contradicted: bool, acts: int
) -> int:
    """Why this tick is not certified, a code of `UNCERTIFIED`; CERTIFIED if it is. To be asked right after `safe_control`.

    Args:
        promise: The declared numbers.
        detections: As kept. (KEPT, 3)
        plan: The filter's memory. (PLAN_SIZE,)
        t: Now, not when the command acts [s].
        contradicted: Whether `keep_detection` has ever found that detections do not agree.
        acts: What `safe_control` said.
    """
    new = newest_detection(detections)
    if new < 0:
        return NO_DETECTION
    if t - detections[new, 2] > promise.age + _REST:
        return TOO_OLD
    if contradicted:
        return CONTRADICTED
    if acts == BEST_EFFORT:
        return NO_PLAN
    return OFF_PLAN if plan[_OFF_PLAN] != 0.0 else CERTIFIED


def largest_age(promise: Promise) -> float:
    """The largest A [s] for which the hand-over holds, other numbers as they are; NaN if there is none. To a hundredth."""
    c = promise

    def fits(age: float) -> bool:
        rho = c.eps + c.v_g * (age + c.delay)
        return not math.isnan(handover_radius(c.r_v + _MARGIN, c.eps, rho, c.v_a, c.u_a, c.v_g, c.dt))

    low, high = 0.0, c.r_v / max(c.v_g, _REST)
    if not fits(low):
        return math.nan
    while high - low > 0.01:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def check_assumptions(promise: Promise) -> tuple[str, ...]:
    """Which assumptions do not hold, one line each with its numbers; empty if all hold that are known when a run is loaded."""
    c = promise
    faults = []
    if not math.isfinite(c.eps):
        faults.append(f"eps = {c.eps:g} m: the noise of the detections is not cut, so none of them bounds the distance")
    if not math.isfinite(c.age):
        faults.append(f"A = {c.age:g} s: the age of the newest detection has no bound")
    if not math.isfinite(c.v_a) or not math.isfinite(c.v_g):
        faults.append(f"v_a = {c.v_a:g} m/s, v_g = {c.v_g:g} m/s: both speeds must be bounded")
    elif not c.v_g < c.v_a:
        faults.append(f"v_a = {c.v_a:g} m/s: the UAV must be faster than the UGV, v_g = {c.v_g:g} m/s")
    if not c.u_a > 0.0:
        faults.append(f"u_a = {c.u_a:g} m/s²: must be positive")
    if not faults and math.isnan(c.handover):
        rho, most = c.eps + c.v_g * (c.age + c.delay), largest_age(c)
        limit = "for no A" if math.isnan(most) else f"for A up to {most:.2f} s"
        faults.append(
            f"eps + v_g (A + tau_c) = {rho:.4g} m (eps {c.eps:g} m, A {c.age:g} s, tau_c {c.delay:g} s): "
            f"too much for r_v = {c.r_v:.4g} m; with these numbers the hand-over holds {limit}"
        )
    return tuple(faults)
