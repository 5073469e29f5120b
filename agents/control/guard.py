"""One UAV's safety filter over records: its memory and its tick. See docs/explanation/certificate.md.

`SafetyFilter` calls these functions for one UAV, compiled loops call them for many worlds. In a tick: `note_position`,
then `note_detection` for each detection that has arrived, then `guard` with the command that is wanted.

The filter keeps a **course**: the states in which the ticks until the next command acts will begin, and the
commands under way that lead there. The UAV is on course if its state is the one that the course has for this tick.

All positions in the world's frame [m], speeds [m/s], accelerations [m/s²], times in ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.control.certificate import (
    BEST_EFFORT,
    CERTIFIED,
    CONTRADICTED,
    NO_DETECTION,
    NO_PLAN,
    OFF_COURSE,
    OUTAGE,
    TOO_OLD,
    UNCHECKED_MOTION,
    UNKNOWN_COMMANDS,
    UNSAFE_COURSE,
    clear_plan,
    contradicts_plan,
    drop_plan,
    is_within,
    no_plan,
    safe_control,
    step_in_area,
)
from agents.control.discs import (
    AS_EXPECTED,
    MOST_KEPT,
    NEVER,
    certified_distance,
    keep_detection,
    newest_detection,
    no_detections,
)
from agents.control.promise import Promise
from agents.control.underway import (
    Underway,
    begin_underway,
    check_rest,
    doubt,
    due_end,
    motion_in,
    off_by,
    send_motion,
    set_motion,
    take_observation,
    take_rest,
    underway,
)
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray, record_type
from sim.models.motion import NO_MOTION
from sim.models.vehicles import Motion, within_walls


class CourseTick(NamedTuple):
    """A row of the course: the state in which a tick will begin, and the command under way that acts in it."""

    p_x: float
    p_y: float
    v_x: float
    v_y: float
    """[m], [m/s]."""
    u_x: float
    u_y: float
    """[m/s²]; in the last row the command is yet to be chosen."""


class TrackTick(NamedTuple):
    """A row of the track: where the UAV was."""

    x: float
    y: float
    """[m]"""
    tick: int
    """In which tick; NEVER: the row is empty."""


class GuardFlags(NamedTuple):
    """The filter's whole numbers, a row of an array of one."""

    contradicted: int
    """1 once detections have contradicted each other."""
    tick: int
    """Of the last call; NEVER before the first."""
    known: int
    """The number of last commands that are known to be under way: sent since the UAV was last found off its
    course. Where commands carry motions: 1 if all since tick 0 are this filter's."""
    safe: int
    """1 if the course is safe up to the plan."""


class GuardState(NamedTuple):
    """The memory of one UAV's filter; from `guard_state`.

    Arrays with an axis in front are the memories of many worlds.
    """

    detections: RecordArray
    """Places and times of detections: `KeptDetection`, as `keep_detection` keeps them. (KEPT,)"""
    plan: RecordArray
    """The memory of `safe_control`: `HeldPlan`. (1,)"""
    course: RecordArray
    """`CourseTick` of each tick from this one on until the next command acts. (tau_c + 1,)"""
    track: RecordArray
    """`TrackTick` of the UAV's own ticks: k in row k % depth, until a later tick needs the row. (depth,)"""
    flags: RecordArray
    """`GuardFlags`. (1,)"""
    underway: Underway
    """The motions that were sent, where commands carry them."""


_TRACK = 120.0
"""The UAV's own positions are kept for so long [s], or for the declared age of detections if that is longer."""


def track_ticks(promise: Promise) -> int:
    """Ticks for which a filter keeps the UAV's own positions; memory for all is taken at once, 24 bytes a tick."""
    return max(1, min(MOST_KEPT, max(math.ceil(_TRACK / promise.dt), promise.age_ticks + 1)))


def guard_state(delay_ticks: int, depth: int) -> GuardState:
    """A fresh memory: nothing seen, nothing commanded.

    Args:
        delay_ticks: From the tick that a command answers to the one in which it acts, as it is declared.
        depth: For how many ticks own positions are kept, at most `track_ticks`; a detection that is older when it
            arrives is ignored.
    """
    if depth < 1:
        raise ValueError(f"depth must be at least 1, not {depth}")
    state = GuardState(
        detections=no_detections(),
        plan=no_plan(),
        course=np.zeros(delay_ticks + 1, dtype=record_type(CourseTick)),
        track=np.zeros(depth, dtype=record_type(TrackTick)),
        flags=np.zeros(1, dtype=record_type(GuardFlags)),
        underway=underway(delay_ticks),
    )
    begin_guard(state)
    return state


