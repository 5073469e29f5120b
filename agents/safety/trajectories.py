r"""The certificate: a filter around any inner control that keeps $\|p_a - p_g\| < r_v$. Beyond Klodt 2015.

The proof is in docs/explanation/certificate.md. What is known of the UGV is a set: each detection z, taken at t_z with
an error of at most $\epsilon$, puts it into a disc of radius $\rho(t) = \epsilon + v_g (t - t_z)$ around z. The filter
always holds a **plan**: a motion of the UAV that ends at rest and is checked against those discs to its end. A command
of the inner control acts only if a plan still exists after it; else the plan acts. At a plan's end the hand-over
inequality says that the next plan exists, whatever has been detected meanwhile.

All positions in the world's frame [m], times in ticks, speeds [m/s], accelerations [m/s²].
"""

import math
from typing import NamedTuple

from agents.safety.discs import (
    MARGIN,
    Disc,
    disc_of,
    drift,
    lens_distance,
    nearest,
    newest_detection,
    radius_at,
)
from agents.safety.handover import REST, ROUNDING, rest_to_rest
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray
from sim.models.safety import SafetyBounds
from sim.models.vehicles import (
    Motion,
    brake,
    clip_norm,
    norm,
    speed_to_stop_within,
    step_vehicle,
    within_walls,
)

_RESIDUE = 1e-10
"""Largest component of the velocity [m/s] that rounding leaves towards a wall at the end of a plan."""

_OFF_WALL = 1e-6
"""Distance [m] that a plan keeps from the walls. One that starts nearer to a wall leads along it or away from it."""

_CLEAR = 1e-9
"""Least distance [m] from a wall at which a plan may approach it: far more than rounding moves a UAV."""

_ON_THE_SPOT = 1e-9
"""A way that is not longer than this [m] has no direction."""

_SPEEDS = (1.0, 0.6, 0.35, 0.2)
"""Shares of v_a at which a plan may return; a fast one runs too far where the way is short."""

INNER, PLAN, BEST_EFFORT = 0, 1, 2
"""Codes of who acts: the inner control; the plan (certified); nobody certified, the filter does what it can."""

(
    CERTIFIED,
    NO_DETECTION,
    TOO_OLD,
    CONTRADICTED,
    OFF_COURSE,
    NO_PLAN,
    OUTAGE,
    UNCHECKED_MOTION,
) = range(8)
UNCERTIFIED = {
    NO_DETECTION: "no detection has arrived yet",
    TOO_OLD: "the newest detection is older than declared (age > A)",
    CONTRADICTED: "detections contradict each other: their errors are larger than eps, or the UGV is faster than v_g",
    OFF_COURSE: "the UAV is not where the motion that it reports should have brought it",
    NO_PLAN: "outside the certified set: no plan keeps the UGV within r_v from here",
    OUTAGE: "no motion can begin within what is declared of the one that is flown: commands are lost (outage > B)",
    UNCHECKED_MOTION: "the UAV flies, or may begin, a motion that was not checked from where it is",
}
"""Why a tick is not certified, by the code that `agents.safety.decision.guard` gives."""


class Known(NamedTuple):
    """Discs, each of which surely holds the UGV."""

    newest: Disc
    """Of the newest detection."""
    nearest: Disc
    """Of the one with the least bound."""
    end: Disc
    """Of the last plan; its radius is infinite before the first."""
    single: bool
    """True if the newest detection is also the nearest."""


@compiled
def servo(
    here: Motion, z_x: float, z_y: float, v_a: float, u_a: float, dt: float
) -> tuple[float, float]:
    r"""Fly to z and stop there, [m/s²]: $u = clip((v^* - v_a)/dt, u_a)$, $v^* = -s (p_a - z)/\|p_a - z\|$.

    s is the speed from which the UAV stops at z, at most v_a. Acts where nothing is certified, as the best that
    can be done.
    """
    x, y = z_x - here.p_x, z_y - here.p_y
    way = norm(x, y)
    speed = min(v_a, speed_to_stop_within(way, u_a, dt)) / way if way > _ON_THE_SPOT else 0.0
    return clip_norm((speed * x - here.v_x) / dt, (speed * y - here.v_y) / dt, u_a)


