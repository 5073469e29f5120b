r"""Backup trajectories: braking to a stop, returning to the newest measurement, and their checks. Beyond Klodt 2015.

The proof is in docs/explanation/proof.md. The UGV is known to be in a set: each measurement z of tick t_z, with
an error of at most $\epsilon$, confines it to a disc of radius $\rho(t) = \epsilon + v_g (t - t_z)$ around z. The
filter always holds a **plan**: a backup trajectory that ends at rest and is checked against those discs to its end. At
the end of a plan, the hand-over inequality guarantees the next plan, whatever has been detected in the meantime.

Positions in the world's frame [m], times in ticks, speeds [m/s], accelerations [m/s²].
"""

import math
from typing import NamedTuple

from agents.safety.area import RESIDUE, is_in_area, off_walls, stays_in_area
from agents.safety.discs import (
    MARGIN,
    Disc,
    KnownDiscs,
    drift,
    farthest,
    known_discs,
    newest_disc,
    radius_at,
)
from agents.safety.handover import REST, ROUNDING, rest_to_rest
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray
from sim.models.safety import SafetyBounds
from sim.models.vehicles import State, brake, clip_norm, norm, speed_to_stop_within

_ON_THE_SPOT = 1e-9
"""Length up to which a segment has no direction [m]."""

_SPEEDS = (1.0, 0.6, 0.35, 0.2)
"""Shares of v_a at which a plan may return; a fast return overshoots a short distance."""


@compiled
def servo(
    own: State, z_x: float, z_y: float, v_a: float, u_a: float, dt: float
) -> tuple[float, float]:
    r"""Return the acceleration that flies to z and stops there [m/s²].

    $$ u = clip((v^* - v_a)/dt, u_a), \quad v^* = -s (p_a - z)/\|p_a - z\| $$

    s is the speed from which the UAV stops at z, at most v_a. This is the best effort if nothing is certified.
    """
    x, y = z_x - own.p_x, z_y - own.p_y
    distance = norm(x, y)
    speed = (
        min(v_a, speed_to_stop_within(distance, u_a, dt)) / distance
        if distance > _ON_THE_SPOT
        else 0.0
    )
    return clip_norm((speed * x - own.v_x) / dt, (speed * y - own.v_y) / dt, u_a)


@compiled
def end_disc(plan: RecordArray) -> Disc:
    """Return the disc around the end of the last plan that contained the UGV; infinite before the first plan."""
    backup = plan[0]
    return Disc(backup.end[0], backup.end[1], backup.end_radius, backup.end_tick)


@compiled
def set_end(plan: RecordArray, disc: Disc) -> None:
    """Set the disc around the end of a plan. `plan` has shape (1,)."""
    backup = plan[0]
    backup.end[0], backup.end[1] = disc.x, disc.y
    backup.end_radius, backup.end_tick = disc.radius, disc.tick


class _PlanTicks(NamedTuple):
    """Ticks of the parts of a plan."""

    turn: int
    cruise: int
    brake: int


@compiled
def _store_plan(
    plan: RecordArray,
    ticks: _PlanTicks,
    turning: tuple[float, float],
    braking: tuple[float, float],
    end: Disc,
    floor: float,
) -> None:
    """Store a checked plan: its ticks, its accelerations [m/s²], its end and its floor [m]."""
    backup = plan[0]
    backup.checked, backup.turn, backup.cruise, backup.brake = (
        1,
        ticks.turn,
        ticks.cruise,
        ticks.brake,
    )
    backup.turning[0], backup.turning[1] = turning
    backup.braking[0], backup.braking[1] = braking
    backup.floor = floor
    set_end(plan, end)


@compiled
def _end_radius(
    bounds: SafetyBounds, known: KnownDiscs, tick: int, x: float, y: float, ticks: int
) -> float:
    """Return a bound on the UGV's current distance from a plan's end [m]; infinite if the plan may not end there.

    The plan lasts for `ticks`. The UAV may have to rest at its end for B - dt longer, until the next plan begins.
    """
    n, growth = known.newest, drift(bounds, ticks + bounds.interval_ticks - 1)
    single = norm(x - n.x, y - n.y) + radius_at(bounds, n, tick)
    if not single + growth <= bounds.handover_bound:
        return math.inf
    bound = farthest(bounds, known, tick, x, y, bounds.handover_radius - growth)
    return bound if bound + growth <= bounds.handover_radius else math.inf


