"""One UAV's safety filter over plain arrays: what it remembers, and what it does in a tick. See docs/explanation/certificate.md.

`SafetyFilter` calls these functions for one UAV, compiled loops call them for many worlds. In a tick:
`note_position`, then
`note_detection` for each detection that has arrived, then `guard` with the command that is wanted.

The filter keeps a **course**: the states in which the ticks until the next command acts will begin, and the
commands under way that lead there. The UAV is on course if its state is the one that the course has for this tick.

All positions in the world's frame [m], speeds [m/s], accelerations [m/s²]; a tick k is the time k dt [s].
"""

from typing import NamedTuple

import numpy as np

from agents.control.certificate import (
    BEST_EFFORT,
    CERTIFIED,
    CONTRADICTED,
    NO_DETECTION,
    NO_PLAN,
    OFF_COURSE,
    PLAN_SIZE,
    TOO_OLD,
    UNKNOWN_COMMANDS,
    UNSAFE_COURSE,
    contradicts_plan,
    drop_plan,
    is_within,
    no_plan,
    safe_control,
    step_in_area,
)
from agents.control.discs import (
    KEPT,
    certified_distance,
    keep_detection,
    newest_detection,
    no_detections,
)
from agents.control.handover import Promise
from sim.kernels.compile import FloatArray, IntArray, borrowing, compiled
from sim.models.vehicles import within_walls

_NEVER = -1
"""The tick of a place in the track where no position has been noted, and of a filter that has not been asked yet."""

_ON_COURSE = 1e-10
"""A state nearer than this [m, m/s] to that of the course is on it. The course goes on from the state, so that a lost
command is seen at once or has no consequence; a thousand ticks of this are less than `MARGIN`."""

_DUST = 1e-9
"""Seconds by which an age may exceed what is declared, for rounding."""

_CONTRADICTED, _TICK, _KNOWN, _SAFE = range(4)
_FLAGS = 4
"""Whether detections have ever contradicted each other; the tick of the last call.

How many of the last commands are known to be
under way, as they were sent since the UAV was last found off its course; whether the course is safe up to the plan."""

_P_X, _P_Y, _V_X, _V_Y, _U_X, _U_Y = range(6)
_COURSE = 6


class GuardState(NamedTuple):
    """What the filter of one UAV remembers; from `guard_state`.

    Arrays with an axis in front are the memories of many worlds.
    """

    detections: FloatArray
    """Where the UGV was detected [m] and when [s], as `keep_detection` keeps them. (KEPT, 3)"""
    plan: FloatArray
    """The memory of `safe_control`. (PLAN_SIZE,)"""
    course: FloatArray
    """Position [m] and velocity [m/s] in which each tick from this one on will begin, and the command under way that acts in it
    [m/s²]; in the last row that command is yet to be chosen. (tau_c / dt + 1, 6)"""
    track: FloatArray
    """The UAV's own positions [m]: that of tick k in row k % depth, until a later tick needs the row. (depth, 2)"""
    track_ticks: IntArray
    """Which tick each row of `track` is of. (depth,)"""
    flags: IntArray
    """Whole numbers, see above. (4,)"""


def guard_state(promise: Promise, depth: int) -> GuardState:
    """A fresh memory: nothing seen, nothing commanded.

    Args:
        promise: The declared numbers.
        depth: For how many ticks own positions are kept; a detection that is older when it arrives is ignored.
    """
    if depth < 1:
        raise ValueError(f"depth must be at least 1, not {depth}")
    state = GuardState(
        detections=np.empty((KEPT, 3)),
        plan=np.empty(PLAN_SIZE),
        course=np.empty((round(promise.delay / promise.dt) + 1, _COURSE)),
        track=np.empty((depth, 2)),
        track_ticks=np.empty(depth, dtype=np.int64),
        flags=np.empty(_FLAGS, dtype=np.int64),
    )
    begin_guard(state)
    return state


@compiled
def begin_guard(state: GuardState) -> None:
    """Make a memory as fresh as one from `guard_state`, in place: an episode begins."""
    state.detections[:] = no_detections()
    state.plan[:] = no_plan()
    state.course[:] = 0.0
    state.track[:] = 0.0
    state.track_ticks[:] = _NEVER
    state.flags[:] = 0
    state.flags[_TICK] = _NEVER


@borrowing
def note_position(state: GuardState, tick: int, p_x: float, p_y: float) -> None:
    """Remember where the UAV is at this tick [m]: detections that were taken here may arrive later."""
    place = tick % state.track_ticks.shape[0]
    state.track[place, 0], state.track[place, 1], state.track_ticks[place] = p_x, p_y, tick