@compiled
def step_in_area(
    promise: SafetyBounds, here: Motion, u_x: float, u_y: float
) -> tuple[Motion, float]:
    """The UAV one tick on, as the world moves it: (1), and the walls.

    Returns:
        Where it is then, and how far a wall has kept it from where (1) alone leads [m].
    """
    q_x, q_y, w_x, w_y, _, _ = step_vehicle(
        here.p_x, here.p_y, here.v_x, here.v_y, u_x, u_y, promise.v_a, promise.u_a, promise.dt
    )
    x, w_x = within_walls(q_x, w_x, promise.width)
    y, w_y = within_walls(q_y, w_y, promise.height)
    return Motion(x, y, w_x, w_y), norm(q_x - x, q_y - y)


@compiled
def end_disc(plan: RecordArray) -> Disc:
    """The disc that surely held the UGV when the last plan was checked; infinite before the first."""
    held = plan[0]
    return Disc(held.end[0], held.end[1], held.end_radius, held.end_tick)


@compiled
def set_end(plan: RecordArray, disc: Disc) -> None:
    """Set the disc around the end of a plan. `plan`: a table of one row."""
    held = plan[0]
    held.end[0], held.end[1] = disc.x, disc.y
    held.end_radius, held.end_tick = disc.radius, disc.tick


@compiled
def known_from(
    promise: SafetyBounds,
    detections: RecordArray,
    plan: RecordArray,
    newest: int,
    tick: int,
    x: float,
    y: float,
) -> Known:
    """The discs that bound the distance from (x, y) at this tick best; `newest` is the newest detection's row."""
    near = nearest(promise, detections, tick, x, y)
    return Known(
        disc_of(promise, detections, newest),
        disc_of(promise, detections, near),
        end_disc(plan),
        near == newest,
    )


@compiled
def farthest(
    promise: SafetyBounds, known: Known, tick: int, x: float, y: float, enough: float
) -> float:
    """Upper bound of the distance from (x, y) to the UGV at a tick [m], from all that is known.

    Args:
        promise: The declared numbers.
        known: The discs that hold the UGV.
        tick: Of the bound.
        x, y: From where [m].
        enough: A bound that is not more than this need not be made tighter [m].
    """
    n, e, b = known.newest, known.end, known.nearest
    n_r = radius_at(promise, n, tick)
    bound: float = norm(x - n.x, y - n.y) + n_r
    if bound <= enough:
        return bound
    e_r = radius_at(promise, e, tick)
    bound = min(bound, lens_distance(x, y, n.x, n.y, n_r, e.x, e.y, e_r))
    if bound <= enough or known.single:
        return bound
    b_r = radius_at(promise, b, tick)
    bound = min(bound, lens_distance(x, y, n.x, n.y, n_r, b.x, b.y, b_r))
    return min(bound, lens_distance(x, y, b.x, b.y, b_r, e.x, e.y, e_r))


@compiled
def _hold(
    plan: RecordArray,
    ticks: tuple[int, int, int],
    turning: tuple[float, float],
    braking: tuple[float, float],
    end: Disc,
) -> None:
    """Hold a plan that has been checked: the ticks of its turn, cruise and brake, and its accelerations [m/s²]."""
    held = plan[0]
    held.checked, held.turn, held.cruise, held.brake = 1, ticks[0], ticks[1], ticks[2]
    held.turning[0], held.turning[1] = turning
    held.braking[0], held.braking[1] = braking
    set_end(plan, end)


@compiled
def _room(distance: float) -> float:
    """Return how near to a wall a plan may come that starts at this distance from it [m]."""
    return min(_OFF_WALL, distance, max(0.5 * distance, _CLEAR))


@compiled
def _is_off_wall(p: float, v: float, a: float, duration: float, size: float) -> bool:
    """Return whether p + v s + a s²/2 keeps off the walls of one axis for the duration.

    A motion that starts within `_OFF_WALL` of a wall may lead along it or away from it, and may halve the distance
    while it brakes or turns. A residual velocity may touch the wall, which removes it.
    """
    if math.isinf(size):
        return True
    if not 0.0 <= p <= size:
        return False
    if abs(v) <= _RESIDUE:
        v = 0.0
    if v == 0.0 and a == 0.0:
        return True
    end = p + (v + 0.5 * a * duration) * duration
    low = high = end
    if a != 0.0 and 0.0 < -v / a < duration:
        summit = p - 0.5 * v * v / a
        low, high = min(low, summit), max(high, summit)
    return low >= _room(p) and high <= size - _room(size - p)


