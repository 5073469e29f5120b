r"""The certificate: a filter around any inner control that keeps $\|p_a - p_g\| < r_v$. Beyond Klodt 2015.

The proof is in docs/explanation/certificate.md. What is known of the UGV is a set: each detection z, taken at t_z with an
error of at most $\epsilon$, puts it into a disc of radius $\rho(t) = \epsilon + v_g (t - t_z)$ around z.
The filter always holds a **plan**: a motion of the UAV that ends at rest and is checked against those discs to its
end. A command of the inner control acts only if a plan still exists after it; else the plan acts. At a plan's end the
hand-over inequality says that the next plan exists, whatever has been detected meanwhile.

All positions in the world's frame [m], times [s], speeds [m/s], accelerations [m/s²].
"""

import math

import numpy as np

from agents.control.discs import MARGIN, lens_distance, nearest, newest_detection
from agents.control.handover import ROUNDING, Promise, rest_to_rest
from sim.kernels.compile import FloatArray, compiled
from sim.models.vehicles import (
    brake,
    clip_norm,
    norm,
    speed_to_stop_within,
    step_vehicle,
    within_walls,
)

(_VALID, _TURN, _CRUISE, _BRAKE, _TURN_X, _TURN_Y, _BRAKE_X, _BRAKE_Y) = range(8)
(_END_X, _END_Y, _END_RADIUS, _END_TIME) = range(8, 12)
PLAN_SIZE = 12

_REST = 1e-9
"""A vehicle slower than this [m/s] is at rest."""

_OFF_WALL = 1e-6
"""A plan that moves towards a wall turns or ends at least so far from it [m].

Rounding must not make the vehicle touch it.
"""


_SPEEDS = (1.0, 0.6, 0.35, 0.2)
"""Shares of v_a at which a plan may return; a fast one runs too far where the way is short."""

INNER, PLAN, BEST_EFFORT = 0, 1, 2
"""Who acts: the inner control; the plan (certified); nobody certified, the filter does what it can."""

(
    CERTIFIED,
    NO_DETECTION,
    TOO_OLD,
    CONTRADICTED,
    OFF_COURSE,
    NO_PLAN,
    UNKNOWN_COMMANDS,
    UNSAFE_COURSE,
) = range(8)
UNCERTIFIED = {
    NO_DETECTION: "no detection has arrived yet",
    TOO_OLD: "the newest detection is older than declared (age > A)",
    CONTRADICTED: "detections contradict each other: their errors are larger than eps, or the UGV is faster than v_g",
    OFF_COURSE: "the UAV is not where its commands should have brought it: one was late or lost (delay > tau_c)",
    NO_PLAN: "outside the certified set: no plan keeps the UGV within r_v from here",
    UNKNOWN_COMMANDS: "commands are under way of which it is not known that they will act",
    UNSAFE_COURSE: "commands under way may take the UGV out of sight before the next one acts",
}
"""Why a tick is not certified, by the code that `agents.control.guard.guard` gives."""


@compiled
def servo(
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    z_x: float,
    z_y: float,
    v_a: float,
    u_a: float,
    dt: float,
) -> tuple[float, float]:
    r"""To z as fast as it can still stop there, $u = clip((v^* - v_a)/dt, u_a)$, $v^* = -s (p_a - z)/\|p_a - z\|$ [m/s²].

    s is the speed from which the UAV stops at z, at most v_a. Acts where nothing is certified, as the best that
    can be done.
    """
    x, y = z_x - p_x, z_y - p_y
    way = norm(x, y)
    speed = min(v_a, speed_to_stop_within(way, u_a, dt)) / way if way > _REST else 0.0
    return clip_norm((speed * x - v_x) / dt, (speed * y - v_y) / dt, u_a)


