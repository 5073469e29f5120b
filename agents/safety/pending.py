"""Pending commands, each with a plan, and the trajectory predicted from them.

The vehicle's receiver begins each plan in its own tick, and only if the plan's parent is committed then; otherwise the
committed trajectory continues (`sim.models.trajectories`). Each observation reports the committed one. So the pilot
predicts one trajectory up to the tick in which its next plan begins: along the pending plans if the vehicle executes
what was sent, otherwise along the rest of the committed one, since a lost plan invalidates all pending ones. The
proof is in docs/explanation/proof.md.

Positions [m], speeds [m/s], accelerations [m/s²], times in ticks.
"""

import math
from typing import NamedTuple

import numpy as np

from agents.safety.area import step_in_area
from agents.safety.discs import AS_EXPECTED, Disc
from agents.safety.trajectories import end_disc, rest_radius, set_end
from bus.messages.vehicle import MOST_CARRIED
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, record_type
from sim.models.safety import SafetyBounds
from sim.models.trajectories import (
    NO_CHECKED,
    clear_trajectories,
    follow_on,
    keep_trajectory,
    no_trajectories,
    trajectory_command,
    waited,
)
from sim.models.vehicles import State

COMMITTED, PREDICTED = 0, 1
"""Rows of `PendingCommands.committed`: committed now, and at the end of the predicted trajectory."""

STARTED, LOST = 0, 1
"""Rows of `PendingCommands.expected`: the next state if the plan of this tick begins, and if it does not."""


class Height(NamedTuple):
    """Altitude [m] and climb rate [m/s] at a tick."""

    z: float
    rate: float


IN_PLANE = Height(0.0, 0.0)
"""Height of a UAV that flies in the plane."""


class ExpectedState(NamedTuple):
    """State of the UAV at the next tick: position [m], velocity [m/s], altitude [m] and climb rate [m/s]."""

    p_x: float
    p_y: float
    v_x: float
    v_y: float
    z: float
    rate: float


class PendingCommands(NamedTuple):
    """A pilot's memory of its plans; the arrays change in place."""

    sent: RecordArray
    """`CheckedTrajectory` of each sent plan: the one of tick k in row k % rows. Shape (tau_c + 2,)."""
    committed: RecordArray
    """`CheckedTrajectory`: committed now, and at the end of the predicted trajectory. Shape (2,)."""
    expected: RecordArray
    """`ExpectedState` of the UAV at the next tick. Shape (2,)."""


def pending_commands(delay_ticks: int) -> PendingCommands:
    """Return the memory of a pilot that has not sent anything.

    Args:
        delay_ticks: Command delay, from the tick of a command to the tick in which it takes effect.
    """
    return PendingCommands(
        sent=no_trajectories(delay_ticks + 2),
        committed=no_trajectories(2),
        expected=np.zeros(2, dtype=record_type(ExpectedState)),
    )


@compiled
def expect(pending: PendingCommands, k: int, there: State, height: Height) -> None:
    """Write an expected state of the UAV."""
    due = pending.expected[k]
    due.p_x, due.p_y, due.v_x, due.v_y = there.p_x, there.p_y, there.v_x, there.v_y
    due.z, due.rate = height.z, height.rate


@compiled
def reset_pending(pending: PendingCommands) -> None:
    """Reset the memory in place, at the start of an episode."""
    clear_trajectories(pending.sent)
    clear_trajectories(pending.committed)
    for k in range(pending.expected.shape[0]):
        expect(pending, k, State(0.0, 0.0, 0.0, 0.0), IN_PLANE)


@compiled
def mark_unchecked(pending: PendingCommands) -> None:
    """Mark all plans unchecked: the UAV is not in the expected state, from which they were checked."""
    for k in range(pending.sent.shape[0]):
        pending.sent[k].checked = 0
    pending.committed[COMMITTED].checked = 0


@compiled
def forget_checks(pending: PendingCommands) -> None:
    """Mark all plans unchecked, and forget the discs around their ends."""
    mark_unchecked(pending)
    for k in range(pending.sent.shape[0]):
        pending.sent[k].end_radius = math.inf
    pending.committed[COMMITTED].end_radius = math.inf