@compiled
def _off_walls(p: float, size: float) -> float:
    """Return the point of one axis next to p that a return may end at: 2 `_OFF_WALL` off the walls."""
    if math.isinf(size):
        return p
    return min(max(p, 2.0 * _OFF_WALL), size - 2.0 * _OFF_WALL)


@compiled
def _is_in_area(promise: SafetyBounds, x: float, y: float) -> bool:
    return (math.isinf(promise.width) or 0.0 <= x <= promise.width) and (
        math.isinf(promise.height) or 0.0 <= y <= promise.height
    )


@compiled
def _stays_in_area(
    promise: SafetyBounds, here: Motion, a_x: float, a_y: float, duration: float
) -> bool:
    """Return whether a motion with constant acceleration keeps off the walls.

    A wall that it touched would take the UAV off its plan.
    """
    return _is_off_wall(here.p_x, here.v_x, a_x, duration, promise.width) and _is_off_wall(
        here.p_y, here.v_y, a_y, duration, promise.height
    )


@compiled
def _end_radius(
    promise: SafetyBounds, known: Known, tick: int, x: float, y: float, ticks: int
) -> float:
    """A bound on the UGV's distance now from a plan's end [m], if a plan of so many ticks may end there; else infinite.

    It may have to rest there for B - dt longer, until the next motion begins.
    """
    n, growth = known.newest, drift(promise, ticks + promise.interval_ticks - 1)
    single = norm(x - n.x, y - n.y) + radius_at(promise, n, tick)
    if not single + growth <= promise.handover_bound:
        return math.inf
    bound = farthest(promise, known, tick, x, y, promise.handover_radius - growth)
    return bound if bound + growth <= promise.handover_radius else math.inf


@compiled
def stop_from(
    promise: SafetyBounds, known: Known, plan: RecordArray, tick: int, here: Motion, least: int = 0
) -> bool:
    """Hold the plan to brake to a stop from this state at a tick; False, and nothing changes, if the UAV may not.

    One that begins in this tick lasts for a tick at `least`: no other plan begins before.

    Along a straight line on which it only slows down, the bound is largest at one of the ends: the distance to a
    fixed point is convex in the way, and the way concave in time.
    """
    speed = norm(here.v_x, here.v_y)
    ticks = 0
    if speed > _RESIDUE:
        ticks = max(1, math.ceil(speed / (promise.u_a * promise.dt) - ROUNDING))
    duration = ticks * promise.dt
    share = -1.0 / duration if ticks else 0.0
    a_x, a_y = share * here.v_x, share * here.v_y
    x, y = here.p_x + 0.5 * here.v_x * duration, here.p_y + 0.5 * here.v_y * duration
    if not _is_in_area(promise, here.p_x, here.p_y):
        return False
    if ticks and not _stays_in_area(promise, here, a_x, a_y, duration):
        return False
    radius = _end_radius(promise, known, tick, x, y, max(ticks, least))
    if radius == math.inf:
        return False
    if not farthest(promise, known, tick, here.p_x, here.p_y, promise.radius) <= promise.radius:
        return False
    _hold(plan, (0, 0, ticks), (0.0, 0.0), (a_x, a_y), Disc(x, y, radius, tick))
    return True


@compiled
def _turn_is_safe(
    promise: SafetyBounds, known: Known, tick: int, here: Motion, a_x: float, a_y: float, ticks: int
) -> bool:
    """True if the bound stays within r_v in a turn with constant acceleration.

    Ticks that the bound cannot reach r_v by, as it grows by no more than v_a + v_g, are not looked at.
    """
    k = 0
    while k <= ticks:
        s = k * promise.dt
        x = here.p_x + (here.v_x + 0.5 * a_x * s) * s
        y = here.p_y + (here.v_y + 0.5 * a_y * s) * s
        most = promise.radius - promise.v_g * s
        room = most - farthest(promise, known, tick, x, y, most)
        if not room >= 0.0:
            return False
        k += max(1, int(room / ((promise.v_a + promise.v_g) * promise.dt)))
    return True


