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

from agents.drivers.parameters import DriverParameters
from agents.drivers.steering import velocity_control
from agents.drivers.wander import wander_control
from bus.ticks import NO_TICK, first_tick_from, ticks_within
from sim.kernels.compile import FloatArray, compiled, constant
from sim.kernels.records import RecordArray
from sim.models.randomness import WANDER, uniform
from sim.models.vehicles import Motion, norm

_SMOOTHING = 1.0  # time constant of the UAV's estimated velocity [s]: a difference of two estimates is mostly noise
_FORGOTTEN = 5.0  # after so long without a message [s] the last one says nothing any more
_LEAD = 1.0, 10.0  # least and largest lead [s], for a UGV that turns at once or hardly at all
_SLOT = 5.0  # one sharp turn in so many leads
_DASH = 4.0  # out of a corner it drives along a wall for so many leads
# Indices of the draws of a slot; 0 and 1 are the wanderer's.
_BEGIN, _SIDE, _ANGLE, _WALL, _SPOT = (constant(k) for k in range(2, 7))


@compiled
def is_known(parameters: DriverParameters, memory: RecordArray, tick: int) -> bool:
    """True if there has been a message of the UAV, and not too long ago."""
    return bool(tick - memory[0].received <= parameters.forgotten)


@compiled
def receive_radio(
    parameters: DriverParameters,
    memory: RecordArray,
    radio: FloatArray,
    received: int,
    tick: int,
    here: Motion,
) -> None:
    """Take in what has come at this tick: place and smoothed velocity of the UAV.

    Of several, that which came last; one whose time is none of a tick is used for nothing. Arguments as in
    `evade_control`.
    """
    m = memory[0]
    for row in range(received):
        if radio[row, 0] == NO_TICK:
            continue
        at = min(max(radio[row, 0], tick - parameters.forgotten), tick)
        age = tick * parameters.dt - at * parameters.dt
        gap = at * parameters.dt - m.at * parameters.dt
        x = here.p_x - age * here.v_x + radio[row, 1]  # the UGV has driven on since
        y = here.p_y - age * here.v_y + radio[row, 2]
        if not is_known(parameters, memory, tick):
            m.uav_v_x, m.uav_v_y = 0.0, 0.0
        elif at > m.at:  # of two messages of one tick the difference says nothing
            share = gap / (_SMOOTHING + gap)
            w_x, w_y = m.uav_v_x, m.uav_v_y
            m.uav_v_x = w_x + share * ((x - m.uav_x) / gap - w_x)
            m.uav_v_y = w_y + share * ((y - m.uav_y) / gap - w_y)
        m.uav_x, m.uav_y, m.at, m.received = x, y, at, tick


@compiled
def slot_draw(parameters: DriverParameters, tick: int, index: int) -> float:
    """A number in [0, 1) for the slot of this tick; a slot is five leads long."""
    slot = int(tick * parameters.dt / (_SLOT * parameters.lead))
    return uniform((parameters.key_0, parameters.key_1), WANDER, slot, index)


@compiled
def away(
    parameters: DriverParameters, memory: RecordArray, tick: int, here: Motion
) -> tuple[float, float]:
    """Away from where the UAV will be after the lead if it flies on as it does; a unit vector."""
    m = memory[0]
    gap = tick * parameters.dt + parameters.lead - m.at * parameters.dt
    x = here.p_x - (m.uav_x + gap * m.uav_v_x)
    y = here.p_y - (m.uav_y + gap * m.uav_v_y)
    length = norm(x, y)
    if length > 0.0:
        return x / length, y / length
    # right below it: any direction is as good
    angle = math.tau * slot_draw(parameters, tick, _SPOT)
    return math.cos(angle), math.sin(angle)


