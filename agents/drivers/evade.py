"""The adversary at the wheel: tries to shake the UAV off, within the UGV's limits and by what a UGV may know.

It drives at full speed away from where the UAV will be by the time the UGV has turned round. A UAV that flies off is
left behind; one that comes up fast will have flown past by then, so the UGV reverses and drives at it: either way the
two velocities point apart when the UAV has most to brake. The lead is 2 v/u, the UGV's own time to reverse: it knows
no bound of the UAV. In each slot of five leads it turns off sharply once, for one lead, by 60° to 120° to one side;
when and where to is drawn from its key. It knows its own state and what the UAV radios, p_a - p_g up to 0.2 s and a
tick ago, and neither the visibility radius nor the law.

Within the wanderer's margin of the border it drops what points outward and slides along at full speed, braking first
where a wall is too near; in a corner it picks one of the two walls at random and drives out along it for four leads.
Before the first message, and five seconds after the last one, it wanders.

It is a heuristic, not the worst case: it looks one manoeuvre ahead and solves no game.
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
from sim.models.randomness import WANDER, uniform
from sim.models.vehicles import Motion, norm

_SMOOTHING = 1.0  # time constant of the UAV's estimated velocity [s]: a difference of two estimates is mostly noise
_FORGOTTEN = 5.0  # after so long without a message [s] the last one says nothing any more
_LEAD = 1.0, 10.0  # least and largest lead [s], for a UGV that turns at once or hardly at all
_SLOT = 5.0  # one sharp turn in so many leads
_DASH = 4.0  # out of a corner it drives along a wall for so many leads
# Indices of the draws of a slot; 0 and 1 are the wanderer's.
_BEGIN, _SIDE, _ANGLE, _WALL, _SPOT = (constant(k) for k in range(2, 7))


class Parameters(wander.Parameters, frozen=True, kw_only=True):
    """Parameters of the driver."""

    lead: float
    """Time that it looks ahead [s]."""
    memory_ticks: int
    """Age at which the last message loses its meaning [ticks]."""
    corner_ticks: int
    """Time for which it leaves a corner along a wall [ticks]."""


class Memory(wander.Memory):
    """Memory of the driver."""

    received: float = -math.inf
    """Tick at which the newest message came."""
    sent: float
    """Tick of its content."""
    uav: Vector
    """Position of the UAV then [m]."""
    uav_velocity: Vector
    """Its smoothed velocity [m/s]."""
    exit: Vector
    """Direction out of a corner."""
    exit_end: float = -math.inf
    """First tick for which that does not count."""


def parameters(ugv: UgvParameters, briefing: UgvBriefing) -> Parameters:
    """Return the parameters of the driver of a UGV."""
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
    """Time that it looks ahead [s]: its own to reverse from its speed [m/s] at its bound [m/s²], within limits."""
    return min(max(2.0 * speed / u_max, _LEAD[0]), _LEAD[1])


def evade_ticks(lead: float, dt: float) -> tuple[int, int]:
    """Ticks after which the last message says nothing any more, and for which it leaves a corner along a wall."""
    return ticks_within(_FORGOTTEN, dt), first_tick_from(_DASH * lead, dt)


@compiled
def is_known(driver: Parameters, memory: Memory, tick: int) -> bool:
    """True if there has been a message of the UAV, and not too long ago."""
    return bool(tick - memory.received <= driver.memory_ticks)


@compiled
def receive_radio(
    ugv: UgvParameters,
    driver: Parameters,
    memory: Memory,
    radio: FloatArray,
    received: int,
    tick: int,
    here: Motion,
) -> None:
    """Take in what has come at this tick: place and smoothed velocity of the UAV.

    Of several, that which came last; one whose time is none of a tick is used for nothing. Arguments as in
    `command`.
    """
    m: Any = memory
    for row in range(received):
        if radio[row, 0] == NO_TICK:
            continue
        at = min(max(radio[row, 0], tick - driver.memory_ticks), tick)
        age = tick * ugv.dt - at * ugv.dt
        gap = at * ugv.dt - m.sent * ugv.dt
        x = here.p_x - age * here.v_x + radio[row, 1]  # the UGV has driven on since
        y = here.p_y - age * here.v_y + radio[row, 2]
        if not is_known(driver, memory, tick):
            m.uav_velocity[0], m.uav_velocity[1] = 0.0, 0.0
        elif at > m.sent:  # of two messages of one tick the difference says nothing
            share = gap / (_SMOOTHING + gap)
            w_x, w_y = m.uav_velocity[0], m.uav_velocity[1]
            m.uav_velocity[0] = w_x + share * ((x - m.uav[0]) / gap - w_x)
            m.uav_velocity[1] = w_y + share * ((y - m.uav[1]) / gap - w_y)
        m.uav[0], m.uav[1], m.sent, m.received = x, y, at, tick


@compiled
def slot_draw(
    ugv: UgvParameters, driver: Parameters, memory: Memory, tick: int, index: int
) -> float:
    """A number in [0, 1) for the slot of this tick; a slot is five leads long."""
    slot = int(tick * ugv.dt / (_SLOT * driver.lead))
    return uniform((memory.key_0, memory.key_1), WANDER, slot, index)


@compiled
def away(
    ugv: UgvParameters, driver: Parameters, memory: Memory, tick: int, here: Motion
) -> tuple[float, float]:
    """Away from where the UAV will be after the lead if it flies on as it does; a unit vector."""
    m: Any = memory
    gap = tick * ugv.dt + driver.lead - m.sent * ugv.dt
    x = here.p_x - (m.uav[0] + gap * m.uav_velocity[0])
    y = here.p_y - (m.uav[1] + gap * m.uav_velocity[1])
    length = norm(x, y)
    if length > 0.0:
        return x / length, y / length
    # right below it: any direction is as good
    angle = math.tau * slot_draw(ugv, driver, memory, tick, _SPOT)
    return math.cos(angle), math.sin(angle)


@compiled
def turned(
    ugv: UgvParameters, driver: Parameters, memory: Memory, x: float, y: float, tick: int
) -> tuple[float, float]:
    """The direction (x, y), turned off sharply for one lead of each slot."""
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
    """The sign of the side of one axis that is nearer than the margin, or 0; all in [m]."""
    if at > size - margin:
        return 1.0
    return -1.0 if at < margin else 0.0


@compiled
def leave_wall(
    ugv: UgvParameters, driver: Parameters, memory: Memory, out_x: float, out_y: float, tick: int
) -> tuple[float, float]:
    """Off a wall that it stands square to, or out of a corner: along a wall, and it stays with that for a while.

    Args:
        ugv, driver: Constants of the UGV, and parameters of the driver.
        memory: Changed in place.
        out_x, out_y: The sides it is near to, of `border_side`.
        tick: Now.
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
def off_walls(ugv: UgvParameters, w_x: float, w_y: float, here: Motion) -> tuple[float, float]:
    """The wanted velocity [m/s], but where a wall would be hit else: to brake towards it first, and turn only then.

    Args:
        ugv: Constants of the UGV.
        w_x, w_y: The wanted velocity [m/s].
        here: Where the UGV is.
    """
    v_x, v_y = here.v_x, here.v_y
    # way to a stop over speed [s]
    halting = 0.5 * norm(v_x, v_y) / ugv.max_acceleration + 2.0 * ugv.dt
    stop_x = abs(v_x) * halting > (ugv.width - here.p_x if v_x > 0.0 else here.p_x)
    stop_y = abs(v_y) * halting > (ugv.height - here.p_y if v_y > 0.0 else here.p_y)
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
    here: Motion,
) -> tuple[float, float]:
    """The acceleration [m/s²] to full speed in the direction (x, y), but along walls and out of corners.

    The other arguments are those of `command`.
    """
    m: Any = memory
    if tick < m.exit_end:
        x, y = m.exit[0], m.exit[1]
    out_x = border_side(here.p_x, ugv.width, driver.margin)
    out_y = border_side(here.p_y, ugv.height, driver.margin)
    x, y = (0.0 if out_x * x > 0.0 else x), (0.0 if out_y * y > 0.0 else y)
    length = norm(x, y)
    if length > 0.0:
        x, y = x / length, y / length
    else:
        x, y = leave_wall(ugv, driver, memory, out_x, out_y, tick)
    w_x, w_y = off_walls(ugv, x * driver.speed, y * driver.speed, here)
    return velocity_control(
        here.v_x, here.v_y, w_x, w_y, ugv.max_speed, ugv.max_acceleration, ugv.dt
    )


@compiled
def command(
    ugv: UgvParameters,
    driver: Parameters,
    memory: Memory,
    inputs: DriverInputs,
    tick: int,
    own: Motion,
) -> tuple[float, float]:
    """Return the command [m/s²].

    Args:
        ugv: Constants of the UGV.
        driver: Parameters of this driver.
        memory: Changed in place.
        inputs: Goals, script, and what reaches the UGV at this tick.
        tick: Now.
        own: State of the UGV.
    """
    receive_radio(ugv, driver, memory, inputs.radio, inputs.received, tick, own)
    if not is_known(driver, memory, tick):
        return wander.wander_command(ugv, driver, memory, tick, own)
    x, y = away(ugv, driver, memory, tick, own)
    x, y = turned(ugv, driver, memory, x, y, tick)
    return flee(ugv, driver, memory, x, y, tick, own)