@compiled
def stop_from(
    bounds: SafetyBounds,
    known: KnownDiscs,
    plan: RecordArray,
    tick: int,
    own: State,
    least: int = 0,
) -> bool:
    """Store the plan to brake to a stop from this state; return False, without changes, if it is not safe.

    A plan that begins in this tick lasts for at least `least` ticks: no other plan begins earlier.

    On a straight line with decreasing speed, the bound is largest at one of the ends: the distance to a fixed point is
    convex in the distance flown, and the distance flown concave in time.
    """
    speed = norm(own.v_x, own.v_y)
    ticks = 0
    if speed > RESIDUE:
        ticks = max(1, math.ceil(speed / (bounds.u_a * bounds.dt) - ROUNDING))
    duration = ticks * bounds.dt
    share = -1.0 / duration if ticks else 0.0
    a_x, a_y = share * own.v_x, share * own.v_y
    x, y = own.p_x + 0.5 * own.v_x * duration, own.p_y + 0.5 * own.v_y * duration
    if not is_in_area(bounds, own.p_x, own.p_y):
        return False
    if ticks and not stays_in_area(bounds, own, a_x, a_y, duration):
        return False
    radius = _end_radius(bounds, known, tick, x, y, max(ticks, least))
    if radius == math.inf:
        return False
    if not farthest(bounds, known, tick, own.p_x, own.p_y, bounds.radius) <= bounds.radius:
        return False
    _store_plan(
        plan,
        _PlanTicks(0, 0, ticks),
        (0.0, 0.0),
        (a_x, a_y),
        Disc(x, y, radius, tick),
        bounds.floor,
    )
    return True


@compiled
def _turn_is_safe(
    bounds: SafetyBounds,
    known: KnownDiscs,
    tick: int,
    own: State,
    a_x: float,
    a_y: float,
    ticks: int,
) -> bool:
    """Return whether the bound stays within r_v during a turn with constant acceleration.

    The bound grows by no more than v_a + v_g, so ticks by which it cannot reach r_v are skipped.
    """
    k = 0
    while k <= ticks:
        s = k * bounds.dt
        x = own.p_x + (own.v_x + 0.5 * a_x * s) * s
        y = own.p_y + (own.v_y + 0.5 * a_y * s) * s
        most = bounds.radius - bounds.v_g * s
        room = most - farthest(bounds, known, tick, x, y, most)
        if not room >= 0.0:
            return False
        k += max(1, int(room / ((bounds.v_a + bounds.v_g) * bounds.dt)))
    return True


class _Return(NamedTuple):
    """Turn towards the newest measurement, straight flight to it, and a stop."""

    turn: int
    cruise: int
    """Ticks of turn and cruise; a negative cruise: there is no such return."""
    stop: int
    w_x: float
    w_y: float
    """Velocity on the straight part [m/s]."""
    q_x: float
    q_y: float
    """End of the turn [m]."""


@compiled
def _return_from_rest(
    bounds: SafetyBounds, own: State, z_x: float, z_y: float, speed: float
) -> _Return:
    """Return the trajectory to z [m] from rest, at most at this speed [m/s]."""
    x, y = z_x - own.p_x, z_y - own.p_y
    distance = norm(x, y)
    turn, cruise, speed = rest_to_rest(distance, speed, bounds.u_a, bounds.dt)
    w_x, w_y = (speed * x / distance, speed * y / distance) if turn else (0.0, 0.0)
    return _Return(turn, cruise, turn, w_x, w_y, own.p_x, own.p_y)


@compiled
def _return_while_moving(
    bounds: SafetyBounds, own: State, z_x: float, z_y: float, speed: float
) -> _Return:
    """Return the trajectory to z [m] at this speed [m/s]; heading and end of the turn are found by iteration."""
    stop = max(1, math.ceil(speed / (bounds.u_a * bounds.dt) - ROUNDING))
    q_x, q_y, w_x, w_y, turn = own.p_x, own.p_y, 0.0, 0.0, 0
    for _ in range(4):
        distance = norm(z_x - q_x, z_y - q_y)
        if distance <= _ON_THE_SPOT:
            return _Return(turn, -1, stop, w_x, w_y, q_x, q_y)
        w_x, w_y = speed * (z_x - q_x) / distance, speed * (z_y - q_y) / distance
        change = norm(w_x - own.v_x, w_y - own.v_y)
        turn = max(1, math.ceil(change / (bounds.u_a * bounds.dt) - ROUNDING))
        q_x = own.p_x + 0.5 * (own.v_x + w_x) * turn * bounds.dt
        q_y = own.p_y + 0.5 * (own.v_y + w_y) * turn * bounds.dt
    along = (z_x - q_x) * w_x + (z_y - q_y) * w_y
    left = along / (speed * speed * bounds.dt) - 0.5 * stop  # ticks at constant speed
    return _Return(turn, int(left) if left >= 0.0 else -1, stop, w_x, w_y, q_x, q_y)


