"""One UAV's safety filter over plain arrays: what it remembers, and what it does in a tick. See docs/certificate.md.

`SafetyFilter` calls these functions for one UAV, compiled loops call them for many worlds. In a tick: `note_position`, then
`note_detection` for each detection that has arrived, then `guard` with the command that is wanted.

All positions in the world's frame [m], speeds [m/s], accelerations [m/s²]; a tick k is the time k dt [s].
"""

from typing import NamedTuple

import numpy as np

from agents.control.certificate import PLAN_SIZE, no_plan, safe_control, state_ahead, uncertified_reason
from agents.control.discs import KEPT, certified_distance, keep_detection, no_detections
from agents.control.handover import Promise
from sim.compile import FloatArray, IntArray, borrowing, compiled

_NEVER = -1
"""The tick of a place in the track where no position has been noted."""

_CONTRADICTED = 0
_FLAGS = 1


class GuardState(NamedTuple):
    """What the filter of one UAV remembers; from `guard_state`. Arrays with an axis in front are the memories of many worlds."""

    detections: FloatArray
    """Where the UGV was detected [m] and when [s], as `keep_detection` keeps them. (KEPT, 3)"""
    plan: FloatArray
    """The memory of `safe_control`. (PLAN_SIZE,)"""
    pending: FloatArray
    """The commands that are on their way, the oldest first [m/s²]. (tau_c / dt, 2), perhaps no rows."""
    track: FloatArray
    """The UAV's own positions [m]: that of tick k in row k % depth, until a later tick needs the row. (depth, 2)"""
    track_ticks: IntArray
    """Which tick each row of `track` is of. (depth,)"""
    flags: IntArray
    """Whether detections have ever contradicted each other, 0 or 1. (1,)"""


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
        pending=np.empty((round(promise.delay / promise.dt), 2)),
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
    state.pending[:] = 0.0
    state.track[:] = 0.0
    state.track_ticks[:] = _NEVER
    state.flags[:] = 0


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
    z_x = min(max(state.track[place, 0] - p_delta_x, 0.0), c.width)  # the UGV is in the area
    z_y = min(max(state.track[place, 1] - p_delta_y, 0.0), c.height)
    if not keep_detection(state.detections, z_x, z_y, taken * c.dt, tick * c.dt, p_x, p_y, c.eps, c.v_g):
        state.flags[_CONTRADICTED] = 1


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
    """Let a command through if sight is kept after it, else give the one that keeps it; once a tick, for it takes a plan on.

    Args:
        promise: The declared numbers.
        state: The filter's memory, changed in place.
        tick: The tick now.
        p_x, p_y: Position of the UAV now [m].
        v_x, v_y: Its velocity now [m/s].
        u_x, u_y: What the inner control wants [m/s²].

    Returns:
        The command [m/s²]; who acts: INNER, PLAN or BEST_EFFORT; why this tick is not certified, a code of `UNCERTIFIED`, or
        CERTIFIED, which holds only if `check_assumptions` finds nothing in the promise; and the certified distance now [m].
    """
    c, detections, plan, pending = promise, state.detections, state.plan, state.pending
    t = tick * c.dt
    q_x, q_y, w_x, w_y = state_ahead(pending, p_x, p_y, v_x, v_y, c.v_a, c.u_a, c.dt)
    u_x, u_y, acts = safe_control(c, detections, plan, t + c.delay, q_x, q_y, w_x, w_y, u_x, u_y)
    last = pending.shape[0] - 1
    for k in range(last):
        pending[k, 0], pending[k, 1] = pending[k + 1, 0], pending[k + 1, 1]
    if last >= 0:
        pending[last, 0], pending[last, 1] = u_x, u_y
    code = uncertified_reason(c, detections, plan, t, state.flags[_CONTRADICTED] != 0, acts)
    return u_x, u_y, acts, code, certified_distance(p_x, p_y, t, detections, c.eps, c.v_g)


def pack_promise(promise: Promise) -> FloatArray:
    """The promise as a row of numbers, in the order of its fields; the rows of many worlds make one array. Shape (12,)."""
    return np.array(promise, dtype=np.float64)


@compiled
def unpack_promise(row: FloatArray) -> Promise:
    """The promise that `pack_promise` has made this row of."""
    return Promise(
        dt=row[0],
        eps=row[1],
        age=row[2],
        delay=row[3],
        r_v=row[4],
        v_a=row[5],
        u_a=row[6],
        v_g=row[7],
        width=row[8],
        height=row[9],
        handover=row[10],
        reach=row[11],
    )