@compiled
def _receive_flown(pending: PendingCommands, tick: int, committed: int) -> None:
    """Record the trajectory executed in the previous tick; another pilot's trajectory counts as unchecked."""
    if pending.committed[COMMITTED].begins != committed:
        row = committed % pending.sent.shape[0]
        if committed >= 0 and pending.sent[row].begins == committed:
            pending.committed[COMMITTED] = pending.sent[row]
        else:
            pending.committed[COMMITTED] = NO_CHECKED[0]
            pending.committed[COMMITTED].begins, pending.committed[COMMITTED].plain = committed, 1
    if committed >= 0:
        pending.committed[COMMITTED].age = tick - committed


@compiled
def _off_by(own: State, height: Height, due: ExpectedState) -> float:
    """Return the largest deviation of a state from the expected one [m, m/s]."""
    off = max(abs(own.p_x - due.p_x), abs(own.p_y - due.p_y))
    off = max(off, abs(own.v_x - due.v_x), abs(own.v_y - due.v_y))
    return max(off, abs(height.z - due.z), abs(height.rate - due.rate))


@compiled
def is_expected(
    pending: PendingCommands, tick: int, own: State, height: Height, committed: int
) -> bool:
    """Return whether the UAV is in the state that the reported trajectory implies."""
    due = pending.expected[STARTED if committed == tick - 1 else LOST]
    return bool(_off_by(own, height, due) <= AS_EXPECTED)


@compiled
def receive_observation(
    pending: PendingCommands,
    tick: int,
    own: State,
    height: Height,
    committed: int,
    last_tick: int,
) -> bool:
    """Record the committed trajectory and return whether the UAV is in the expected state.

    Args:
        pending: Changed in place.
        tick: Current tick.
        own: Current state of the UAV.
        height: Its altitude and climb rate; IN_PLANE if it has none.
        committed: First tick of the plan executed in the previous tick; NO_TRAJECTORY: none.
        last_tick: Last tick that this pilot answered; negative: none yet.
    """
    first = last_tick < 0
    answered = last_tick == tick - 1
    expected = first or (answered and is_expected(pending, tick, own, height, committed))
    if not expected:
        mark_unchecked(pending)
    _receive_flown(pending, tick, committed)
    return expected


@compiled
def predict(
    bounds: SafetyBounds, pending: PendingCommands, tick: int, own: State
) -> tuple[State, bool, int]:
    """Predict the UAV's state when the plan of this tick's command begins.

    `pending.committed` then contains the trajectory committed at that time. Pending plans continue the committed one in
    a chain, or are void.

    Returns:
        The state; whether every plan until then is checked; and the least time without a new plan at that tick [ticks].
    """
    c, checked, next_begins = (
        bounds,
        pending.committed[COMMITTED].checked == 1,
        tick + bounds.delay_ticks,
    )
    ahead = pending.committed[PREDICTED : PREDICTED + 1]
    ahead[0] = pending.committed[COMMITTED]
    for k in range(c.delay_ticks):
        if follow_on(pending.sent, ahead, tick + k):
            next_begins = min(next_begins, tick + k)
            checked = checked and ahead[0].checked == 1
        u_x, u_y = trajectory_command(ahead[0], own.v_x, own.v_y, c.u_a, c.dt)
        own, _ = step_in_area(c, own, u_x, u_y)
        ahead[0].age += 1
    return own, checked, waited(next_begins, pending.committed[COMMITTED].begins, c.delay_ticks)


@compiled
def update_plan(pending: PendingCommands, plan: RecordArray) -> None:
    """Set the current plan to the rest of the trajectory committed at the end of the prediction.

    The hand-over needs the disc around the end of this trajectory, not the disc of a lost plan.
    """
    last = end_disc(plan)
    plan[0] = pending.committed[PREDICTED]
    backup = plan[0]
    behind = max(0, backup.age - 1)
    turn, cruise = backup.turn, backup.cruise
    backup.turn, behind = max(0, turn - behind), max(0, behind - turn)
    backup.cruise, behind = max(0, cruise - behind), max(0, behind - cruise)
    backup.brake = max(0, backup.brake - behind)
    if backup.end_radius == math.inf:
        set_end(plan, last)


