"""The adversaries of an attack: inner control, UGV, errors of detections, wind and own position, compiled."""

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
from outrider_falsify.draws import Words, next_share
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray
from sim.engine.world_state import BatchState
from sim.engine.world_tick import apply_disturbance
from sim.models.vehicles import Motion, brake, norm

UAV, UGV = 0, 1
"""Rows of the adversaries' memory, and of the vehicles in the world."""


class Plot(NamedTuple):
    """An adversary's memory, a row each for the one in the UAV and the one in the UGV."""

    u_x: float
    u_y: float
    """An acceleration that is drawn now and then [m/s²]."""
    side: float
    """1.0 or -1.0, drawn with it: left or right."""
    output_x: float
    output_y: float
    """The command of (15) [m/s²]."""
    heading_x: float
    heading_y: float
    """Of the UGV: a direction; of the UAV: a residual velocity [m/s]. Drawn once."""
    error_x: float
    error_y: float
    """Direction of constant errors, drawn once."""
    wind: float
    """Angle of wind and own position [rad]."""
    losing: float
    """Of `loses`: ALIVE, or the tick of the first motion that was lost."""


@compiled
def choose(random: Words, wanted: int, count: int) -> int:
    """The wanted code, or where it is ANY one that is drawn among so many."""
    return wanted if wanted >= 0 else int(next_share(random) * count)


@compiled
def draw_direction(random: Words) -> tuple[float, float]:
    """A unit vector, evenly over all angles."""
    angle = 2.0 * math.pi * next_share(random)
    return math.cos(angle), math.sin(angle)


@compiled
def direction(x: float, y: float) -> tuple[float, float]:
    """The unit vector along another; (1, 0) for none."""
    length = norm(x, y)
    if length == 0.0:
        return 1.0, 0.0
    return x / length, y / length


@compiled
def redraw(random: Words, plots: RecordArray, k: int, u: float) -> None:
    """Draw an adversary's acceleration, of at most u [m/s²], and its side anew."""
    angle, strength = 2.0 * math.pi * next_share(random), u * min(1.0, 2.0 * next_share(random))
    plot = plots[k]
    plot.u_x, plot.u_y = strength * math.cos(angle), strength * math.sin(angle)
    plot.side = 1.0 if next_share(random) < 0.5 else -1.0


@compiled
def draw_creep(random: Words) -> tuple[float, float]:
    """Return a velocity as small as what rounding leaves [m/s], mostly towards the wall y = 0."""
    pace = 10.0 ** (4.0 * next_share(random) - 12.0)
    e_x, e_y = draw_direction(random)
    return (0.0, -pace) if next_share(random) < 0.7 else (pace * e_x, pace * e_y)


@compiled
def _creep(here: Motion, c_x: float, c_y: float, side: float) -> tuple[float, float]:
    """Return the command that keeps the UAV at a residual velocity [m/s²].

    Args:
        here: The UAV.
        c_x, c_y: The residual velocity [m/s].
        side: 1.0: push back while the safety filter moves the UAV; -1.0: do nothing then.
    """
    speed, pace = norm(here.v_x, here.v_y), norm(c_x, c_y)
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
    here: Motion,
    z_x: float,
    z_y: float,
    phase: float,
    plots: RecordArray,
    u: float,
) -> tuple[float, float]:
    """The command that the inner control wants [m/s²].

    Args:
        kind: A code of `INNERS`.
        x, y: The true p_a - p_g [m].
        here: The UAV.
        z_x, z_y: That of the newest detection [m].
        phase: Of what swings [rad].
        plots: The adversaries' memory.
        u: The UAV's bound [m/s²].
    """
    e_x, e_y = direction(x, y)
    plot = plots[UAV]
    side = plot.side
    if kind == INNERS.outward:
        return u * e_x, u * e_y
    if kind == INNERS.random:
        return plot.u_x, plot.u_y
    if kind == INNERS.tangential:
        return -side * u * e_y, side * u * e_x
    if kind == INNERS.outward_then_tangential:
        return (u * e_x, u * e_y) if math.sin(phase) > 0.0 else (-side * u * e_y, side * u * e_x)
    if kind == INNERS.sinusoidal:
        s, c = math.sin(phase), math.cos(phase)
        return u * (c * e_x - side * s * e_y), u * (c * e_y + side * s * e_x)
    if kind == INNERS.tracking:
        return plot.output_x, plot.output_y
    if kind == INNERS.still:
        return -here.v_x / 0.05, -here.v_y / 0.05
    if kind == INNERS.creeps:
        return _creep(here, plot.heading_x, plot.heading_y, side)
    e_x, e_y = direction(z_x, z_y)
    return u * e_x, u * e_y


