"""One UAV's safety filter over records: its memory and its tick. See docs/explanation/certificate.md.

`SafetyFilter` calls these functions for one UAV, compiled loops call them for many worlds. In a tick: `note_position`,
then `note_detection` for each detection that has arrived, then `guard` with the command that is wanted.

Each command carries a motion: its acceleration, and the plan that follows it while later commands are lost. The
vehicle reports which motion it flies, so the filter knows the states until the motion of this tick's command begins.

All positions in the world's frame [m], speeds [m/s], accelerations [m/s²], times in ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.safety.discs import (
    MOST_KEPT,
    NEVER,
    certified_distance,
    keep_detection,
    newest_detection,
    no_detections,
)
from agents.safety.pending import (
    Underway,
    begin_underway,
    check_rest,
    doubt,
    due_end,
    is_expected,
    send_motion,
    take_observation,
    take_rest,
    underway,
)
from agents.safety.trajectories import (
    BEST_EFFORT,
    CERTIFIED,
    CONTRADICTED,
    NO_DETECTION,
    NO_PLAN,
    OFF_COURSE,
    OUTAGE,
    TOO_OLD,
    UNCHECKED_MOTION,
    contradicts_plan,
    safe_control,
)
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, record_type
from sim.models.motion import NO_MOTION, clear_motions, no_motions
from sim.models.safety import SafetyBounds
from sim.models.vehicles import Motion, within_walls


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
    from_start: int
    """1 if all commands since tick 0 are this filter's."""


class GuardState(NamedTuple):
    """The memory of one UAV's filter; from `guard_state`.

    Arrays with an axis in front are the memories of many worlds.
    """

    detections: RecordArray
    """Places and times of detections: `KeptDetection`, as `keep_detection` keeps them. (KEPT,)"""
    plan: RecordArray
    """The memory of `safe_control`: `CheckedTrajectory` of the plan that is held. (1,)"""
    track: RecordArray
    """`TrackTick` of the UAV's own ticks: k in row k % depth, until a later tick needs the row. (depth,)"""
    flags: RecordArray
    """`GuardFlags`. (1,)"""
    underway: Underway
    """The motions that were sent, and the one that the vehicle flies."""


_TRACK = 120.0
"""The UAV's own positions are kept for so long [s], or for the declared age of detections if that is longer."""


def track_ticks(promise: SafetyBounds) -> int:
    """Ticks for which a filter keeps the UAV's own positions; memory for all is taken at once, 24 bytes a tick."""
    return max(1, min(MOST_KEPT, max(math.ceil(_TRACK / promise.dt), promise.max_age_ticks + 1)))


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
        plan=no_motions(1),
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
    clear_motions(state.plan)
    for k in range(state.track.shape[0]):
        place = state.track[k]
        place.x, place.y, place.tick = 0.0, 0.0, NEVER
    flags = state.flags[0]
    flags.contradicted, flags.tick, flags.from_start = 0, NEVER, 0
    begin_underway(state.underway)


@compiled
def note_position(state: GuardState, tick: int, p_x: float, p_y: float) -> None:
    """Remember where the UAV is at this tick [m]: detections that were taken here may arrive later."""
    place = state.track[tick % state.track.shape[0]]
    place.x, place.y, place.tick = p_x, p_y, tick


@compiled
def note_detection(
    promise: SafetyBounds,
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

    Until the vehicle flies one that is sent after this, nothing is certified.
    """
    state.flags[0].from_start = 0
    doubt(state.underway)


@compiled
def _begun(promise: SafetyBounds, state: GuardState, tick: int, here: Motion, flown: int) -> int:
    """Return the motion that the vehicle flew in the tick before; NO_MOTION: it flew none.

    A receiver of bare accelerations reports none. Where each command acts in its own tick, the state of the UAV tells
    that the last one did.
    """
    if flown != NO_MOTION or promise.delay_ticks > 0 or promise.interval_ticks > 1:
        return flown
    sent, last = state.underway, tick - 1
    begins = sent.sent[last % sent.sent.shape[0]].begins
    answered = last >= 0 and state.flags[0].tick == last and begins == last
    return last if answered and is_expected(sent, tick, here, last) else flown


@compiled
def _reason(
    promise: SafetyBounds,
    state: GuardState,
    tick: int,
    acts: int,
    expected: bool,
    checked: bool,
    wait: int,
) -> int:
    """Return a code of `UNCERTIFIED` that says why this tick is not certified; CERTIFIED if it is."""
    new = newest_detection(state.detections)
    if new < 0:
        return NO_DETECTION
    if tick - state.detections[new].taken > promise.max_age_ticks:
        return TOO_OLD
    if state.flags[0].contradicted != 0:
        return CONTRADICTED
    late = wait > promise.interval_ticks  # also if it is yet to come, but nothing can prevent it
    if acts == BEST_EFFORT:
        return OUTAGE if late else NO_PLAN
    if not expected:
        return OFF_COURSE
    if late:
        return OUTAGE
    return CERTIFIED if checked else UNCHECKED_MOTION


@compiled
def guard(
    promise: SafetyBounds,
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
    flags, sent, plan = state.flags[0], state.underway, state.plan
    bound = certified_distance(promise, state.detections, tick, here.p_x, here.p_y)
    flown = _begun(promise, state, tick, here, flown)
    expected = take_observation(sent, tick, here, flown, flags.tick)
    flags.from_start = 1 if tick == 0 else flags.from_start
    if flags.from_start == 1:
        check_rest(promise, sent, state.detections, plan, tick, here)
    ahead, checked, wait = due_end(promise, sent, tick, here)
    take_rest(sent, plan)
    if contradicts_plan(promise, state.detections, plan):
        flags.contradicted = 1
    u_x, u_y, acts = safe_control(
        promise, state.detections, plan, tick + promise.delay_ticks, ahead, u_x, u_y
    )
    send_motion(promise, sent, plan, tick, here, u_x, u_y, acts)
    flags.tick = tick
    code = _reason(promise, state, tick, acts, expected, checked, wait)
    return u_x, u_y, acts, code, bound
