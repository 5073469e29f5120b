"""Roles of a team's UAVs, compiled: who guards, who scouts, and who returns.

docs/explanation/proof.md proves that a team with guards does not run out of them.

R1: a UAV begins to guard only in a tick that its own filter certifies, with a number above all that it has heard.
R2: a guard's commands pass the filter. R3: a guard stops only after it has heard numbers above its own from g different
UAVs, each a certified guard within the silence. R4: a process that rejoins reads its stored number, and guards unless
it has none.
"""

import math

from agents.safety.memory import FilterMemory, reset_memory, restart_memory
from agents.safety.trajectories import servo
from agents.team.records import (
    AWAY,
    CALL,
    GUARD,
    RELIEF,
    RELIEVE,
    SCOUT,
    Mate,
    OwnRole,
    TeamMemory,
    TeamParameters,
)
from agents.uav_inputs import DETECTION, TeamInputs, TeamPacket, UavInputs
from bus.messages.team import MOST_UAVS
from sim.compiling.compile import compiled
from sim.models.altitude import VerticalState
from sim.models.endurance import RESERVE, is_at_base, reach_time, return_time
from sim.models.safety import SafetyBounds
from sim.models.vehicles import State, norm

_ASKS = 0.5
"""Size of a request in an action from which it counts."""


@compiled
def hear(memory: TeamMemory, row: int, message: TeamPacket) -> None:
    """Record a team-mate's message, in any order of arrival; `row`: row of this UAV in the team."""
    own, mate = memory.own[0], memory.mates[message.sender]
    mate.number = max(mate.number, message.number)
    if message.tick > mate.tick:
        mate.tick, mate.x, mate.y = message.tick, message.x, message.y
        mate.role, mate.charge = message.role, message.charge
    if message.certified:
        mate.guard_tick = max(mate.guard_tick, message.tick)
    if message.asks == row:
        own.asked_tick = max(own.asked_tick, message.tick)
    if message.measured > own.known_tick:
        own.known_tick, own.known_x, own.known_y = message.measured, message.g_x, message.g_y


@compiled
def _record_own(memory: TeamMemory, inputs: UavInputs) -> bool:
    """Record own position and own measurements; return True if one of them is new."""
    own, track, tick = memory.own[0], memory.track, inputs.tick
    depth, new = track.shape[0], False
    row = track[tick % depth]
    row[0], row[1], row[2] = tick, inputs.own.p_x, inputs.own.p_y
    for n in range(inputs.received):
        detection = inputs.detections[n]
        taken = int(detection[DETECTION.taken])
        was = track[taken % depth]
        if taken <= own.own_tick or was[0] != taken:
            continue
        x, y, new = was[1] - detection[DETECTION.x], was[2] - detection[DETECTION.y], True
        own.own_tick, own.own_x, own.own_y = taken, x, y
        if taken > own.known_tick:
            own.known_tick, own.known_x, own.known_y = taken, x, y
    return new


@compiled
def _hears_guards(parameters: TeamParameters, memory: TeamMemory, tick: int, above: int) -> bool:
    """Return whether g team-mates with numbers above this one were certified guards within the silence."""
    count = 0
    for k in range(memory.mates.shape[0]):
        mate = memory.mates[k]
        recent = mate.guard_tick >= 0 and tick - mate.guard_tick <= parameters.silence_ticks
        if k != parameters.row and recent and mate.number > above:
            count += 1
    return count >= parameters.guards


@compiled
def is_released(parameters: TeamParameters, memory: TeamMemory, tick: int) -> bool:
    """Return whether a guard may stop (R3).

    A greater number alone is not enough: its UAV may have left with its charge exhausted.
    """
    return _hears_guards(parameters, memory, tick, memory.own[0].number)


@compiled
def asked_role(request: float) -> int:
    """Return the code of the `Request` in an action: from 0.5 on to guard, up to -0.5 to be relieved; else 0."""
    return CALL if request >= _ASKS else RELIEVE if request <= -_ASKS else 0


@compiled
def receive_request(memory: TeamMemory, request: int, tick: int) -> None:
    """Record an operator's request; called before `change_role`.

    It has the effect of a team-mate's request or of a low charge: it may add a guard, and never ends a watch.

    Args:
        memory: Memory of the UAV, changed in place.
        request: Code of a `Request`; 0: none.
        tick: Current tick.
    """
    own = memory.own[0]
    if request == CALL:
        own.awaited = True
    elif request == RELIEVE:
        own.leaving = True
    if own.awaited and (own.role != AWAY or own.spare > own.lead):
        own.awaited, own.asked_tick = False, tick
        if own.role == AWAY:
            own.role = SCOUT


