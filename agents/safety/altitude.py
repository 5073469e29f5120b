r"""Decision of the safety filter of a UAV with an altitude. The proof is in docs/explanation/proof.md.

The radius $R(z)$ within which the UGV is visible grows with the altitude: see `visible_radius`. The filter has a table
of bounds, each valid from an altitude on, its floor. After the first tick of a plan the UAV levels off, so the lowest
altitude of the plan is known when it is checked. The plan is checked with the bounds of the highest floor below it:
while the UAV is above the floor, it sees at least as far as the check assumes. If that floor is lower than that of the
executed plan, the UGV must be within the smaller radius already where the plan begins.

Altitudes above the ground [m], climb rates [m/s], vertical accelerations [m/s²].
"""

from typing import NamedTuple

from agents.safety.decision import (
    BACKUP,
    BEST_EFFORT,
    CERTIFIED,
    NOMINAL,
    begin_decision,
    best_effort,
    choose_control,
    end_decision,
    try_nominal,
)
from agents.safety.discs import known_discs, newest_disc
from agents.safety.memory import FilterMemory
from agents.safety.pending import (
    COMMITTED,
    LOST,
    PREDICTED,
    STARTED,
    Height,
    PendingCommands,
)
from agents.safety.search import search_control
from agents.safety.trajectories import end_disc
from bus.messages.decision import NotCertified
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, code
from sim.models.altitude import (
    VerticalLimits,
    VerticalState,
    level_off,
    lowest_ahead,
    step_altitude,
)
from sim.models.trajectories import NO_TRAJECTORY, follow_on
from sim.models.vehicles import State, brake, clip_norm

_TOO_LOW = code(NotCertified.TOO_LOW)
_OFF_TRAJECTORY = code(NotCertified.OFF_TRAJECTORY)

_SLACK = 1e-6
"""Depth below a floor down to which a new plan may lead [m]; a plan that continues may lead twice as low.

Both are far above the effect of rounding. The bounds of a floor hold from `FLOOR_MARGIN` below it.
"""
FLOOR_MARGIN = 3.0 * _SLACK


class Acceleration(NamedTuple):
    """Acceleration of a UAV [m/s²]."""

    x: float
    y: float
    z: float


@compiled
def level_of(levels: RecordArray, z: float, slack: float = _SLACK) -> int:
    """Return the row of the highest floor at most `slack` above an altitude; -1: none. Floors increase with the row."""
    found = -1
    for k in range(levels.shape[0]):
        if levels[k].floor <= z + slack:
            found = k
    return found


@compiled
def _step(vertical: VerticalState, start: Height, command: float, dt: float) -> Height:
    limits = VerticalLimits(
        vertical.lowest, vertical.highest, vertical.max_rate, vertical.max_acceleration
    )
    z, rate, _ = step_altitude(start.z, start.rate, command, limits, dt)
    return Height(z, rate)


@compiled
def _plan_step(vertical: VerticalState, start: Height, plan: RecordArray, dt: float) -> Height:
    """Return the height after a tick of the plan in a table of one row, at its age."""
    if plan[0].begins >= 0 and plan[0].age == 0:
        return _step(vertical, start, plan[0].vertical_acceleration, dt)
    return _step(vertical, start, level_off(start.rate, vertical.max_acceleration, dt), dt)


@compiled
def predict_height(
    pending: PendingCommands, vertical: VerticalState, tick: int, delay_ticks: int, dt: float
) -> tuple[Height, float]:
    """Predict the height at which the plan of this tick's command begins, as `predict` does for the state in the plane.

    Returns:
        The height, and the lowest altitude until then [m].
    """
    height, lowest = Height(vertical.altitude, vertical.rate), vertical.altitude
    ahead = pending.committed[PREDICTED : PREDICTED + 1]
    ahead[0] = pending.committed[COMMITTED]
    for k in range(delay_ticks):
        follow_on(pending.sent, ahead, tick + k)
        height = _plan_step(vertical, height, ahead, dt)
        ahead[0].age += 1
        lowest = min(lowest, height.z)
    return height, lowest


