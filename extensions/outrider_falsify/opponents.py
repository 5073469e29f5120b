"""Compiled adversaries of an attack: inner control, UGV, detection errors, wind and position error."""

import math
from typing import NamedTuple

from outrider_falsify.conditions import (
    ANY,
    ERRORS,
    INNERS,
    UGVS,
    WINDS,
    Conditions,
)
from outrider_falsify.rng import RngState, next_share
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray
from sim.engine.world_state import BatchState
from sim.engine.world_tick import apply_disturbance
from sim.models.vehicles import State, brake, norm

UAV, UGV = 0, 1
"""Rows of UAV and UGV in the adversaries' memory and in the world."""


class AdversaryState(NamedTuple):
    """Memory of an adversary: one row for the UAV's, one for the UGV's."""

    u_x: float
    u_y: float
    """Acceleration, redrawn occasionally [m/s²]."""
    side: float
    """Turning direction, redrawn with the acceleration: 1.0 left, -1.0 right."""
    output_x: float
    output_y: float
    """Command of (15) [m/s²]."""
    heading_x: float
    heading_y: float
    """Direction of the UGV; residual velocity of the UAV [m/s]. Drawn once."""
    error_x: float
    error_y: float
    """Direction of constant errors, drawn once."""
    wind: float
    """Angle of wind and position error [rad]."""
    losing: float
    """State of `loses`: ALIVE, or the tick of the first lost trajectory."""


@compiled
def choose(random: RngState, wanted: int, count: int) -> int:
    """Return the requested code, or draw one of `count` codes if it is ANY."""
    return wanted if wanted >= 0 else int(next_share(random) * count)


@compiled
def draw_direction(random: RngState) -> tuple[float, float]:
    """Draw a unit vector with a uniform angle."""
    angle = 2.0 * math.pi * next_share(random)
    return math.cos(angle), math.sin(angle)


@compiled
def direction(x: float, y: float) -> tuple[float, float]:
    """Return the unit vector along a vector; (1, 0) for zero."""
    length = norm(x, y)
    if length == 0.0:
        return 1.0, 0.0
    return x / length, y / length


@compiled
def redraw(random: RngState, adversaries: RecordArray, k: int, u: float) -> None:
    """Draw a new acceleration of at most u [m/s²] and a new side for an adversary."""
    angle, strength = 2.0 * math.pi * next_share(random), u * min(1.0, 2.0 * next_share(random))
    adversary = adversaries[k]
    adversary.u_x, adversary.u_y = strength * math.cos(angle), strength * math.sin(angle)
    adversary.side = 1.0 if next_share(random) < 0.5 else -1.0


@compiled
def draw_creep(random: RngState) -> tuple[float, float]:
    """Draw a velocity of the order of rounding errors [m/s], mostly towards the wall y = 0."""
    pace = 10.0 ** (4.0 * next_share(random) - 12.0)
    e_x, e_y = draw_direction(random)
    return (0.0, -pace) if next_share(random) < 0.7 else (pace * e_x, pace * e_y)


@compiled
def _creep(own: State, c_x: float, c_y: float, side: float) -> tuple[float, float]:
    """Return the command that holds the UAV at a residual velocity [m/s²].

    Args:
        own: State of the UAV.
        c_x, c_y: The residual velocity [m/s].
        side: While the safety filter moves the UAV, 1.0 pushes back and -1.0 does nothing.
    """
    speed, pace = norm(own.v_x, own.v_y), norm(c_x, c_y)
    push = 0.0
    if speed < 0.1 * pace:
        push = 20.0
    elif side > 0.0 and speed > 2.0 * pace:
        push = -2e3
    return push * c_x, push * c_y


@compiled
def inner_command(
    kind: int,
    x: float,
    y: float,
    own: State,
    z_x: float,
    z_y: float,
    phase: float,
    adversaries: RecordArray,
    u: float,
) -> tuple[float, float]:
    """Return the command of the inner control [m/s²].

    Args:
        kind: Code of `INNERS`.
        x, y: True p_a - p_g [m].
        own: State of the UAV.
        z_x, z_y: p_a - p_g of the newest detection [m].
        phase: Phase of periodic controls [rad].
        adversaries: Memory of the adversaries.
        u: Acceleration limit of the UAV [m/s²].
    """
    e_x, e_y = direction(x, y)
    adversary = adversaries[UAV]
    side = adversary.side
    if kind == INNERS.outward:
        return u * e_x, u * e_y
    if kind == INNERS.random:
        return adversary.u_x, adversary.u_y
    if kind == INNERS.tangential:
        return -side * u * e_y, side * u * e_x
    if kind == INNERS.outward_then_tangential:
        return (u * e_x, u * e_y) if math.sin(phase) > 0.0 else (-side * u * e_y, side * u * e_x)
    if kind == INNERS.sinusoidal:
        s, c = math.sin(phase), math.cos(phase)
        return u * (c * e_x - side * s * e_y), u * (c * e_y + side * s * e_x)
    if kind == INNERS.tracking:
        return adversary.output_x, adversary.output_y
    if kind == INNERS.still:
        return -own.v_x / 0.05, -own.v_y / 0.05
    if kind == INNERS.creeps:
        return _creep(own, adversary.heading_x, adversary.heading_y, side)
    e_x, e_y = direction(z_x, z_y)
    return u * e_x, u * e_y