@compiled
def change_role(parameters: TeamParameters, memory: TeamMemory, number: int, tick: int) -> None:
    """Change the role by the stored number and by what has been heard.

    Args:
        parameters: Constants of the UAV.
        memory: Memory of the UAV, changed in place.
        number: Its number, as stored last.
        tick: Current tick.
    """
    own = memory.own[0]
    if number > own.number:  # another process has stored it, or a late command of this one
        own.number, own.role = number, GUARD
    elif own.unsent and number < own.number:
        own.withdrawn, own.number = max(own.withdrawn, own.number), number
        own.role = GUARD if number > 0 else RELIEF
    own.unsent = False
    # a withdrawn number may still be stored: the filter goes on until the UAV accepts again
    held = own.withdrawn > own.number
    if own.since < 0:
        own.since = tick
        if own.home and number == 0:
            own.role = SCOUT
    silence = parameters.silence_ticks
    alone = own.known_tick < 0 or tick - own.known_tick > silence
    alone = alone or not _hears_guards(parameters, memory, tick, -1)
    free = AWAY if math.isfinite(own.charge) else SCOUT
    asked = own.asked_tick >= 0 and tick - own.asked_tick <= silence
    own.called = own.role in (SCOUT, RELIEF) and (asked or (own.called and own.role == RELIEF))
    if own.role == GUARD and is_released(parameters, memory, tick):
        own.role = RELIEF if held else free
    elif own.role == SCOUT and (own.called or (alone and tick - own.since > silence)):
        own.role = RELIEF
    elif own.role == AWAY and alone and own.spare > own.lead:
        own.role = RELIEF
    elif own.role == RELIEF and not (alone or held or own.called):  # later calls may be lost
        own.role = free
    if own.role == AWAY and own.home and own.charge >= parameters.endurance.endurance:
        own.role = SCOUT
    elif own.role in (RELIEF, GUARD) and own.spare <= 0.0:
        own.role = AWAY


@compiled
def _readiness(mate: Mate) -> int:
    """Return 2 if a team-mate returns to the UGV already, 1 if it is a scout and can be asked for relief, else 0."""
    if mate.tick < 0:
        return 0
    return 2 if mate.role == RELIEF else 1 if mate.role == SCOUT else 0


@compiled
def ask(parameters: TeamParameters, memory: TeamMemory) -> None:
    """Ask a team-mate for relief, if this guard's charge lasts only for that or an operator wants it relieved.

    One that is on its way already is asked again; else the scout with the largest charge.
    """
    own, most, best = memory.own[0], 0, 0.0
    own.asks = -1
    own.leaving = own.leaving and own.role == GUARD
    if own.role == GUARD and (own.leaving or own.spare <= own.lead):
        for k in range(memory.mates.shape[0]):
            mate = memory.mates[k]
            ready = _readiness(mate)
            better = ready > most or (ready == most and mate.charge > best)
            if k != parameters.row and ready > 0 and better:
                own.asks, most, best = k, ready, mate.charge


@compiled
def _measure_charge(
    parameters: TeamParameters, memory: TeamMemory, charge: float, state: State
) -> None:
    """Record the charge, and what of it the way back and a relief need."""
    own, one = memory.own[0], parameters.endurance
    own.charge, own.spare, own.home = charge, math.inf, False
    if math.isfinite(charge):
        far = norm(state.p_x - one.base_x, state.p_y - one.base_y)
        own.home = is_at_base(one, state)
        own.spare = charge - return_time(far, parameters.v_a, parameters.u_a) - RESERVE
        v_a, u_a, v_g = parameters.v_a, parameters.u_a, parameters.v_g
        wait = reach_time(far, v_a, u_a, v_g) + parameters.relief_time
        # meanwhile the UGV may drive away, and the UAV fly to its far side
        farther = min(far + v_g * wait + parameters.sight, parameters.farthest)
        out = reach_time(farther, v_a, u_a, v_g) + parameters.relief_time
        own.lead = out + max(0.0, farther - far) / v_a