@borrowing
def note_detection(
    promise: Promise,
    state: GuardState,
    taken: int,
    tick: int,
    p_delta_x: float,
    p_delta_y: float,
    p_x: float,
    p_y: float,
) -> None:
    """Take in a detection that has arrived, in any order. One of a tick without a noted position is ignored.

    Args:
        promise: The declared numbers.
        state: The filter's memory, changed in place.
        taken: The tick in which it was taken.
        tick: The tick now.
        p_delta_x, p_delta_y: What was measured, p_a - p_g then [m].
        p_x, p_y: Position of the UAV now [m].
    """
    place = taken % state.track_ticks.shape[0]
    if taken < 0 or state.track_ticks[place] != taken:
        return
    c = promise
    z_x, _ = within_walls(state.track[place, 0] - p_delta_x, 0.0, c.width)  # the UGV is in the area
    z_y, _ = within_walls(state.track[place, 1] - p_delta_y, 0.0, c.height)
    if not keep_detection(
        state.detections, z_x, z_y, taken * c.dt, tick * c.dt, p_x, p_y, c.eps, c.v_g
    ):
        state.flags[_CONTRADICTED] = 1


@borrowing
def forget_commands(state: GuardState) -> None:
    """It is not known whether the last commands were sent.

    Until those under way are known again, nothing is certified.
    """
    state.flags[_KNOWN] = 0


@borrowing
def note_commands(state: GuardState, commands: FloatArray) -> None:
    """Tell a filter that begins in the middle of a flight which commands are likely to be under way.

    Args:
        state: The filter's memory, changed in place.
        commands: Those of the ticks before the one that it will be asked for first, the oldest first [m/s²]. Shape
            (any, 2).
    """
    last, given = state.course.shape[0] - 1, commands.shape[0]
    for k in range(min(last, given)):
        state.course[last - 1 - k, _U_X] = commands[given - 1 - k, 0]
        state.course[last - 1 - k, _U_Y] = commands[given - 1 - k, 1]


@borrowing
def _predict(promise: Promise, state: GuardState) -> None:
    """Work the course out from its first state, under the commands in it."""
    course = state.course
    for k in range(course.shape[0] - 1):
        p_x, p_y, v_x, v_y = course[k, _P_X], course[k, _P_Y], course[k, _V_X], course[k, _V_Y]
        p_x, p_y, v_x, v_y, _ = step_in_area(
            promise, p_x, p_y, v_x, v_y, course[k, _U_X], course[k, _U_Y]
        )
        course[k + 1, _P_X], course[k + 1, _P_Y], course[k + 1, _V_X], course[k + 1, _V_Y] = (
            p_x,
            p_y,
            v_x,
            v_y,
        )


@borrowing
def _set_out(
    promise: Promise, state: GuardState, tick: int, p_x: float, p_y: float, v_x: float, v_y: float
) -> bool:
    """Bring the course to this tick; whether the UAV is on it, as far as there was one.

    If not, it begins anew from here.
    """
    course, flags, on_course = state.course, state.flags, True
    if flags[_TICK] == _NEVER and tick == 0:
        flags[_KNOWN] = course.shape[
            0
        ]  # a vehicle that has had no command yet does nothing: that is known
    elif flags[_TICK] != tick - 1:
        last = course.shape[0] - 1
        for _ in range(min(last, tick - 1 - flags[_TICK]) if flags[_TICK] != _NEVER else 0):
            for k in range(last - 1):  # nothing was sent meanwhile: the last command is held
                course[k, _U_X], course[k, _U_Y] = course[k + 1, _U_X], course[k + 1, _U_Y]
        flags[_KNOWN] = 0
    else:
        off = max(abs(p_x - course[0, _P_X]), abs(p_y - course[0, _P_Y]))
        off = max(off, abs(v_x - course[0, _V_X]), abs(v_y - course[0, _V_Y]))
        if off == 0.0:
            return True
        course[0, _P_X], course[0, _P_Y], course[0, _V_X], course[0, _V_Y] = p_x, p_y, v_x, v_y
        _predict(promise, state)
        if off <= _ON_COURSE:
            return True
        flags[_KNOWN], on_course = 0, False
    course[0, _P_X], course[0, _P_Y], course[0, _V_X], course[0, _V_Y] = p_x, p_y, v_x, v_y
    _predict(promise, state)
    drop_plan(state.plan)
    flags[_SAFE] = 0
    return on_course