@compiled
def ugv_command(
    kind: int,
    x: float,
    y: float,
    uav: State,
    w_x: float,
    w_y: float,
    adversaries: RecordArray,
    u: float,
) -> tuple[float, float]:
    """Return the UGV's command [m/s²].

    Args:
        kind: Code of `UGVS`.
        x, y: True p_a - p_g [m].
        uav: State of the UAV.
        w_x, w_y: Velocity of the UGV [m/s].
        adversaries: Memory of the adversaries.
        u: Acceleration limit of the UGV [m/s²].
    """
    e_x, e_y = direction(x, y)
    adversary = adversaries[UGV]
    side = adversary.side
    if kind == UGVS.flees:
        return -u * e_x, -u * e_y
    if kind == UGVS.straight:
        return u * adversary.heading_x, u * adversary.heading_y
    if kind == UGVS.random:
        return adversary.u_x, adversary.u_y
    if kind == UGVS.turns:
        d_x, d_y = direction(w_x, w_y)
        return u * (d_x - side * d_y) * 0.7, u * (d_y + side * d_x) * 0.7
    if kind == UGVS.dodges:
        d_x, d_y = direction(uav.v_x, uav.v_y)
        return -u * d_x, -u * d_y
    if kind == UGVS.ambush:
        outward = uav.v_x * e_x + uav.v_y * e_y
        return (-u * e_x, -u * e_y) if outward > 0.0 else (u * e_x, u * e_y)
    return brake(w_x, w_y, u, 0.05)


@compiled
def detection_error(
    kind: int,
    random: RngState,
    tick: int,
    size: float,
    x: float,
    y: float,
    adversaries: RecordArray,
) -> tuple[float, float]:
    """Return the error of one detected position [m].

    Args:
        kind: Code of `ERRORS`.
        random: State of the random number generator.
        tick: Current tick.
        size: Largest norm [m].
        x, y: True p_a - p_g [m].
        adversaries: Memory of the adversaries.
    """
    if kind == ERRORS.none:
        return 0.0, 0.0
    if kind <= ERRORS.sphere:
        angle = 2.0 * math.pi * next_share(random)
        radius = size * (math.sqrt(next_share(random)) if kind == ERRORS.ball else 1.0)
        return radius * math.cos(angle), radius * math.sin(angle)
    e_x, e_y = direction(x, y)
    if kind == ERRORS.alternating:
        sign = size if tick % 2 else -size
        return sign * e_x, sign * e_y
    if kind == ERRORS.constant:
        return size * adversaries[UGV].error_x, size * adversaries[UGV].error_y
    return size * e_x, size * e_y


@compiled
def _push(
    kind: int, blackout: int, x: float, y: float, state: BatchState, adversaries: RecordArray
) -> tuple[float, float]:
    """Return the direction of wind and position error, a unit vector. Arguments as in `disturb`."""
    e_x, e_y = direction(x, y)
    off, acting = state.vehicles[0, UAV].disturbance, state.vehicles[0, UAV].command
    if kind == WINDS.outward:
        return e_x, e_y
    if kind <= WINDS.random:
        return math.cos(adversaries[UGV].wind), math.sin(adversaries[UGV].wind)
    if kind == WINDS.pumping:
        v_x, v_y = off.error_rate[0], off.error_rate[1]
        return direction(v_x, v_y) if norm(v_x, v_y) > 0.0 else (e_x, e_y)
    if kind == WINDS.turns:
        return direction(acting[0], acting[1])
    return (e_x, e_y) if blackout > 0 else (-e_x, -e_y)


@compiled
def disturb(
    conditions: Conditions,
    state: BatchState,
    random: RngState,
    kind: int,
    blackout: int,
    x: float,
    y: float,
    adversaries: RecordArray,
) -> int:
    """Set the UAV's disturbance for the coming tick; return the code of the next direction.

    Args:
        conditions: Conditions of the attack.
        state: State of the world, updated in place.
        random: State of the random number generator.
        kind: Code of `WINDS`.
        blackout: Remaining ticks of the detections' blackout.
        x, y: True p_a - p_g [m].
        adversaries: Memory of the adversaries, updated in place.
    """
    if next_share(random) < 0.02:
        if kind == WINDS.random:
            adversaries[UGV].wind = 2.0 * math.pi * next_share(random)
        if conditions.blows == ANY and next_share(random) < 0.1:
            kind = choose(random, conditions.blows, len(WINDS))
    w_x, w_y = _push(kind, blackout, x, y, state, adversaries)
    strength, row = (
        1.0 if conditions.jumps > 0.0 else conditions.wind,
        state.vehicles[0, UAV].disturbance,
    )
    row.wind[0], row.wind[1] = strength * w_x, strength * w_y
    row.position_error[0] = -conditions.position_error * w_x
    row.position_error[1] = -conditions.position_error * w_y
    return kind


@compiled
def jump(conditions: Conditions, state: BatchState) -> None:
    """Offset the UAV from its reference in the direction of its wind."""
    row = state.vehicles[0, UAV].disturbance
    for axis in range(2):
        row.error[axis] = conditions.jumps * row.wind[axis]
        row.error_rate[axis] = 0.0
    apply_disturbance(state.vehicles[0, UAV])