@compiled
def _expect_height(pending: PendingCommands, vertical: VerticalState, tick: int, dt: float) -> None:
    """Record the expected heights at the next tick, as `send_plan` does for the state in the plane."""
    ahead = pending.committed[PREDICTED : PREDICTED + 1]
    for k in (LOST, STARTED):
        ahead[0] = pending.committed[COMMITTED]
        if k == STARTED:
            follow_on(pending.sent, ahead, tick)
        there = _plan_step(vertical, Height(vertical.altitude, vertical.rate), ahead, dt)
        pending.expected[k].z, pending.expected[k].rate = there.z, there.rate


@compiled
def _lowest_after(vertical: VerticalState, start: Height, command: float, dt: float) -> float:
    """Return the lowest altitude of a plan whose first tick has this vertical acceleration [m].

    A descent at rate v that turns into a climb within a tick, with the acceleration a, falls v²/(2a) before it turns.
    """
    then = _step(vertical, start, command, dt)
    within = min(start.z, then.z)
    if start.rate < 0.0 < then.rate:
        within = start.z - 0.5 * start.rate * start.rate * dt / (then.rate - start.rate)
    return min(within, lowest_ahead(then.z, then.rate, vertical.max_acceleration, dt))


@compiled
def _climb(
    levels: RecordArray, vertical: VerticalState, ahead: Height, own: State, u_x: float, u_y: float
) -> Acceleration:
    """Return the acceleration of a UAV below every floor: it climbs, and brakes below the roofs.

    Args:
        levels, vertical: As in `decide_in_space`.
        ahead, own: Height and horizontal state when the command takes effect.
        u_x, u_y: Horizontal acceleration above the roofs [m/s²].
    """
    u_z, dt = vertical.max_acceleration, levels[0].dt
    if _lowest_after(vertical, ahead, u_z, dt) < levels[0].roofs - 2.0 * _SLACK:
        u_x, u_y = brake(own.v_x, own.v_y, levels[0].u_a, dt)
    return Acceleration(u_x, u_y, u_z)


@compiled
def decide_height(
    levels: RecordArray,
    memory: FilterMemory,
    tick: int,
    own: State,
    vertical: VerticalState,
    nominal: Acceleration,
    committed: int = NO_TRAJECTORY,
) -> None:
    """Apply the vertical rule alone, for a UAV that need not keep the UGV in sight; it certifies nothing.

    The UAV stays above every roof (Lemma 10), and as high as the filter certifies. The horizontal acceleration changes
    only below the roofs. Each command carries a plan as in `decide_in_space`: the UAV stops and levels off after it.
    So its height is known when the next command takes effect, and when the filter begins to act.

    Args:
        levels, memory, tick, own, vertical, nominal, committed: As in `decide_in_space`.
    """
    dt = levels[0].dt
    beginning = begin_decision(
        levels[0], memory, tick, own, Height(vertical.altitude, vertical.rate), committed
    )
    ahead, _ = predict_height(memory.pending, vertical, tick, levels[0].delay_ticks, dt)
    u_x, u_y = clip_norm(nominal.x, nominal.y, levels[0].u_a)
    u_z = nominal.z
    if level_of(levels, _lowest_after(vertical, ahead, u_z, dt)) < 0:
        u_z = level_off(ahead.rate, vertical.max_acceleration, dt)
        if level_of(levels, _lowest_after(vertical, ahead, u_z, dt), 2.0 * _SLACK) < 0:
            u_x, u_y, u_z = _climb(levels, vertical, ahead, beginning.ahead, u_x, u_y)
    end_decision(levels[0], memory, tick, own, beginning, (u_x, u_y), BEST_EFFORT)
    _expect_plan(memory, vertical, tick, levels[0].delay_ticks, u_z, dt)