@compiled
def accept(parameters: TeamParameters, memory: TeamMemory, certified: bool) -> None:
    """Begin to guard if the filter certifies this tick (R1); called after its decision."""
    own = memory.own[0]
    if own.role == RELIEF and certified:
        largest = max(own.number, own.withdrawn)
        for k in range(memory.mates.shape[0]):
            largest = max(largest, memory.mates[k].number)
        own.number = (largest // MOST_UAVS + 1) * MOST_UAVS + MOST_UAVS - 1 - parameters.row
        own.role = GUARD
    own.certified = certified and own.role == GUARD


@compiled
def _begin_filter(memory: FilterMemory, vertical: VerticalState | None) -> None:
    """Start a new filter; with an altitude, the UAV's commands already carry plans, by `decide_height`."""
    if vertical is None:
        reset_memory(memory)
    elif vertical.flies:
        restart_memory(memory)
    else:
        reset_memory(memory)


@compiled
def begin_tick(
    parameters: TeamParameters,
    memory: TeamMemory,
    team: TeamInputs,
    inputs: UavInputs,
    safety: SafetyBounds,
    filter_memory: FilterMemory,
) -> None:
    """Receive the messages of a tick, and choose the role and whether the filter acts.

    A filter without a measurement brakes, and one with an old measurement flies there. So a UAV that returns flies bare
    to the newest known position of the UGV; its first own detection starts a new filter.

    Args:
        parameters: Constants of the UAV.
        memory: Memory of the UAV, changed in place.
        team: Stored number and messages.
        inputs: State and other messages.
        safety: Bounds of its filter.
        filter_memory: Memory of its filter, changed in place.
    """
    own = memory.own[0]
    for n in range(team.messages.shape[0]):
        hear(memory, parameters.row, team.messages[n])
    detected = _record_own(memory, inputs)
    _measure_charge(parameters, memory, team.charge, inputs.own)
    receive_request(memory, team.request, inputs.tick)
    change_role(parameters, memory, team.number, inputs.tick)
    ask(parameters, memory)
    if own.role in (SCOUT, AWAY):
        own.filtered = own.certified = False
    elif not own.filtered and detected and inputs.tick - own.own_tick <= safety.max_age_ticks:
        _begin_filter(filter_memory, inputs.vertical)
        own.filtered = True


@compiled
def _fly_to_ugv(
    own: OwnRole, state: State, v_a: float, u_a: float, dt: float
) -> tuple[float, float]:
    """Return the acceleration to the newest known position of the UGV; without one, the UAV stops [m/s²]."""
    if own.known_tick < 0:
        u_x, u_y = servo(state, state.p_x, state.p_y, v_a, u_a, dt)
    else:
        u_x, u_y = servo(state, own.known_x, own.known_y, v_a, u_a, dt)
    return u_x, u_y


@compiled
def control_of_role(
    parameters: TeamParameters,
    memory: TeamMemory,
    state: State,
    bounds: SafetyBounds,
    nominal: tuple[float, float],
) -> tuple[float, float]:
    """Return the acceleration of a UAV in its role, before its safety filter [m/s²].

    A UAV with an endurance flies to its base and waits there, unless it guards or relieves. A scout near the end of its
    leash, and a UAV that returns, fly to the newest known position of the UGV.

    Args:
        parameters, memory: Constants and memory of the UAV.
        state: Its state.
        bounds: Bounds of its filter.
        nominal: Nominal acceleration of the law, the operator or the policy [m/s²].
    """
    own, v_a, u_a, dt = memory.own[0], bounds.v_a, bounds.u_a, bounds.dt
    if own.role == GUARD and own.filtered:
        return nominal
    if own.role == AWAY or (own.role == SCOUT and math.isfinite(own.charge)):
        x, y = parameters.endurance.base_x, parameters.endurance.base_y
        u_x, u_y = servo(state, x, y, v_a, u_a, dt)
        return u_x, u_y
    if own.role == SCOUT and own.known_tick >= 0:
        x, y = state.p_x - own.known_x, state.p_y - own.known_y
        distance = norm(x, y)
        away = max(0.0, (x * state.v_x + y * state.v_y) / distance) if distance > 0.0 else 0.0
        stop = away * away / (2.0 * u_a) + (v_a + 0.5 * u_a * dt) * dt
        if distance + stop < parameters.scout_range:
            return nominal
    return _fly_to_ugv(own, state, v_a, u_a, dt)