@compiled
def step_in_area(
    promise: Promise, p_x: float, p_y: float, v_x: float, v_y: float, u_x: float, u_y: float
) -> tuple[float, float, float, float, float]:
    """The UAV one tick on, as the world moves it: (1), and the walls.

    Returns:
        Position [m] and velocity [m/s], x before y, and how far a wall has kept it from where (1) alone leads [m].
    """
    c = promise
    q_x, q_y, w_x, w_y, _, _ = step_vehicle(p_x, p_y, v_x, v_y, u_x, u_y, c.v_a, c.u_a, c.dt)
    x, w_x = within_walls(q_x, w_x, c.width)
    y, w_y = within_walls(q_y, w_y, c.height)
    return x, y, w_x, w_y, norm(q_x - x, q_y - y)


@compiled
def no_plan() -> FloatArray:
    """The filter's memory before its first plan. Shape (PLAN_SIZE,)."""
    plan = np.zeros(PLAN_SIZE)
    plan[_END_RADIUS] = math.inf
    return plan


@compiled
def farthest(
    promise: Promise,
    detections: FloatArray,
    plan: FloatArray,
    new: int,
    near: int,
    t: float,
    x: float,
    y: float,
    enough: float,
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
    e_r = plan[_END_RADIUS] + c.v_g * abs(
        t - plan[_END_TIME]
    )  # also of a time before, which commands under way ask for
    bound = min(bound, lens_distance(x, y, n_x, n_y, n_r, plan[_END_X], plan[_END_Y], e_r))
    if bound <= enough or near == new:
        return bound
    b_x, b_y, b_r = (
        detections[near, 0],
        detections[near, 1],
        c.eps + c.v_g * (t - detections[near, 2]),
    )
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
def _is_off_wall(p: float, v: float, a: float, duration: float, size: float) -> bool:
    """Whether p + v s + a s²/2 stays within the walls of one axis for the duration, clear of them where it moves.

    Only where nothing moves along the axis, or at the start, may the vehicle be at the wall.
    """
    if math.isinf(size):
        return True
    if not 0.0 <= p <= size:
        return False
    if v == 0.0 and a == 0.0:
        return True
    end = p + (v + 0.5 * a * duration) * duration
    low = high = end
    if a != 0.0 and 0.0 < -v / a < duration:
        summit = p - 0.5 * v * v / a
        low, high = min(low, summit), max(high, summit)
    return low >= _OFF_WALL and high <= size - _OFF_WALL


@compiled
def _is_in_area(promise: Promise, x: float, y: float) -> bool:
    c = promise
    return (math.isinf(c.width) or 0.0 <= x <= c.width) and (
        math.isinf(c.height) or 0.0 <= y <= c.height
    )


@compiled
def _stays_in_area(
    promise: Promise,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    a_x: float,
    a_y: float,
    duration: float,
) -> bool:
    """Whether a motion with constant acceleration stays within the walls.

    One that it touched would take the UAV off its plan.
    """
    c = promise
    return _is_off_wall(p_x, v_x, a_x, duration, c.width) and _is_off_wall(
        p_y, v_y, a_y, duration, c.height
    )


@compiled
def _end_radius(
    promise: Promise,
    detections: FloatArray,
    plan: FloatArray,
    new: int,
    near: int,
    t: float,
    x: float,
    y: float,
    duration: float,
) -> float:
    """How far the UGV is at most from a plan's end, now [m], if the plan may end there; else infinite."""
    c = promise
    single = (
        norm(x - detections[new, 0], y - detections[new, 1])
        + c.eps
        + c.v_g * (t - detections[new, 2])
    )
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

    Along a straight line on which it only slows down, the bound is largest at one of the ends: the distance to a
    fixed point is convex in the way, and the way concave in time.
    """
    c = promise
    speed = norm(v_x, v_y)
    ticks = 0 if speed <= _REST else max(1, math.ceil(speed / (c.u_a * c.dt) - ROUNDING))
    duration = ticks * c.dt
    share = -1.0 / duration if ticks else 0.0
    if not _is_in_area(promise, p_x, p_y):
        return False
    if ticks and not _stays_in_area(
        promise, p_x, p_y, v_x, v_y, share * v_x, share * v_y, duration
    ):
        return False
    end_x, end_y = p_x + 0.5 * v_x * duration, p_y + 0.5 * v_y * duration
    end_radius = _end_radius(promise, detections, plan, new, near, t, end_x, end_y, duration)
    if end_radius == math.inf:
        return False
    if not farthest(promise, detections, plan, new, near, t, p_x, p_y, c.r_v) <= c.r_v:
        return False
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
    """Whether the bound stays within r_v in a turn with constant acceleration.

    Ticks that the bound cannot reach r_v by, as it grows by no more than v_a + v_g, are not looked at.
    """
    c = promise
    k = 0
    while k <= ticks:
        s = k * c.dt
        x, y = p_x + (v_x + 0.5 * a_x * s) * s, p_y + (v_y + 0.5 * a_y * s) * s
        room = (
            c.r_v
            - c.v_g * s
            - farthest(promise, detections, plan, new, near, t, x, y, c.r_v - c.v_g * s)
        )
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
    at_rest = norm(v_x, v_y) <= _REST
    if at_rest:
        if not (_is_in_area(promise, p_x, p_y) and _is_in_area(promise, z_x, z_y)):
            return False
        x, y = z_x - p_x, z_y - p_y
        way = norm(x, y)
        turn, cruise, speed = rest_to_rest(way, speed, c.u_a, c.dt)
        v_x, v_y, stop = 0.0, 0.0, turn
        w_x, w_y = (speed * x / way, speed * y / way) if turn else (0.0, 0.0)
    else:
        stop = max(1, math.ceil(speed / (c.u_a * c.dt) - ROUNDING))
        q_x, q_y = p_x, p_y  # where the turn ends: found with the heading by iteration
        w_x, w_y, turn = 0.0, 0.0, 0
        for _ in range(4):
            way = norm(z_x - q_x, z_y - q_y)
            if way <= _REST:
                return False
            w_x, w_y = speed * (z_x - q_x) / way, speed * (z_y - q_y) / way
            turn = max(1, math.ceil(norm(w_x - v_x, w_y - v_y) / (c.u_a * c.dt) - ROUNDING))
            q_x, q_y = p_x + 0.5 * (v_x + w_x) * turn * c.dt, p_y + 0.5 * (v_y + w_y) * turn * c.dt
        left = ((z_x - q_x) * w_x + (z_y - q_y) * w_y) / (
            speed * speed * c.dt
        ) - 0.5 * stop  # ticks at constant speed
        if not left >= 0.0:
            return False
        cruise = int(left)
    duration = (turn + cruise + stop) * c.dt
    level = (0.5 * turn + cruise + 0.5 * stop) * c.dt
    end_x, end_y = (
        p_x + 0.5 * v_x * turn * c.dt + w_x * level,
        p_y + 0.5 * v_y * turn * c.dt + w_y * level,
    )
    end_radius = _end_radius(promise, detections, plan, new, near, t, end_x, end_y, duration)
    if end_radius == math.inf:
        return False
    a_x, a_y = ((w_x - v_x) / (turn * c.dt), (w_y - v_y) / (turn * c.dt)) if turn else (0.0, 0.0)
    if not at_rest:  # from rest the way is a chord of the area
        q_x, q_y = p_x + 0.5 * (v_x + w_x) * turn * c.dt, p_y + 0.5 * (v_y + w_y) * turn * c.dt
        if not (
            _stays_in_area(promise, p_x, p_y, v_x, v_y, a_x, a_y, turn * c.dt)
            and _stays_in_area(promise, q_x, q_y, end_x - q_x, end_y - q_y, 0.0, 0.0, 1.0)
        ):
            return False
    if not _turn_is_safe(
        promise, detections, plan, new, near, t, p_x, p_y, v_x, v_y, a_x, a_y, turn
    ):
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
    """Whether the UAV may turn to the newest detection, fly there and stop, from this state at time t.

    If so, that is the plan.

    The turn takes the velocity along a straight line to the one that leads from the turn's end to the detection;
    bounds are kept,
    since both ends keep them. After it the way is straight, and the bound is largest at one of its ends.
    """
    for share in _SPEEDS:
        if _plan_at_speed(
            promise, detections, plan, new, near, t, p_x, p_y, v_x, v_y, share * promise.v_a
        ):
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
def drop_plan(plan: FloatArray) -> None:
    """The UAV is not where the plan in this memory has it: no plan is held."""
    plan[_VALID] = 0.0


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
    """The command that acts in the tick from t on.

    The inner control's if a plan still exists after it, else the plan's.

    With delayed commands t, p and v are those of the tick in which this command will act. The plan that is held
    begins in this state; where the vehicle has come to another one, `drop_plan` is to be called first.

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
    going = plan[_VALID] != 0.0 and plan[_TURN] + plan[_CRUISE] + plan[_BRAKE] > 0.0
    near = nearest(p_x, p_y, t, detections, c.eps, c.v_g)
    w_x, w_y = clip_norm(u_x, u_y, c.u_a)
    x, y, s_x, s_y, over = step_in_area(promise, p_x, p_y, v_x, v_y, w_x, w_y)
    within = (
        plan[_VALID] != 0.0
        or farthest(promise, detections, plan, new, near, t, p_x, p_y, c.r_v) <= c.r_v
    )
    if over > 0.0:  # within the tick the bound is at most that of the point beyond the wall
        room = c.r_v - over
        within = (
            within and farthest(promise, detections, plan, new, near, t + c.dt, x, y, room) <= room
        )
    if within and (
        plan_stop(promise, detections, plan, new, near, t + c.dt, x, y, s_x, s_y)
        or plan_return(promise, detections, plan, new, near, t + c.dt, x, y, s_x, s_y)
    ):
        return w_x, w_y, INNER
    if (
        plan_return(promise, detections, plan, new, near, t, p_x, p_y, v_x, v_y)
        or going
        or plan_stop(promise, detections, plan, new, near, t, p_x, p_y, v_x, v_y)
    ):
        w_x, w_y = _follow(plan, v_x, v_y, c.u_a, c.dt)
        return w_x, w_y, PLAN
    w_x, w_y = servo(p_x, p_y, v_x, v_y, detections[new, 0], detections[new, 1], c.v_a, c.u_a, c.dt)
    plan[_VALID] = 0.0
    return w_x, w_y, BEST_EFFORT


@compiled
def is_within(
    promise: Promise,
    detections: FloatArray,
    plan: FloatArray,
    t: float,
    p_x: float,
    p_y: float,
    over: float,
) -> bool:
    """Whether the UGV is surely within r_v of this point at time t, also if a wall has kept the UAV `over` [m] from beyond it."""
    c = promise
    new = newest_detection(detections)
    if new < 0:
        return False
    near, room = nearest(p_x, p_y, t, detections, c.eps, c.v_g), c.r_v - over
    return bool(farthest(promise, detections, plan, new, near, t, p_x, p_y, room) <= room)


@compiled
def contradicts_plan(promise: Promise, detections: FloatArray, plan: FloatArray) -> bool:
    """Whether the newest detection cannot be true if the UGV was where the last plan's check has it.

    An assumption is broken.
    """
    c = promise
    new = newest_detection(detections)
    if new < 0 or math.isinf(plan[_END_RADIUS]):
        return False
    apart = norm(detections[new, 0] - plan[_END_X], detections[new, 1] - plan[_END_Y])
    return bool(
        apart
        > plan[_END_RADIUS] + c.eps + c.v_g * abs(plan[_END_TIME] - detections[new, 2]) + MARGIN
    )