@compiled
def begin_guard(state: GuardState) -> None:
    """Make a memory as fresh as one from `guard_state`, in place: an episode begins."""
    for k in range(state.detections.shape[0]):
        found = state.detections[k]
        found.x, found.y, found.taken = 0.0, 0.0, NEVER
    clear_plan(state.plan)
    for k in range(state.course.shape[0]):
        row = state.course[k]
        row.p_x, row.p_y, row.v_x, row.v_y, row.u_x, row.u_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(state.track.shape[0]):
        place = state.track[k]
        place.x, place.y, place.tick = 0.0, 0.0, NEVER
    flags = state.flags[0]
    flags.contradicted, flags.tick, flags.known, flags.safe = 0, NEVER, 0, 0
    begin_underway(state.underway)


@compiled
def note_position(state: GuardState, tick: int, p_x: float, p_y: float) -> None:
    """Remember where the UAV is at this tick [m]: detections that were taken here may arrive later."""
    place = state.track[tick % state.track.shape[0]]
    place.x, place.y, place.tick = p_x, p_y, tick


@compiled
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
    was = state.track[taken % state.track.shape[0]]
    if taken < 0 or was.tick != taken:
        return
    z_x, _ = within_walls(was.x - p_delta_x, 0.0, promise.width)  # the UGV is in the area
    z_y, _ = within_walls(was.y - p_delta_y, 0.0, promise.height)
    if not keep_detection(promise, state.detections, z_x, z_y, taken, tick, p_x, p_y):
        state.flags[0].contradicted = 1


@compiled
def forget_commands(state: GuardState) -> None:
    """It is not known whether the last commands were sent.

    Until those under way are known again, nothing is certified.
    """
    state.flags[0].known = 0
    doubt(state.underway)


@compiled
def note_commands(state: GuardState, commands: FloatArray) -> None:
    """Tell a filter that begins in the middle of a flight which commands are likely to be under way.

    Args:
        state: The filter's memory, changed in place.
        commands: Those of the ticks before the one that it will be asked for first, the oldest first [m/s²]. Shape
            (any, 2).
    """
    last, given = state.course.shape[0] - 1, commands.shape[0]
    for k in range(min(last, given)):
        row = state.course[last - 1 - k]
        row.u_x, row.u_y = commands[given - 1 - k, 0], commands[given - 1 - k, 1]


@compiled
def _begin_course(promise: Promise, course: RecordArray, here: Motion) -> None:
    """Work the course out from this state on, under the commands in it."""
    for k in range(course.shape[0]):
        set_motion(course, k, here)
        here, _ = step_in_area(promise, here, course[k].u_x, course[k].u_y)


@compiled
def _set_out(promise: Promise, state: GuardState, tick: int, here: Motion) -> bool:
    """Bring the course to this tick; true if the UAV is on it, as far as there was one.

    If not, it begins anew from here.
    """
    course, flags, on_course = state.course, state.flags[0], True
    last = course.shape[0] - 1
    if flags.tick == NEVER and tick == 0:
        flags.known = last + 1  # a vehicle that has had no command yet does nothing: that is known
    elif flags.tick != tick - 1:
        for _ in range(min(last, tick - 1 - flags.tick) if flags.tick != NEVER else 0):
            for k in range(last - 1):  # nothing was sent meanwhile: the last command is held
                course[k].u_x, course[k].u_y = course[k + 1].u_x, course[k + 1].u_y
        flags.known = 0
    else:
        off = off_by(here, motion_in(course, 0))
        if off == 0.0:
            return True
        if off <= AS_EXPECTED:
            _begin_course(promise, course, here)
            return True
        flags.known, on_course = 0, False
    _begin_course(promise, course, here)
    drop_plan(state.plan)
    flags.safe = 0
    return on_course


@compiled
def _course_is_safe(promise: Promise, state: GuardState, tick: int) -> bool:
    """True if the UGV is surely in sight from now until the next command acts, if the commands under way act."""
    course, over = state.course, 0.0
    for k in range(course.shape[0]):
        here = motion_in(course, k)
        if not is_within(promise, state.detections, state.plan, tick + k, here.p_x, here.p_y, over):
            return False
        if k + 1 < course.shape[0]:
            _, over = step_in_area(promise, here, course[k].u_x, course[k].u_y)
    return True