@compiled
def _return_at(
    promise: SafetyBounds, known: Known, plan: RecordArray, tick: int, here: Motion, speed: float
) -> bool:
    """Hold the plan of `return_from` at one speed [m/s]."""
    if not _is_in_area(promise, here.p_x, here.p_y):
        return False
    z_x = _off_walls(known.newest.x, promise.width)
    z_y = _off_walls(known.newest.y, promise.height)
    at_rest = norm(here.v_x, here.v_y) <= REST
    q_x, q_y = here.p_x, here.p_y  # where the turn ends: found with the heading by iteration
    if at_rest:
        x, y = z_x - here.p_x, z_y - here.p_y
        way = norm(x, y)
        turn, cruise, speed = rest_to_rest(way, speed, promise.u_a, promise.dt)
        stop = turn
        w_x, w_y = (speed * x / way, speed * y / way) if turn else (0.0, 0.0)
    else:
        stop = max(1, math.ceil(speed / (promise.u_a * promise.dt) - ROUNDING))
        w_x, w_y, turn = 0.0, 0.0, 0
        for _ in range(4):
            way = norm(z_x - q_x, z_y - q_y)
            if way <= _ON_THE_SPOT:
                return False
            w_x, w_y = speed * (z_x - q_x) / way, speed * (z_y - q_y) / way
            change = norm(w_x - here.v_x, w_y - here.v_y)
            turn = max(1, math.ceil(change / (promise.u_a * promise.dt) - ROUNDING))
            q_x = here.p_x + 0.5 * (here.v_x + w_x) * turn * promise.dt
            q_y = here.p_y + 0.5 * (here.v_y + w_y) * turn * promise.dt
        along = (z_x - q_x) * w_x + (z_y - q_y) * w_y
        left = along / (speed * speed * promise.dt) - 0.5 * stop  # ticks at constant speed
        if not left >= 0.0:
            return False
        cruise = int(left)
    level = (0.5 * turn + cruise + 0.5 * stop) * promise.dt
    end_x = here.p_x + 0.5 * here.v_x * turn * promise.dt + w_x * level
    end_y = here.p_y + 0.5 * here.v_y * turn * promise.dt + w_y * level
    radius = _end_radius(promise, known, tick, end_x, end_y, turn + cruise + stop)
    if radius == math.inf:
        return False
    a_x, a_y = 0.0, 0.0
    if turn:
        a_x, a_y = (w_x - here.v_x) / (turn * promise.dt), (w_y - here.v_y) / (turn * promise.dt)
    if not _stays_in_area(promise, here, a_x, a_y, turn * promise.dt):
        return False
    if not at_rest:  # from rest the way is a chord of the area
        way_on = Motion(q_x, q_y, end_x - q_x, end_y - q_y)
        if not _stays_in_area(promise, way_on, 0.0, 0.0, 1.0):
            return False
    if not _turn_is_safe(promise, known, tick, here, a_x, a_y, turn):
        return False
    b_x, b_y = (-w_x / (stop * promise.dt), -w_y / (stop * promise.dt)) if stop else (0.0, 0.0)
    end = Disc(end_x, end_y, radius, tick)
    _hold(plan, (turn, cruise, stop), (a_x, a_y), (b_x, b_y), end)
    return True


@compiled
def return_from(
    promise: SafetyBounds, known: Known, plan: RecordArray, tick: int, here: Motion
) -> bool:
    """Hold the plan to turn to the newest detection, fly there and stop, from this state at a tick.

    Returns False, and nothing changes, if the UAV may not. The turn takes the velocity along a straight line to the
    one that leads from the turn's end to the detection; bounds are kept, since both ends keep them. After it the way
    is straight, and the bound is largest at one of its ends.
    """
    for share in _SPEEDS:  # noqa: SIM110 - numba compiles no generator expression
        if _return_at(promise, known, plan, tick, here, share * promise.v_a):
            return True
    return False


@compiled
def follow(promise: SafetyBounds, plan: RecordArray, v_x: float, v_y: float) -> tuple[float, float]:
    """The command of the plan that is held for this tick, which it then has behind it.

    At its end the UAV stays where it is.
    """
    held = plan[0]
    if held.turn > 0:
        held.turn -= 1
        return held.turning[0], held.turning[1]
    if held.cruise > 0:
        held.cruise -= 1
        return 0.0, 0.0
    if held.brake > 0:
        held.brake -= 1
        return held.braking[0], held.braking[1]
    return brake(v_x, v_y, promise.u_a, promise.dt)


