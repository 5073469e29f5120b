"""Evasive driver: tries to shake off the UAV, within the UGV's limits and with the information of a UGV.

It drives at full speed away from the UAV's position predicted for the time that the UGV needs to reverse. A UAV that
flies away is left behind. A UAV that approaches fast will have flown past by then, so the UGV reverses and drives at
it. In both cases the velocities point apart when the UAV has to brake most. The lead is 2 v/u, the UGV's own time to
reverse; it knows no limits of the UAV. In each slot of five leads it turns sharply once, for one lead, by 60° to 120°
to one side; time and direction are drawn from its key. It knows its own state and the UAV's radio messages, p_a - p_g
up to 0.2 s and a tick ago, but neither the visibility radius nor the law.

Within the margin of `wander` from the border it drops the outward component and slides along at full speed, braking
first if a wall is too near. In a corner it picks one of the two walls at random and drives along it for four leads.
Before the first message, and five seconds after the last, it wanders.

This is a heuristic, not the worst case: it looks one manoeuvre ahead and solves no game.
"""

import math
from typing import Any

from agents.drivers import wander
from agents.drivers.parameters import DriverInputs, UgvParameters
from agents.drivers.steering import velocity_control
from bus.messages.base import Vector
from bus.messages.vehicle import UgvBriefing
from bus.ticks import NO_TICK, first_tick_from, ticks_within
from sim.compiling.compile import FloatArray, compiled, constant
from sim.models.kinematics import UgvState
from sim.models.randomness import WANDER, uniform
from sim.models.vehicles import norm

_SMOOTHING = 1.0  # time constant of the UAV's estimated velocity [s]: differences of estimates are mostly noise
_FORGOTTEN = 5.0  # age at which the last message is discarded [s]
_LEAD = 1.0, 10.0  # least and largest lead [s], for a UGV that turns at once or hardly at all
_SLOT = 5.0  # leads per sharp turn
_DASH = 4.0  # leads for which it drives along a wall, out of a corner
# Indices of the draws of a slot; 0 and 1 belong to `wander`.
_BEGIN, _SIDE, _ANGLE, _WALL, _SPOT = (constant(k) for k in range(2, 7))


class Parameters(wander.Parameters, frozen=True, kw_only=True):
    """Parameters of the driver."""

    lead: float
    """Prediction time [s]."""
    memory_ticks: int
    """Age at which the last message is discarded [ticks]."""
    corner_ticks: int
    """Time for which the UGV follows a wall out of a corner [ticks]."""


class Memory(wander.Memory):
    """Memory of the driver."""

    received: float = -math.inf
    """Tick at which the newest message arrived."""
    sent: float
    """Tick to which its content refers."""
    uav: Vector
    """Position of the UAV at that tick [m]."""
    uav_velocity: Vector
    """Smoothed velocity of the UAV [m/s]."""
    exit: Vector
    """Direction out of a corner, a unit vector."""
    exit_end: float = -math.inf
    """First tick after the exit from the corner."""


def parameters(ugv: UgvParameters, briefing: UgvBriefing) -> Parameters:
    """Return the parameters of a UGV's driver."""
    plain = wander.parameters(ugv, briefing)
    lead = float(evade_lead(plain.speed, ugv.max_acceleration))
    memory_ticks, corner_ticks = evade_ticks(lead, ugv.dt)
    return Parameters(
        speed=plain.speed,
        margin=plain.margin,
        lead=lead,
        memory_ticks=memory_ticks,
        corner_ticks=corner_ticks,
    )


def evade_lead(speed: float, u_max: float) -> float:
    """Return the prediction time [s]: the time to reverse from a speed [m/s] at u_max [m/s²], within limits."""
    return min(max(2.0 * speed / u_max, _LEAD[0]), _LEAD[1])


def evade_ticks(lead: float, dt: float) -> tuple[int, int]:
    """Return the age at which the last message is discarded, and the time along a wall out of a corner [ticks]."""
    return ticks_within(_FORGOTTEN, dt), first_tick_from(_DASH * lead, dt)


@compiled
def is_known(driver: Parameters, memory: Memory, tick: int) -> bool:
    """Return whether a recent message of the UAV is known."""
    return bool(tick - memory.received <= driver.memory_ticks)


@compiled
def receive_radio(
    ugv: UgvParameters,
    driver: Parameters,
    memory: Memory,
    radio: FloatArray,
    received: int,
    tick: int,
    own: UgvState,
) -> None:
    """Update the UAV's position and smoothed velocity from the messages of this tick.

    The last of several messages wins; a message without a valid tick is ignored. Arguments as in `command`.
    """
    m: Any = memory
    for row in range(received):
        if radio[row, 0] == NO_TICK:
            continue
        at = min(max(radio[row, 0], tick - driver.memory_ticks), tick)
        age = tick * ugv.dt - at * ugv.dt
        gap = at * ugv.dt - m.sent * ugv.dt
        x = own.p_x - age * own.v_x + radio[row, 1]  # the UGV has moved since
        y = own.p_y - age * own.v_y + radio[row, 2]
        if not is_known(driver, memory, tick):
            m.uav_velocity[0], m.uav_velocity[1] = 0.0, 0.0
        elif at > m.sent:  # two messages of the same tick give no velocity
            share = gap / (_SMOOTHING + gap)
            w_x, w_y = m.uav_velocity[0], m.uav_velocity[1]
            m.uav_velocity[0] = w_x + share * ((x - m.uav[0]) / gap - w_x)
            m.uav_velocity[1] = w_y + share * ((y - m.uav[1]) / gap - w_y)
        m.uav[0], m.uav[1], m.sent, m.received = x, y, at, tick