@compiled
def _send(promise: Promise, state: GuardState, tick: int, u_x: float, u_y: float) -> None:
    """Take a command among those under way; the course moves on by a tick."""
    course, flags = state.course, state.flags[0]
    last = course.shape[0] - 1
    after, _ = step_in_area(promise, motion_in(course, last), u_x, u_y)
    course[last].u_x, course[last].u_y = u_x, u_y
    for k in range(last):
        set_motion(course, k, motion_in(course, k + 1))
        course[k].u_x, course[k].u_y = course[k + 1].u_x, course[k + 1].u_y
    set_motion(course, last, after)
    flags.tick, flags.known = tick, min(flags.known + 1, last + 1)


@compiled
def _reason(
    promise: Promise, state: GuardState, tick: int, acts: int, on_course: bool, known: bool
) -> int:
    """Why this tick is not certified, a code of `UNCERTIFIED`; CERTIFIED if it is."""
    new, flags = newest_detection(state.detections), state.flags[0]
    if new < 0:
        return NO_DETECTION
    if tick - state.detections[new].taken > promise.age_ticks:
        return TOO_OLD
    if flags.contradicted != 0:
        return CONTRADICTED
    if acts == BEST_EFFORT:
        return NO_PLAN
    if not on_course:
        return OFF_COURSE
    if not known:
        return UNKNOWN_COMMANDS
    return CERTIFIED if flags.safe != 0 else UNSAFE_COURSE


@compiled
def _guard_motions(
    promise: Promise,
    state: GuardState,
    tick: int,
    here: Motion,
    u_x: float,
    u_y: float,
    flown: int,
) -> tuple[float, float, int, int]:
    """`guard` for a UAV whose commands carry motions."""
    flags, sent, plan = state.flags[0], state.underway, state.plan
    expected = take_observation(sent, tick, here, flown, flags.tick)
    flags.known = 1 if tick == 0 else flags.known
    if flags.known == 1:
        check_rest(promise, sent, state.detections, plan, tick, here)
    ahead, checked, wait = due_end(promise, sent, tick, here)
    take_rest(sent, plan)
    if contradicts_plan(promise, state.detections, plan):
        flags.contradicted = 1
    u_x, u_y, acts = safe_control(
        promise, state.detections, plan, tick + promise.delay_ticks, ahead, u_x, u_y
    )
    send_motion(promise, sent, plan, tick, here, u_x, u_y, acts)
    flags.tick, flags.safe = tick, 1 if checked else 0
    code = _reason(promise, state, tick, acts, expected, True)
    if code == UNSAFE_COURSE:
        code = UNCHECKED_MOTION
    if code in (CERTIFIED, NO_PLAN, UNCHECKED_MOTION) and wait > promise.outage_ticks:
        # Also if it is yet to come, but no motion that is under way can begin any more.
        code = OUTAGE
    return u_x, u_y, acts, code


@compiled
def guard(
    promise: Promise,
    state: GuardState,
    tick: int,
    here: Motion,
    u_x: float,
    u_y: float,
    flown: int = NO_MOTION,
) -> tuple[float, float, int, int, float]:
    """Let a command through if sight is kept after it, else give the one that keeps it.

    Once a tick, for it takes a plan on.

    Args:
        promise: The declared numbers.
        state: The filter's memory, changed in place.
        tick: Now.
        here: Where the UAV is now.
        u_x, u_y: What the inner control wants [m/s²].
        flown: The tick in which the motion began that the vehicle flew in the tick before; NO_MOTION: it flew none.

    Returns:
        The command [m/s²]; who acts: INNER, PLAN or BEST_EFFORT; why this tick is not certified, a code of
        `UNCERTIFIED`, or CERTIFIED, which holds only if `check_assumptions` finds nothing in the promise; and the
        certified distance now [m]. The motion that the command carries is in `state.underway`.
    """
    flags = state.flags[0]
    bound = certified_distance(promise, state.detections, tick, here.p_x, here.p_y)
    if promise.carries:
        u_x, u_y, acts, code = _guard_motions(promise, state, tick, here, u_x, u_y, flown)
        return u_x, u_y, acts, code, bound
    on_course = _set_out(promise, state, tick, here)
    if contradicts_plan(promise, state.detections, state.plan):
        flags.contradicted = 1
    last = state.course.shape[0] - 1
    ahead = motion_in(state.course, last)
    u_x, u_y, acts = safe_control(
        promise, state.detections, state.plan, tick + last, ahead, u_x, u_y
    )
    if acts == BEST_EFFORT:
        flags.safe = 0
    elif flags.safe == 0 and _course_is_safe(promise, state, tick):
        flags.safe = 1
    code = _reason(promise, state, tick, acts, on_course, flags.known >= last)
    _send(promise, state, tick, u_x, u_y)
    return u_x, u_y, acts, code, bound
