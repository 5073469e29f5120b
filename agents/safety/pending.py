"""Commands that carry a motion: what is under way from a pilot to its vehicle, and what the vehicle will fly.

The vehicle's receiver begins each motion in its own tick, and only if its parent is flown then; else it flies on what
it flies (`sim.models.motion`). Each observation tells what it flew. So the pilot knows the one course from here to the
tick in which its next motion begins: along those under way as long as the vehicle flies what was sent, along the rest
of what it flies where one was lost, which voids all that is under way. The proof is in docs/explanation/certificate.md.

Positions [m], speeds [m/s], accelerations [m/s²], times in ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.safety.discs import AS_EXPECTED, Disc
from agents.safety.trajectories import BEST_EFFORT, end_disc, rest_radius, set_end, step_in_area
from bus.messages.vehicle import MOST_CARRIED
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, record_type
from sim.models.motion import (
    NO_CHECKED,
    clear_motions,
    follow_on,
    keep_motion,
    motion_command,
    no_motions,
    waited,
)
from sim.models.safety import SafetyBounds
from sim.models.vehicles import Motion

_NOW, _END = 0, 1
"""Rows of `Underway.flown`: what is flown now, and at the end of the course."""

_BEGUN, _LOST = 0, 1
"""Rows of `Underway.expected`: the next state if the motion that is due in this tick begins, and if it does not."""


class Underway(NamedTuple):
    """A pilot's memory of its motions; arrays that change in place."""

    sent: RecordArray
    """`CheckedTrajectory` of those that were sent: of the one that begins in tick k in row k % rows. (tau_c + 2,)"""
    flown: RecordArray
    """`CheckedTrajectory` of what is flown now, and at the end of the course. (2,)"""
    expected: RecordArray
    """`Motion` of the UAV when the next tick begins. (2,)"""


def underway(delay_ticks: int) -> Underway:
    """Nothing has been sent yet; a command acts so long after the tick that it answers."""
    return Underway(
        sent=no_motions(delay_ticks + 2),
        flown=no_motions(2),
        expected=np.zeros(2, dtype=record_type(Motion)),
    )


@compiled
def motion_in(rows: RecordArray, k: int) -> Motion:
    """The state of the UAV in a row of such."""
    row = rows[k]
    return Motion(row.p_x, row.p_y, row.v_x, row.v_y)


@compiled
def set_motion(rows: RecordArray, k: int, here: Motion) -> None:
    """Put a state of the UAV into a row of such."""
    row = rows[k]
    row.p_x, row.p_y, row.v_x, row.v_y = here.p_x, here.p_y, here.v_x, here.v_y


@compiled
def begin_underway(state: Underway) -> None:
    """Nothing has been sent yet: an episode or a filter begins."""
    clear_motions(state.sent)
    clear_motions(state.flown)
    for k in range(state.expected.shape[0]):
        set_motion(state.expected, k, Motion(0.0, 0.0, 0.0, 0.0))


@compiled
def doubt(state: Underway) -> None:
    """The UAV is not where it was expected: none of the plans was checked from where it is."""
    for k in range(state.sent.shape[0]):
        state.sent[k].checked = 0
    state.flown[_NOW].checked = 0


@compiled
def _take_flown(state: Underway, tick: int, flown: int) -> None:
    """Take in what the vehicle flew in the tick before; one that was not sent by this pilot has no checked plan."""
    if state.flown[_NOW].begins != flown:
        row = flown % state.sent.shape[0]
        if flown >= 0 and state.sent[row].begins == flown:
            state.flown[_NOW] = state.sent[row]
        else:
            state.flown[_NOW] = NO_CHECKED[0]
            state.flown[_NOW].begins, state.flown[_NOW].plain = flown, 1
    if flown >= 0:
        state.flown[_NOW].age = tick - flown


@compiled
def off_by(here: Motion, due: Motion) -> float:
    """The largest difference of a state from the one that is due [m, m/s]."""
    off = max(abs(here.p_x - due.p_x), abs(here.p_y - due.p_y))
    return max(off, abs(here.v_x - due.v_x), abs(here.v_y - due.v_y))


@compiled
def is_expected(state: Underway, tick: int, here: Motion, flown: int) -> bool:
    """True if the UAV is in the state in which what it tells that it has flown has brought it from the tick before."""
    due = motion_in(state.expected, _BEGUN if flown == tick - 1 else _LOST)
    return bool(off_by(here, due) <= AS_EXPECTED)


@compiled
def take_observation(state: Underway, tick: int, here: Motion, flown: int, last_tick: int) -> bool:
    """Take in what the vehicle has flown; true if it is where this pilot expected it.

    Args:
        state: Is changed.
        tick: Now.
        here: Where the UAV is now.
        flown: The tick in which the motion began that it flew in the tick before; NO_MOTION: it flew none.
        last_tick: The tick that this pilot answered last; negative: none yet.
    """
    first = last_tick < 0
    expected = first or (last_tick == tick - 1 and is_expected(state, tick, here, flown))
    if not expected:
        doubt(state)
    _take_flown(state, tick, flown)
    return expected