@borrowing
def _course_is_safe(promise: Promise, state: GuardState, tick: int) -> bool:
    """Whether the UGV is surely in sight from now until the next command acts, if the commands under way act."""
    course, over = state.course, 0.0
    for k in range(course.shape[0]):
        if not is_within(
            promise,
            state.detections,
            state.plan,
            (tick + k) * promise.dt,
            course[k, _P_X],
            course[k, _P_Y],
            over,
        ):
            return False
        if k + 1 < course.shape[0]:
            p_x, p_y, v_x, v_y = course[k, _P_X], course[k, _P_Y], course[k, _V_X], course[k, _V_Y]
            _, _, _, _, over = step_in_area(
                promise, p_x, p_y, v_x, v_y, course[k, _U_X], course[k, _U_Y]
            )
    return True


@borrowing
def _send(promise: Promise, state: GuardState, tick: int, u_x: float, u_y: float) -> None:
    """Take a command among those under way; the course moves on by a tick."""
    course, flags = state.course, state.flags
    last = course.shape[0] - 1
    course[last, _U_X], course[last, _U_Y] = u_x, u_y
    p_x, p_y, v_x, v_y = (
        course[last, _P_X],
        course[last, _P_Y],
        course[last, _V_X],
        course[last, _V_Y],
    )
    p_x, p_y, v_x, v_y, _ = step_in_area(promise, p_x, p_y, v_x, v_y, u_x, u_y)
    for k in range(last):
        for i in range(_COURSE):
            course[k, i] = course[k + 1, i]
    course[last, _P_X], course[last, _P_Y], course[last, _V_X], course[last, _V_Y] = (
        p_x,
        p_y,
        v_x,
        v_y,
    )
    flags[_TICK], flags[_KNOWN] = tick, min(flags[_KNOWN] + 1, course.shape[0])


@borrowing
def _reason(
    promise: Promise, state: GuardState, tick: int, acts: int, on_course: bool, known: bool
) -> int:
    """Why this tick is not certified, a code of `UNCERTIFIED`; CERTIFIED if it is."""
    new = newest_detection(state.detections)
    if new < 0:
        return NO_DETECTION
    if tick * promise.dt - state.detections[new, 2] > promise.age + _DUST:
        return TOO_OLD
    if state.flags[_CONTRADICTED] != 0:
        return CONTRADICTED
    if acts == BEST_EFFORT:
        return NO_PLAN
    if not on_course:
        return OFF_COURSE
    if not known:
        return UNKNOWN_COMMANDS
    return CERTIFIED if state.flags[_SAFE] != 0 else UNSAFE_COURSE


@borrowing
def guard(
    promise: Promise,
    state: GuardState,
    tick: int,
    p_x: float,
    p_y: float,
    v_x: float,
    v_y: float,
    u_x: float,
    u_y: float,
) -> tuple[float, float, int, int, float]:
    """Let a command through if sight is kept after it, else give the one that keeps it.

    Once a tick, for it takes a plan on.

    Args:
        promise: The declared numbers.
        state: The filter's memory, changed in place.
        tick: The tick now.
        p_x, p_y: Position of the UAV now [m].
        v_x, v_y: Its velocity now [m/s].
        u_x, u_y: What the inner control wants [m/s²].

    Returns:
        The command [m/s²]; who acts: INNER, PLAN or BEST_EFFORT; why this tick is not certified, a code of
        `UNCERTIFIED`, or
        CERTIFIED, which holds only if `check_assumptions` finds nothing in the promise; and the certified distance
        now [m].
    """
    c, flags = promise, state.flags
    on_course = _set_out(c, state, tick, p_x, p_y, v_x, v_y)
    if contradicts_plan(c, state.detections, state.plan):
        flags[_CONTRADICTED] = 1
    ahead = state.course[state.course.shape[0] - 1]
    u_x, u_y, acts = safe_control(
        c,
        state.detections,
        state.plan,
        tick * c.dt + c.delay,
        ahead[_P_X],
        ahead[_P_Y],
        ahead[_V_X],
        ahead[_V_Y],
        u_x,
        u_y,
    )
    if acts == BEST_EFFORT:
        flags[_SAFE] = 0
    elif flags[_SAFE] == 0 and _course_is_safe(c, state, tick):
        flags[_SAFE] = 1
    known = flags[_KNOWN] >= state.course.shape[0] - 1
    code = _reason(c, state, tick, acts, on_course, known)
    _send(c, state, tick, u_x, u_y)
    return (
        u_x,
        u_y,
        acts,
        code,
        certified_distance(p_x, p_y, tick * c.dt, state.detections, c.eps, c.v_g),
    )