@compiled
def slot_draw(
    ugv: UgvParameters, driver: Parameters, memory: Memory, tick: int, index: int
) -> float:
    """Draw a number in [0, 1) for the slot of this tick; a slot is five leads long."""
    slot = int(tick * ugv.dt / (_SLOT * driver.lead))
    return uniform((memory.key_0, memory.key_1), WANDER, slot, index)


@compiled
def away(
    ugv: UgvParameters, driver: Parameters, memory: Memory, tick: int, own: UgvState
) -> tuple[float, float]:
    """Return the unit vector away from the UAV's predicted position after the lead."""
    m: Any = memory
    gap = tick * ugv.dt + driver.lead - m.sent * ugv.dt
    x = own.p_x - (m.uav[0] + gap * m.uav_velocity[0])
    y = own.p_y - (m.uav[1] + gap * m.uav_velocity[1])
    length = norm(x, y)
    if length > 0.0:
        return x / length, y / length
    # directly below the UAV, any direction will do
    angle = math.tau * slot_draw(ugv, driver, memory, tick, _SPOT)
    return math.cos(angle), math.sin(angle)


@compiled
def turned(
    ugv: UgvParameters, driver: Parameters, memory: Memory, x: float, y: float, tick: int
) -> tuple[float, float]:
    """Return the direction (x, y), turned sharply for one lead of each slot."""
    lead = driver.lead
    begin = (_SLOT - 1.0) * lead * slot_draw(ugv, driver, memory, tick, _BEGIN)
    if not begin <= tick * ugv.dt % (_SLOT * lead) < begin + lead:
        return x, y
    angle = math.radians(60.0 + 60.0 * slot_draw(ugv, driver, memory, tick, _ANGLE))
    if slot_draw(ugv, driver, memory, tick, _SIDE) < 0.5:
        angle = -angle
    cos, sin = math.cos(angle), math.sin(angle)
    return x * cos - y * sin, x * sin + y * cos


@compiled
def border_side(at: float, size: float, margin: float) -> float:
    """Return the sign of the side of one axis that is nearer than the margin, or 0; all in [m]."""
    if at > size - margin:
        return 1.0
    return -1.0 if at < margin else 0.0


@compiled
def leave_wall(
    ugv: UgvParameters, driver: Parameters, memory: Memory, out_x: float, out_y: float, tick: int
) -> tuple[float, float]:
    """Return the direction along a wall, for a UGV in a corner or facing a wall, and keep it for a while.

    Args:
        ugv, driver: Constants of the UGV, and parameters of the driver.
        memory: Changed in place.
        out_x, out_y: Nearby sides, from `border_side`.
        tick: Current tick.
    """
    side = 1.0 if slot_draw(ugv, driver, memory, tick, _WALL) < 0.5 else -1.0
    if out_x == 0.0 or out_y == 0.0:
        x, y = side * out_y, side * out_x
    elif side > 0.0:
        x, y = -out_x, 0.0
    else:
        x, y = 0.0, -out_y
    corner: Any = memory.exit
    corner[0], corner[1], memory.exit_end = x, y, tick + driver.corner_ticks
    return x, y


@compiled
def off_walls(ugv: UgvParameters, w_x: float, w_y: float, own: UgvState) -> tuple[float, float]:
    """Return the desired velocity [m/s], or one that first brakes towards a wall that would otherwise be hit.

    Args:
        ugv: Constants of the UGV.
        w_x, w_y: Desired velocity [m/s].
        own: State of the UGV.
    """
    v_x, v_y = own.v_x, own.v_y
    # stopping distance over speed [s]
    halting = 0.5 * norm(v_x, v_y) / ugv.max_acceleration + 2.0 * ugv.dt
    stop_x = abs(v_x) * halting > (ugv.width - own.p_x if v_x > 0.0 else own.p_x)
    stop_y = abs(v_y) * halting > (ugv.height - own.p_y if v_y > 0.0 else own.p_y)
    if stop_x or stop_y:
        return (0.0 if stop_x else v_x), (0.0 if stop_y else v_y)
    return w_x, w_y


@compiled
def flee(
    ugv: UgvParameters,
    driver: Parameters,
    memory: Memory,
    x: float,
    y: float,
    tick: int,
    own: UgvState,
) -> tuple[float, float]:
    """Return the acceleration [m/s²] to full speed in the direction (x, y), along walls and out of corners.

    The other arguments are as in `command`.
    """
    m: Any = memory
    if tick < m.exit_end:
        x, y = m.exit[0], m.exit[1]
    out_x = border_side(own.p_x, ugv.width, driver.margin)
    out_y = border_side(own.p_y, ugv.height, driver.margin)
    x, y = (0.0 if out_x * x > 0.0 else x), (0.0 if out_y * y > 0.0 else y)
    length = norm(x, y)
    if length > 0.0:
        x, y = x / length, y / length
    else:
        x, y = leave_wall(ugv, driver, memory, out_x, out_y, tick)
    w_x, w_y = off_walls(ugv, x * driver.speed, y * driver.speed, own)
    return velocity_control(ugv, own, w_x, w_y)


@compiled
def command(
    ugv: UgvParameters,
    driver: Parameters,
    memory: Memory,
    inputs: DriverInputs,
) -> tuple[float, float]:
    """Return the acceleration that evades the UAV; wander while its position is unknown [m/s²]."""
    tick, own = inputs.tick, inputs.own
    receive_radio(ugv, driver, memory, inputs.radio, inputs.received, tick, own)
    if not is_known(driver, memory, tick):
        return wander.wander_command(ugv, driver, memory, tick, own)
    x, y = away(ugv, driver, memory, tick, own)
    x, y = turned(ugv, driver, memory, x, y, tick)
    return flee(ugv, driver, memory, x, y, tick, own)