@compiled
def turned(parameters: DriverParameters, x: float, y: float, tick: int) -> tuple[float, float]:
    """The direction (x, y), turned off sharply for one lead of each slot."""
    lead = parameters.lead
    begin = (_SLOT - 1.0) * lead * slot_draw(parameters, tick, _BEGIN)
    if not begin <= tick * parameters.dt % (_SLOT * lead) < begin + lead:
        return x, y
    angle = math.radians(60.0 + 60.0 * slot_draw(parameters, tick, _ANGLE))
    if slot_draw(parameters, tick, _SIDE) < 0.5:
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
    parameters: DriverParameters, memory: RecordArray, out_x: float, out_y: float, tick: int
) -> tuple[float, float]:
    """Off a wall that it stands square to, or out of a corner: along a wall, and it stays with that for a while.

    Args:
        parameters: Of the driver.
        memory: `DriverMemory`, changed in place. Shape (1,).
        out_x, out_y: The sides it is near to, of `border_side`.
        tick: Now.
    """
    side = 1.0 if slot_draw(parameters, tick, _WALL) < 0.5 else -1.0
    if out_x == 0.0 or out_y == 0.0:
        x, y = side * out_y, side * out_x
    elif side > 0.0:
        x, y = -out_x, 0.0
    else:
        x, y = 0.0, -out_y
    memory[0].out_x, memory[0].out_y, memory[0].out_end = x, y, tick + parameters.dash
    return x, y


@compiled
def off_walls(
    parameters: DriverParameters, w_x: float, w_y: float, here: Motion
) -> tuple[float, float]:
    """The wanted velocity [m/s], but where a wall would be hit else: to brake towards it first, and turn only then.

    Args:
        parameters: Of the driver.
        w_x, w_y: The wanted velocity [m/s].
        here: Where the UGV is.
    """
    v_x, v_y = here.v_x, here.v_y
    # way to a stop over speed [s]
    halting = 0.5 * norm(v_x, v_y) / parameters.u_max + 2.0 * parameters.dt
    stop_x = abs(v_x) * halting > (parameters.width - here.p_x if v_x > 0.0 else here.p_x)
    stop_y = abs(v_y) * halting > (parameters.height - here.p_y if v_y > 0.0 else here.p_y)
    if stop_x or stop_y:
        return (0.0 if stop_x else v_x), (0.0 if stop_y else v_y)
    return w_x, w_y


@compiled
def flee(
    parameters: DriverParameters, memory: RecordArray, x: float, y: float, tick: int, here: Motion
) -> tuple[float, float]:
    """The acceleration [m/s²] to full speed in the direction (x, y), but along walls and out of corners.

    The other arguments are those of `evade_control`.
    """
    m = memory[0]
    if tick < m.out_end:
        x, y = m.out_x, m.out_y
    out_x = border_side(here.p_x, parameters.width, parameters.margin)
    out_y = border_side(here.p_y, parameters.height, parameters.margin)
    x, y = (0.0 if out_x * x > 0.0 else x), (0.0 if out_y * y > 0.0 else y)
    length = norm(x, y)
    if length > 0.0:
        x, y = x / length, y / length
    else:
        x, y = leave_wall(parameters, memory, out_x, out_y, tick)
    w_x, w_y = off_walls(parameters, x * parameters.speed, y * parameters.speed, here)
    return velocity_control(
        here.v_x, here.v_y, w_x, w_y, parameters.v_max, parameters.u_max, parameters.dt
    )


@compiled
def evade_control(
    parameters: DriverParameters,
    memory: RecordArray,
    radio: FloatArray,
    received: int,
    tick: int,
    here: Motion,
) -> tuple[float, float]:
    """The acceleration [m/s²] of the evader, as the head of this file tells.

    Args:
        parameters: Of the driver.
        memory: `DriverMemory`, changed in place. Shape (1,).
        radio: The tick and p_a - p_g [m] of each message that has come at this tick, shape (rows, 3).
        received: How many rows count.
        tick: Now.
        here: Where the UGV is.
    """
    receive_radio(parameters, memory, radio, received, tick, here)
    if not is_known(parameters, memory, tick):
        return wander_control(parameters, memory, tick, here)
    x, y = away(parameters, memory, tick, here)
    x, y = turned(parameters, x, y, tick)
    return flee(parameters, memory, x, y, tick, here)


def evade_lead(speed: float, u_max: float) -> float:
    """Time that it looks ahead [s]: its own to reverse from its speed [m/s] at its bound [m/s²], within limits."""
    return min(max(2.0 * speed / u_max, _LEAD[0]), _LEAD[1])


def evade_ticks(lead: float, dt: float) -> tuple[int, int]:
    """Ticks after which the last message says nothing any more, and for which it leaves a corner along a wall."""
    return ticks_within(_FORGOTTEN, dt), first_tick_from(_DASH * lead, dt)