@compiled
def _return_at(
    bounds: SafetyBounds,
    known: KnownDiscs,
    plan: RecordArray,
    tick: int,
    own: State,
    speed: float,
) -> bool:
    """Store the plan of `return_from` at one speed [m/s]."""
    if not is_in_area(bounds, own.p_x, own.p_y):
        return False
    z_x = off_walls(known.newest.x, bounds.width)
    z_y = off_walls(known.newest.y, bounds.height)
    at_rest = norm(own.v_x, own.v_y) <= REST
    if at_rest:
        trajectory = _return_from_rest(bounds, own, z_x, z_y, speed)
    else:
        trajectory = _return_while_moving(bounds, own, z_x, z_y, speed)
    turn, cruise, stop, w_x, w_y, q_x, q_y = trajectory
    if cruise < 0:
        return False
    level = (0.5 * turn + cruise + 0.5 * stop) * bounds.dt
    end_x = own.p_x + 0.5 * own.v_x * turn * bounds.dt + w_x * level
    end_y = own.p_y + 0.5 * own.v_y * turn * bounds.dt + w_y * level
    radius = _end_radius(bounds, known, tick, end_x, end_y, turn + cruise + stop)
    if radius == math.inf:
        return False
    a_x, a_y = 0.0, 0.0
    if turn:
        a_x, a_y = (w_x - own.v_x) / (turn * bounds.dt), (w_y - own.v_y) / (turn * bounds.dt)
    if not stays_in_area(bounds, own, a_x, a_y, turn * bounds.dt):
        return False
    if not at_rest:  # from rest, the trajectory is a chord of the area
        chord = State(q_x, q_y, end_x - q_x, end_y - q_y)
        if not stays_in_area(bounds, chord, 0.0, 0.0, 1.0):
            return False
    if not _turn_is_safe(bounds, known, tick, own, a_x, a_y, turn):
        return False
    b_x, b_y = (-w_x / (stop * bounds.dt), -w_y / (stop * bounds.dt)) if stop else (0.0, 0.0)
    end = Disc(end_x, end_y, radius, tick)
    _store_plan(plan, _PlanTicks(turn, cruise, stop), (a_x, a_y), (b_x, b_y), end, bounds.floor)
    return True


@compiled
def return_from(
    bounds: SafetyBounds, known: KnownDiscs, plan: RecordArray, tick: int, own: State
) -> bool:
    """Store the plan to turn to the newest measurement, fly there and stop, from this state at a tick.

    Return False, without changes, if it is not safe. The turn changes the velocity along a straight line to the one
    that leads from the end of the turn to the measurement; both ends keep the speed bound, so all of it does. The rest
    of the trajectory is straight, and the bound is largest at one of its ends.
    """
    for share in _SPEEDS:  # noqa: SIM110 - numba compiles no generator expression
        if _return_at(bounds, known, plan, tick, own, share * bounds.v_a):
            return True
    return False


@compiled
def follow(bounds: SafetyBounds, plan: RecordArray, v_x: float, v_y: float) -> tuple[float, float]:
    """Return the acceleration of the current plan in this tick [m/s²], and advance the plan.

    After the end of the plan the UAV rests.
    """
    backup = plan[0]
    if backup.turn > 0:
        backup.turn -= 1
        return backup.turning[0], backup.turning[1]
    if backup.cruise > 0:
        backup.cruise -= 1
        return 0.0, 0.0
    if backup.brake > 0:
        backup.brake -= 1
        return backup.braking[0], backup.braking[1]
    return brake(v_x, v_y, bounds.u_a, bounds.dt)


@compiled
def rest_radius(
    bounds: SafetyBounds,
    discs: RecordArray,
    plan: RecordArray,
    tick: int,
    own: State,
    ticks: int,
) -> float:
    """Return a bound on the UGV's distance from a resting UAV [m]; infinite if it may not rest there.

    The rest lasts for `ticks`, and then until the next plan begins.
    """
    newest = newest_disc(discs)
    if newest < 0 or norm(own.v_x, own.v_y) > REST or not is_in_area(bounds, own.p_x, own.p_y):
        return math.inf
    known = known_discs(bounds, discs, end_disc(plan), newest, tick, own)
    return _end_radius(bounds, known, tick, own.p_x, own.p_y, ticks)


@compiled
def contradicts_plan(bounds: SafetyBounds, discs: RecordArray, plan: RecordArray) -> bool:
    """Return whether the newest measurement contradicts the disc around the last plan's end."""
    end, new = end_disc(plan), newest_disc(discs)
    if new < 0 or math.isinf(end.radius):
        return False
    z = discs[new]
    apart = norm(z.x - end.x, z.y - end.y)
    return bool(apart > radius_at(bounds, end, z.tick) + bounds.placed_error + MARGIN)