@compiled
def _rests(rows: RecordArray, k: int) -> bool:
    """Return whether a plan of this pilot leaves the UAV at rest."""
    m = rows[k]
    still = (
        m.acceleration[0] == 0.0 and m.acceleration[1] == 0.0 and m.turn + m.cruise + m.brake == 0
    )
    return bool(still and m.vertical_acceleration == 0.0 and m.plain == 0)


@compiled
def _check_rest(
    rows: RecordArray, k: int, tick: int, own: State, radius: float, floor: float
) -> None:
    rows[k].checked, rows[k].floor = 1, floor
    set_end(rows[k : k + 1], Disc(own.p_x, own.p_y, radius, tick))


@compiled
def check_rest(
    bounds: SafetyBounds,
    pending: PendingCommands,
    discs: RecordArray,
    plan: RecordArray,
    tick: int,
    own: State,
) -> None:
    """Check a UAV at rest as a plan once there is a measurement, until a plan moves the UAV.

    Args:
        bounds: Bounds of the filter.
        pending: Pending commands of a pilot that has sent all commands since tick 0; changed in place.
        discs: Kept discs. Shape (rows,).
        plan: Current plan. Shape (1,).
        tick: Current tick.
        own: Current state of the UAV.
    """
    if pending.committed[COMMITTED].checked == 1 or not _rests(pending.committed, COMMITTED):
        return
    radius = rest_radius(bounds, discs, plan, tick, own, bounds.delay_ticks)
    if radius == math.inf:
        return
    _check_rest(pending.committed, COMMITTED, tick, own, radius, bounds.floor)
    for begins in range(tick, tick + bounds.delay_ticks):
        row = begins % pending.sent.shape[0]
        if pending.sent[row].begins == begins:
            if not _rests(pending.sent, row):
                return
            _check_rest(pending.sent, row, tick, own, radius, bounds.floor)


@compiled
def send_plan(
    bounds: SafetyBounds,
    pending: PendingCommands,
    plan: RecordArray,
    tick: int,
    own: State,
    first: tuple[float, float],
    checked: bool,
) -> None:
    """Add the plan of this command to the pending ones, and predict the UAV's state at the next tick.

    Args:
        bounds: Bounds of the filter.
        pending: Changed in place.
        plan: Trajectory after the first tick. Shape (1,).
        tick: Current tick.
        own: Current state of the UAV.
        first: Acceleration of the first tick [m/s²].
        checked: True if the plan is checked; otherwise the vehicle brakes to rest after the first tick.
    """
    begins = tick + bounds.delay_ticks
    row = begins % pending.sent.shape[0]
    pending.sent[row] = plan[0] if checked else NO_CHECKED[0]
    sent = pending.sent[row]
    sent.begins, sent.parent = begins, pending.committed[PREDICTED].begins
    sent.acceleration[0], sent.acceleration[1] = first
    sent.age, sent.arrived, sent.plain = 0, 0, 0
    ahead = pending.committed[PREDICTED : PREDICTED + 1]
    for k in (LOST, STARTED):
        ahead[0] = pending.committed[COMMITTED]
        if k == STARTED:
            follow_on(pending.sent, ahead, tick)
        w_x, w_y = trajectory_command(ahead[0], own.v_x, own.v_y, bounds.u_a, bounds.dt)
        there, _ = step_in_area(bounds, own, w_x, w_y)
        expect(pending, k, there, IN_PLANE)


@compiled
def carried(bounds: SafetyBounds, pending: PendingCommands, tick: int) -> int:
    """Return the number of plans in this tick's command: its own, and earlier ones that have not started."""
    last, n = tick + bounds.delay_ticks, 0
    while n < MOST_CARRIED and last - n >= tick:
        if pending.sent[(last - n) % pending.sent.shape[0]].begins != last - n:
            break
        n += 1
    return n


@compiled
def add_plans(
    bounds: SafetyBounds, pending: PendingCommands, tick: int, outgoing: RecordArray
) -> tuple[int, int]:
    """Add the plans of this tick's command to the outgoing ones.

    Returns:
        First tick of the last plan, and the number of plans.
    """
    last, n = tick + bounds.delay_ticks, carried(bounds, pending, tick)
    for begins in range(last - n + 1, last + 1):
        keep_trajectory(outgoing, pending.sent[begins % pending.sent.shape[0]], tick)
    return last, n