@compiled
def due_end(
    promise: SafetyBounds, state: Underway, tick: int, here: Motion
) -> tuple[Motion, bool, int]:
    """Predicts the UAV's state when the motion of this tick's command begins.

    `state.flown` then has what it flies there. What is under way is in a chain from what is flown now, or void.

    Returns:
        Its state then; whether all that it may fly until then was checked; and how long it will have waited for the
        next motion at least [ticks].
    """
    c, checked, next_begins = promise, state.flown[_NOW].checked == 1, tick + promise.delay_ticks
    ahead = state.flown[_END : _END + 1]
    ahead[0] = state.flown[_NOW]
    for k in range(c.delay_ticks):
        if follow_on(state.sent, ahead, tick + k):
            next_begins = min(next_begins, tick + k)
            checked = checked and ahead[0].checked == 1
        u_x, u_y = motion_command(ahead[0], here.v_x, here.v_y, c.u_a, c.dt)
        here, _ = step_in_area(c, here, u_x, u_y)
        ahead[0].age += 1
    return here, checked, waited(next_begins, state.flown[_NOW].begins, c.delay_ticks)


@compiled
def take_rest(state: Underway, plan: RecordArray) -> None:
    """Let the plan that is held be the rest of the motion that is flown at the end of the course.

    With the disc around its end: the hand-over needs that one, and not that of a plan that was lost.
    """
    last = end_disc(plan)
    plan[0] = state.flown[_END]
    held = plan[0]
    behind = max(0, held.age - 1)
    turn, cruise = held.turn, held.cruise
    held.turn, behind = max(0, turn - behind), max(0, behind - turn)
    held.cruise, behind = max(0, cruise - behind), max(0, behind - cruise)
    held.brake = max(0, held.brake - behind)
    if held.end_radius == math.inf:
        set_end(plan, last)


@compiled
def _rests(rows: RecordArray, k: int) -> bool:
    """True if a motion of this pilot's leaves a UAV that is at rest where it is."""
    m = rows[k]
    still = (
        m.acceleration[0] == 0.0 and m.acceleration[1] == 0.0 and m.turn + m.cruise + m.brake == 0
    )
    return bool(still and m.plain == 0)


@compiled
def _check_rest(rows: RecordArray, k: int, tick: int, here: Motion, radius: float) -> None:
    rows[k].checked = 1
    set_end(rows[k : k + 1], Disc(here.p_x, here.p_y, radius, tick))


@compiled
def check_rest(
    promise: SafetyBounds,
    state: Underway,
    detections: RecordArray,
    plan: RecordArray,
    tick: int,
    here: Motion,
) -> None:
    """Take the UAV's rest as a plan once a detection has come, if it passes as one, until a motion moves the UAV.

    Args:
        promise: The declared numbers.
        state: Of a pilot that has sent what the vehicle flies from tick 0 on. Is changed.
        detections: As kept.
        plan: The memory of the plan that is held.
        tick: Now.
        here: Where the UAV is now.
    """
    if state.flown[_NOW].checked == 1 or not _rests(state.flown, _NOW):
        return
    radius = rest_radius(promise, detections, plan, tick, here, promise.delay_ticks)
    if radius == math.inf:
        return
    _check_rest(state.flown, _NOW, tick, here, radius)
    for begins in range(tick, tick + promise.delay_ticks):
        place = begins % state.sent.shape[0]
        if state.sent[place].begins == begins:
            if not _rests(state.sent, place):
                return
            _check_rest(state.sent, place, tick, here, radius)


@compiled
def send_motion(
    promise: SafetyBounds,
    state: Underway,
    plan: RecordArray,
    tick: int,
    here: Motion,
    u_x: float,
    u_y: float,
    acts: int,
) -> None:
    """Take the motion of this command among those under way, and note where the UAV will be at the next tick.

    Args:
        promise: The declared numbers.
        state: Is changed.
        plan: What is flown after the first tick.
        tick: Now.
        here: Where the UAV is now.
        u_x, u_y: The first tick's acceleration [m/s²].
        acts: As from `safe_control`; without a plan the vehicle rests after the first tick.
    """
    begins = tick + promise.delay_ticks
    place = begins % state.sent.shape[0]
    state.sent[place] = NO_CHECKED[0] if acts == BEST_EFFORT else plan[0]
    row = state.sent[place]
    row.begins, row.parent = begins, state.flown[_END].begins
    row.acceleration[0], row.acceleration[1] = u_x, u_y
    row.age, row.arrived, row.plain = 0, 0, 0
    ahead = state.flown[_END : _END + 1]
    for k in (_LOST, _BEGUN):
        ahead[0] = state.flown[_NOW]
        if k == _BEGUN:
            follow_on(state.sent, ahead, tick)
        w_x, w_y = motion_command(ahead[0], here.v_x, here.v_y, promise.u_a, promise.dt)
        there, _ = step_in_area(promise, here, w_x, w_y)
        set_motion(state.expected, k, there)


@compiled
def carried(promise: SafetyBounds, state: Underway, tick: int) -> int:
    """The number of motions that this tick's command carries: its own, and those just before it that have not begun."""
    last, n = tick + promise.delay_ticks, 0
    while n < MOST_CARRIED and last - n >= tick:
        if state.sent[(last - n) % state.sent.shape[0]].begins != last - n:
            break
        n += 1
    return n


@compiled
def hand_over(
    promise: SafetyBounds, state: Underway, tick: int, motions: RecordArray
) -> tuple[int, int]:
    """Put the motions that the command of this tick carries among those that set out.

    Returns:
        The tick in which the last of them begins, and how many they are.
    """
    last, n = tick + promise.delay_ticks, carried(promise, state, tick)
    for begins in range(last - n + 1, last + 1):
        keep_motion(motions, state.sent[begins % state.sent.shape[0]], tick)
    return last, n