@compiled
def ugv_command(
    kind: int,
    x: float,
    y: float,
    here: Motion,
    w_x: float,
    w_y: float,
    plots: RecordArray,
    u: float,
) -> tuple[float, float]:
    """The UGV's command [m/s²].

    Args:
        kind: A code of `UGVS`.
        x, y: The true p_a - p_g [m].
        here: The UAV.
        w_x, w_y: The UGV's velocity [m/s].
        plots: The adversaries' memory.
        u: The UGV's bound [m/s²].
    """
    e_x, e_y = direction(x, y)
    plot = plots[UGV]
    side = plot.side
    if kind == UGVS.flees:
        return -u * e_x, -u * e_y
    if kind == UGVS.straight:
        return u * plot.heading_x, u * plot.heading_y
    if kind == UGVS.random:
        return plot.u_x, plot.u_y
    if kind == UGVS.turns:
        d_x, d_y = direction(w_x, w_y)
        return u * (d_x - side * d_y) * 0.7, u * (d_y + side * d_x) * 0.7
    if kind == UGVS.dodges:
        d_x, d_y = direction(here.v_x, here.v_y)
        return -u * d_x, -u * d_y
    if kind == UGVS.ambush:
        outward = here.v_x * e_x + here.v_y * e_y
        return (-u * e_x, -u * e_y) if outward > 0.0 else (u * e_x, u * e_y)
    return brake(w_x, w_y, u, 0.05)


@compiled
def detection_error(
    kind: int,
    random: Words,
    tick: int,
    size: float,
    x: float,
    y: float,
    plots: RecordArray,
) -> tuple[float, float]:
    """The error of one detected position [m].

    Args:
        kind: A code of `ERRORS`.
        random: Of the draws.
        tick: Now.
        size: The largest norm [m].
        x, y: The true p_a - p_g [m].
        plots: The adversaries' memory.
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
        return size * plots[UGV].error_x, size * plots[UGV].error_y
    return size * e_x, size * e_y


@compiled
def _push(
    kind: int, dark: int, x: float, y: float, state: BatchState, plots: RecordArray
) -> tuple[float, float]:
    """The way in which wind and own position drive the UAV, a unit vector. Arguments as in `disturb`."""
    e_x, e_y = direction(x, y)
    off, acting = state.vehicles[0, UAV].disturbance, state.vehicles[0, UAV].command
    if kind == WINDS.outward:
        return e_x, e_y
    if kind <= WINDS.random:
        return math.cos(plots[UGV].wind), math.sin(plots[UGV].wind)
    if kind == WINDS.pumping:
        v_x, v_y = off.error_rate[0], off.error_rate[1]
        return direction(v_x, v_y) if norm(v_x, v_y) > 0.0 else (e_x, e_y)
    if kind == WINDS.turns:
        return direction(acting[0], acting[1])
    return (e_x, e_y) if dark > 0 else (-e_x, -e_y)


@compiled
def disturb(
    conditions: Conditions,
    state: BatchState,
    random: Words,
    kind: int,
    dark: int,
    x: float,
    y: float,
    plots: RecordArray,
) -> int:
    """Set what acts on the UAV beside its commands in the coming tick; how the next one is directed.

    Args:
        conditions: The conditions.
        state: The world, changed.
        random: Of the draws.
        kind: A code of `WINDS`.
        dark: Ticks for which nothing is detected yet.
        x, y: The true p_a - p_g [m].
        plots: The adversaries' memory, changed.
    """
    if next_share(random) < 0.02:
        if kind == WINDS.random:
            plots[UGV].wind = 2.0 * math.pi * next_share(random)
        if conditions.blows == ANY and next_share(random) < 0.1:
            kind = choose(random, conditions.blows, len(WINDS))
    w_x, w_y = _push(kind, dark, x, y, state, plots)
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
    """Put the UAV off what it is told, the way that its wind blows."""
    row = state.vehicles[0, UAV].disturbance
    for axis in range(2):
        row.error[axis] = conditions.jumps * row.wind[axis]
        row.error_rate[axis] = 0.0
    apply_disturbance(state.vehicles[0, UAV])