@compiled
def drop_plan(plan: RecordArray) -> None:
    """The UAV is not where the plan in this memory has it: no plan is held."""
    plan[0].checked = 0


@compiled
def _may_go_on(
    promise: SafetyBounds,
    known: Known,
    plan: RecordArray,
    tick: int,
    here: Motion,
    then: Motion,
    over: float,
) -> bool:
    """True if the UGV is surely within r_v now, and until the next tick where a wall keeps the UAV `over` [m] back."""
    within = (
        plan[0].checked != 0
        or farthest(promise, known, tick, here.p_x, here.p_y, promise.radius) <= promise.radius
    )
    if within and over > 0.0:
        # within the tick the bound is at most that of the point beyond the wall
        room = promise.radius - over
        within = farthest(promise, known, tick + 1, then.p_x, then.p_y, room) <= room
    return within


@compiled
def safe_control(
    promise: SafetyBounds,
    detections: RecordArray,
    plan: RecordArray,
    tick: int,
    here: Motion,
    u_x: float,
    u_y: float,
) -> tuple[float, float, int]:
    """The command that acts in a tick: the inner control's if a plan still exists after it, else the plan's.

    With delayed commands the tick and the state are those in which this command will act. The plan that is held
    begins in this state.

    Args:
        promise: The declared numbers.
        detections: All that have arrived, as kept by `keep_detection`. (KEPT,)
        plan: `CheckedTrajectory` of the plan that is held, changed in place. (1,)
        tick: In which the command acts.
        here: Where the UAV is then.
        u_x, u_y: What the inner control wants [m/s²].

    Returns:
        The command [m/s²], and who acts: INNER, PLAN or BEST_EFFORT.
    """
    new = newest_detection(detections)
    if new < 0:
        u_x, u_y = brake(here.v_x, here.v_y, promise.u_a, promise.dt)
        return u_x, u_y, BEST_EFFORT
    held = plan[0]
    going = held.checked != 0 and held.turn + held.cruise + held.brake > 0
    known = known_from(promise, detections, plan, new, tick, here.p_x, here.p_y)
    w_x, w_y = clip_norm(u_x, u_y, promise.u_a)
    then, over = step_in_area(promise, here, w_x, w_y)
    if _may_go_on(promise, known, plan, tick, here, then, over):
        found = stop_from(promise, known, plan, tick + 1, then)
        if found or return_from(promise, known, plan, tick + 1, then):
            return w_x, w_y, INNER
    found = return_from(promise, known, plan, tick, here)
    if not found and not going:
        found = stop_from(promise, known, plan, tick, here, 1)
    if found or going:
        w_x, w_y = follow(promise, plan, here.v_x, here.v_y)
        return w_x, w_y, PLAN
    z = known.newest
    w_x, w_y = servo(here, z.x, z.y, promise.v_a, promise.u_a, promise.dt)
    drop_plan(plan)
    return w_x, w_y, BEST_EFFORT


@compiled
def rest_radius(
    promise: SafetyBounds,
    detections: RecordArray,
    plan: RecordArray,
    tick: int,
    here: Motion,
    ticks: int,
) -> float:
    """A bound on the UGV's distance from a UAV at rest [m]; infinite if it is not at rest, or may not rest there.

    That is for so many ticks, and then until the next motion begins.
    """
    newest = newest_detection(detections)
    if (
        newest < 0
        or norm(here.v_x, here.v_y) > REST
        or not _is_in_area(promise, here.p_x, here.p_y)
    ):
        return math.inf
    known = known_from(promise, detections, plan, newest, tick, here.p_x, here.p_y)
    return _end_radius(promise, known, tick, here.p_x, here.p_y, ticks)


@compiled
def contradicts_plan(promise: SafetyBounds, detections: RecordArray, plan: RecordArray) -> bool:
    """True if the newest detection cannot be true if the UGV was where the last plan's check has it.

    An assumption is broken.
    """
    end, new = end_disc(plan), newest_detection(detections)
    if new < 0 or math.isinf(end.radius):
        return False
    z = detections[new]
    apart = norm(z.x - end.x, z.y - end.y)
    return bool(apart > radius_at(promise, end, z.taken) + promise.placed_error + MARGIN)