@compiled
def _expect_plan(
    memory: FilterMemory,
    vertical: VerticalState,
    tick: int,
    delay: int,
    u_z: float,
    dt: float,
) -> None:
    """Add the vertical acceleration [m/s²] to the plan of this tick, which begins `delay` ticks later."""
    sent = memory.pending.sent
    sent[(tick + delay) % sent.shape[0]].vertical_acceleration = u_z
    _expect_height(memory.pending, vertical, tick, dt)
    memory.decision[0].vertical_acceleration = u_z


@compiled
def decide_in_space(
    levels: RecordArray,
    memory: FilterMemory,
    tick: int,
    own: State,
    vertical: VerticalState,
    nominal: Acceleration,
    committed: int = NO_TRAJECTORY,
) -> None:
    """Decide on the nominal accelerations of a UAV with an altitude; as `decide` otherwise.

    The nominal accelerations are applied if a plan exists after them. Otherwise the UAV levels off, and
    `choose_control` decides on its horizontal acceleration. Below every floor it climbs and flies to the newest
    measurement, below the roofs it climbs and brakes.

    Args:
        levels: `SafetyBounds` by increasing floor. Shape (levels,).
        memory: Memory of the filter, changed in place.
        tick: Current tick.
        own: Current horizontal state of the UAV.
        vertical: Vertical limits and state of the UAV.
        nominal: Nominal acceleration.
        committed: As in `decide`.
    """
    dt, delay = levels[0].dt, levels[0].delay_ticks
    plan, discs = memory.plan, memory.discs
    now = level_of(
        levels, lowest_ahead(vertical.altitude, vertical.rate, vertical.max_acceleration, dt)
    )
    beginning = begin_decision(
        levels[max(now, 0)], memory, tick, own, Height(vertical.altitude, vertical.rate), committed
    )
    floor = memory.pending.committed[COMMITTED].floor
    ahead, lowest = predict_height(memory.pending, vertical, tick, delay, dt)
    follows = (
        vertical.altitude >= floor - 2.0 * _SLACK
        or memory.pending.committed[COMMITTED].checked == 0
    )
    begins, new = tick + delay, newest_disc(discs)
    source, u_z = BEST_EFFORT, nominal.z
    u_x, u_y = 0.0, 0.0
    level = level_of(levels, _lowest_after(vertical, ahead, u_z, dt))
    if level >= 0 and new >= 0:
        bounds = levels[level]
        known = known_discs(bounds, discs, end_disc(plan), new, begins, beginning.ahead)
        found, u_x, u_y = try_nominal(
            bounds, known, plan, begins, beginning.ahead, nominal.x, nominal.y
        )
        source = NOMINAL if found else BEST_EFFORT
    if source == BEST_EFFORT:
        u_z = level_off(ahead.rate, vertical.max_acceleration, dt)
        level = level_of(levels, _lowest_after(vertical, ahead, u_z, dt), 2.0 * _SLACK)
        if level >= 0:
            u_x, u_y, source = choose_control(
                levels[level], discs, plan, begins, beginning.ahead, nominal.x, nominal.y
            )
            source = BACKUP if source == NOMINAL and u_z != nominal.z else source
            if source == BEST_EFFORT:
                u_x, u_y = search_control(levels[level], memory, begins, beginning.ahead, u_x, u_y)
        else:
            u_x, u_y = best_effort(levels[0], discs, plan, beginning.ahead)
            u_x, u_y, u_z = _climb(levels, vertical, ahead, beginning.ahead, u_x, u_y)
    end_decision(levels[max(level, 0)], memory, tick, own, beginning, (u_x, u_y), source)
    _expect_plan(memory, vertical, tick, delay, u_z, dt)
    decision = memory.decision[0]
    if decision.reason == CERTIFIED and not follows:
        decision.reason = _OFF_TRAJECTORY
    if level < 0 or level_of(levels, lowest, 2.0 * _SLACK) < 0:
        decision.reason = _TOO_LOW
