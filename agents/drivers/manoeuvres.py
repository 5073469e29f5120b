"""Manoeuvres of UGVs that steer, in place of the straight accelerations of a point: towards a velocity or a goal.

Accelerating and turning use at most `_SHARE` of the largest acceleration each, so that both fit into it together. A
differential drive slows down to turn, and turns in place. A car drives forwards on its smallest circle until it faces
its goal; if the goal lies inside this circle or behind, it first reverses with the wheels turned the other way.
"""

import math

from agents.drivers.parameters import UgvParameters
from sim.compiling.compile import compiled
from sim.models.kinematics import DIFFERENTIAL, REST, UgvState, largest_turn, signed_speed, wrapped
from sim.models.vehicles import brake, clip_norm, norm, speed_to_stop_within

_SHARE = 0.7
"""Share of the largest acceleration for each of accelerating and turning."""
_MOST_TURN = 1.5
"""Largest turn in a tick [rad]: an acceleration more than a right angle aside means reverse."""
_BEHIND = 0.5 * math.pi
_ALIGNED = math.pi / 3.0
"""Angles to the goal at which a car begins to reverse, and ends to [rad]; between them it keeps its direction."""
_TIGHT, _EASY = 1.25, 0.8
"""Curvatures of the arc to the goal at which a car begins to reverse, and ends to, as multiples of its largest one."""


@compiled
def move(
    ugv: UgvParameters, own: UgvState, speed: float, turn: float, share: float
) -> tuple[float, float]:
    """Return the acceleration [m/s²] towards a signed speed and a change of the heading in this tick.

    Args:
        ugv: Constants of a UGV that steers.
        own: Its state.
        speed: Wanted speed [m/s]; negative: in reverse.
        turn: Wanted change of the heading in this tick [rad], limited to what the UGV can do.
        share: Share of the largest acceleration to use for each of accelerating and turning.
    """
    now, step = signed_speed(own), share * ugv.max_acceleration * ugv.dt
    after = max(now - step, min(speed, now + step))
    if now * after < 0.0:
        after = 0.0  # it stops before it reverses
    limit = largest_turn(ugv.kinematics, abs(now), abs(after), ugv.max_speed, ugv.dt)
    limit = min(limit, _MOST_TURN)
    fastest = max(abs(now), abs(after))
    if fastest > REST:
        limit = min(limit, step / fastest)
    heading = own.heading + max(-limit, min(turn, limit))
    e_x, e_y = math.cos(heading), math.sin(heading)
    if abs(now) <= REST and abs(after) <= REST:
        if abs(turn) <= REST:
            return brake(own.v_x, own.v_y, ugv.max_acceleration, ugv.dt)
        return 0.5 * REST / ugv.dt * e_x, 0.5 * REST / ugv.dt * e_y  # it turns in place
    u_x, u_y = (after * e_x - own.v_x) / ugv.dt, (after * e_y - own.v_y) / ugv.dt
    return clip_norm(u_x, u_y, ugv.max_acceleration)


@compiled
def _turning_speed(ugv: UgvParameters) -> float:
    """Return the speed of a car on its smallest circle, at which it still has acceleration to spare [m/s]."""
    return math.sqrt(0.5 * _SHARE * ugv.max_acceleration / ugv.kinematics.max_curvature)


@compiled
def _forward_speed(ugv: UgvParameters, angle: float, speed: float) -> float:
    """Return the speed with which to drive and turn by an angle [rad]; at most `speed` [m/s]."""
    ahead = max(math.cos(angle), 0.0)
    if ugv.kinematics.kind == DIFFERENTIAL:
        return ahead * ahead * speed
    slow = min(_turning_speed(ugv), speed)
    return slow + (speed - slow) * ahead * ahead * ahead * ahead


@compiled
def turn_to_velocity(
    ugv: UgvParameters, own: UgvState, w_x: float, w_y: float
) -> tuple[float, float]:
    """Return the acceleration [m/s²] of a UGV that steers towards a velocity [m/s], driving forwards."""
    w_x, w_y = clip_norm(w_x, w_y, ugv.max_speed)
    speed = norm(w_x, w_y)
    if speed <= REST:
        return brake(own.v_x, own.v_y, ugv.max_acceleration, ugv.dt)
    angle = wrapped(math.atan2(w_y, w_x) - own.heading)
    return move(ugv, own, _forward_speed(ugv, angle, speed), angle, _SHARE)


@compiled
def angle_to(own: UgvState, x: float, y: float) -> float:
    """Return the angle from the heading of a UGV to a point [rad]."""
    return wrapped(math.atan2(y - own.p_y, x - own.p_x) - own.heading)


@compiled
def turn_towards(ugv: UgvParameters, own: UgvState, angle: float, gear: int) -> tuple[float, float]:
    """Return the acceleration [m/s²] of a car that turns by an angle [rad] forwards (1) or in reverse (-1)."""
    return move(ugv, own, gear * min(ugv.max_speed, _turning_speed(ugv)), angle, _SHARE)


@compiled
def _reverses(ugv: UgvParameters, own: UgvState, angle: float, distance: float) -> bool:
    """Return whether a car reverses towards a goal at this angle to its heading [rad] and this distance [m]."""
    most, now = ugv.kinematics.max_curvature, signed_speed(own)
    curvature = 2.0 * abs(math.sin(angle)) / max(distance, REST)
    if now < -REST:
        return abs(angle) > _ALIGNED or curvature > _EASY * most
    if now > REST:
        return abs(angle) > _BEHIND or curvature > _TIGHT * most
    return abs(angle) > _BEHIND or curvature > most


@compiled
def turn_to_goal(
    ugv: UgvParameters, own: UgvState, goal_x: float, goal_y: float, speed: float
) -> tuple[float, float]:
    """Return the acceleration [m/s²] of a UGV that steers towards a goal [m], where it stops.

    Args:
        ugv: Constants of the UGV.
        own: Its state.
        goal_x, goal_y: Goal [m].
        speed: Maximum speed [m/s].
    """
    d_x, d_y = goal_x - own.p_x, goal_y - own.p_y
    distance = norm(d_x, d_y)
    if distance <= REST:
        return brake(own.v_x, own.v_y, ugv.max_acceleration, ugv.dt)
    angle = angle_to(own, goal_x, goal_y)
    if ugv.kinematics.kind != DIFFERENTIAL and _reverses(ugv, own, angle, distance):
        return move(ugv, own, -min(speed, _turning_speed(ugv)), angle, _SHARE)
    rest = distance - 0.5 * ugv.dt * max(signed_speed(own), 0.0)
    fastest = min(speed, speed_to_stop_within(rest, _SHARE * ugv.max_acceleration, ugv.dt))
    return move(ugv, own, _forward_speed(ugv, angle, fastest), angle, _SHARE)
