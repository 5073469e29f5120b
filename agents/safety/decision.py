"""Decision of one UAV's safety filter in a tick. See docs/explanation/proof.md.

`SafetyFilter` calls `decide` for one UAV, compiled loops call it for many worlds.

Each command carries a plan: the acceleration of one tick, and the backup trajectory that follows if later commands are
lost. The vehicle reports its committed trajectory, so the filter can predict the states until the plan of this tick's
command begins.

Positions in the world's frame [m], speeds [m/s], accelerations [m/s²], times in ticks.
"""

from typing import NamedTuple

from agents.safety.area import step_in_area
from agents.safety.discs import (
    KnownDiscs,
    certified_distance,
    farthest,
    known_discs,
    newest_disc,
)
from agents.safety.memory import FilterMemory
from agents.safety.pending import (
    IN_PLANE,
    Height,
    check_rest,
    is_expected,
    predict,
    receive_observation,
    send_plan,
    update_plan,
)
from agents.safety.search import search_control
from agents.safety.trajectories import (
    contradicts_plan,
    end_disc,
    follow,
    return_from,
    servo,
    stop_from,
)
from bus.messages.decision import NotCertified, Source
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray, code
from sim.models.safety import SafetyBounds
from sim.models.trajectories import NO_TRAJECTORY
from sim.models.vehicles import State, brake, clip_norm

NOMINAL = code(Source.NOMINAL)
BACKUP = code(Source.BACKUP)
BEST_EFFORT = code(Source.BEST_EFFORT)

CERTIFIED = 0
_ASSUMPTIONS = code(NotCertified.ASSUMPTIONS)
_NO_MEASUREMENT = code(NotCertified.NO_MEASUREMENT)
_MEASUREMENT_TOO_OLD = code(NotCertified.MEASUREMENT_TOO_OLD)
_CONTRADICTION = code(NotCertified.CONTRADICTION)
_COMMAND_INTERVAL = code(NotCertified.COMMAND_INTERVAL)
_NO_PLAN = code(NotCertified.NO_PLAN)
_OFF_TRAJECTORY = code(NotCertified.OFF_TRAJECTORY)
_UNCHECKED_PLAN = code(NotCertified.UNCHECKED_PLAN)


@compiled
def _stays_in_sight(
    bounds: SafetyBounds,
    known: KnownDiscs,
    checked: bool,
    tick: int,
    own: State,
    then: State,
    over: float,
) -> bool:
    """Return whether the UGV is certainly in sight now, and until the next tick if the UAV touches a wall.

    The wall holds the UAV back by `over` [m]. A plan checked with these bounds implies that the UGV is in sight now.
    """
    within = (
        checked or farthest(bounds, known, tick, own.p_x, own.p_y, bounds.radius) <= bounds.radius
    )
    if within and over > 0.0:
        # during the tick, the bound is at most that at the point beyond the wall
        room = bounds.radius - over
        within = farthest(bounds, known, tick + 1, then.p_x, then.p_y, room) <= room
    return within


@compiled
def try_nominal(
    bounds: SafetyBounds,
    known: KnownDiscs,
    plan: RecordArray,
    tick: int,
    own: State,
    u_x: float,
    u_y: float,
) -> tuple[bool, float, float]:
    """Store a plan that begins after a tick of the nominal acceleration.

    Arguments as in `choose_control`.

    Returns:
        False, without changes, if there is none; and the nominal acceleration within its bound [m/s²].
    """
    w_x, w_y = clip_norm(u_x, u_y, bounds.u_a)
    then, over = step_in_area(bounds, own, w_x, w_y)
    found = False
    # a plan checked from a higher altitude, where the UAV sees farther, implies nothing
    checked = plan[0].checked != 0 and plan[0].floor <= bounds.floor
    if _stays_in_sight(bounds, known, checked, tick, own, then, over):
        found = stop_from(bounds, known, plan, tick + 1, then)
        found = found or return_from(bounds, known, plan, tick + 1, then)
    return found, w_x, w_y


@compiled
def best_effort(
    bounds: SafetyBounds, discs: RecordArray, plan: RecordArray, own: State
) -> tuple[float, float]:
    """Return the acceleration towards the newest measurement; without one, brake [m/s²]. The plan is unchecked."""
    plan[0].checked = 0
    new = newest_disc(discs)
    if new < 0:
        u_x, u_y = brake(own.v_x, own.v_y, bounds.u_a, bounds.dt)
        return u_x, u_y
    u_x, u_y = servo(own, discs[new].x, discs[new].y, bounds.v_a, bounds.u_a, bounds.dt)
    return u_x, u_y


@compiled
def choose_control(
    bounds: SafetyBounds,
    discs: RecordArray,
    plan: RecordArray,
    tick: int,
    own: State,
    u_x: float,
    u_y: float,
) -> tuple[float, float, int]:
    """Return the acceleration of a tick: the nominal one if a plan exists after it, else the plan's.

    With delayed commands, tick and state are those at which this command takes effect. The current plan begins in this
    state.

    Args:
        bounds: Bounds of the filter.
        discs: `Disc` of each kept measurement, from `add_disc`. Shape (KEPT,).
        plan: `CheckedTrajectory` of the current plan, changed in place. Shape (1,).
        tick: Tick in which the command takes effect.
        own: State of the UAV at that tick.
        u_x, u_y: Nominal acceleration [m/s²].

    Returns:
        The acceleration [m/s²], and its source: NOMINAL, BACKUP or BEST_EFFORT.
    """
    new = newest_disc(discs)
    if new < 0:
        u_x, u_y = brake(own.v_x, own.v_y, bounds.u_a, bounds.dt)
        return u_x, u_y, BEST_EFFORT
    backup = plan[0]
    going = backup.checked != 0 and backup.turn + backup.cruise + backup.brake > 0
    known = known_discs(bounds, discs, end_disc(plan), new, tick, own)
    found, w_x, w_y = try_nominal(bounds, known, plan, tick, own, u_x, u_y)
    if found:
        return w_x, w_y, NOMINAL
    found = return_from(bounds, known, plan, tick, own)
    if not found and not going:
        found = stop_from(bounds, known, plan, tick, own, 1)
    if found or going:
        w_x, w_y = follow(bounds, plan, own.v_x, own.v_y)
        return w_x, w_y, BACKUP
    w_x, w_y = best_effort(bounds, discs, plan, own)
    return w_x, w_y, BEST_EFFORT


@compiled
def _executed_plan(
    bounds: SafetyBounds,
    memory: FilterMemory,
    tick: int,
    own: State,
    height: Height,
    committed: int,
) -> int:
    """Return the plan executed in the previous tick; NO_TRAJECTORY: none.

    A receiver of plain accelerations reports none. If each command takes effect in its own tick, the state of the UAV
    shows whether the last plan has started.
    """
    if committed != NO_TRAJECTORY or bounds.delay_ticks > 0 or bounds.interval_ticks > 1:
        return committed
    pending, last = memory.pending, tick - 1
    begins = pending.sent[last % pending.sent.shape[0]].begins
    answered = last >= 0 and memory.flags[0].tick == last and begins == last
    return last if answered and is_expected(pending, tick, own, height, last) else committed


@compiled
def _reason(
    bounds: SafetyBounds,
    memory: FilterMemory,
    tick: int,
    source: int,
    expected: bool,
    checked: bool,
    wait: int,
) -> int:
    """Return the code of `NotCertified` for this tick; CERTIFIED if it is certified."""
    if not bounds.valid:
        return _ASSUMPTIONS
    new = newest_disc(memory.discs)
    if new < 0:
        return _NO_MEASUREMENT
    if tick - memory.discs[new].tick > bounds.max_age_ticks:
        return _MEASUREMENT_TOO_OLD
    if memory.flags[0].contradicted != 0:
        return _CONTRADICTION
    late = (
        wait > bounds.interval_ticks
    )  # also if it is still in the future but can no longer be prevented
    if source == BEST_EFFORT:
        return _COMMAND_INTERVAL if late else _NO_PLAN
    if not expected:
        return _OFF_TRAJECTORY
    if late:
        return _COMMAND_INTERVAL
    return CERTIFIED if checked else _UNCHECKED_PLAN


class Beginning(NamedTuple):
    """State of the filter at a tick, before it decides."""

    ahead: State
    """Predicted state of the UAV when the plan of this tick's command begins."""
    expected: bool
    """True if the UAV is in the state that its reported trajectory implies."""
    checked: bool
    """True if every plan until then is checked."""
    wait: int
    """Least time without a new plan at that tick [ticks]."""


@compiled
def begin_decision(
    bounds: SafetyBounds,
    memory: FilterMemory,
    tick: int,
    own: State,
    height: Height,
    committed: int,
) -> Beginning:
    """Record the observation of this tick, and predict the UAV's state.

    Arguments as in `decide`; `height` is IN_PLANE for a UAV without an altitude.
    """
    flags, pending, plan, discs = memory.flags[0], memory.pending, memory.plan, memory.discs
    decision = memory.decision[0]
    decision.certified_distance = certified_distance(bounds, discs, tick, own.p_x, own.p_y)
    committed = _executed_plan(bounds, memory, tick, own, height, committed)
    expected = receive_observation(pending, tick, own, height, committed, flags.tick)
    flags.from_start = 1 if tick == 0 else flags.from_start
    if flags.from_start == 1 and height.rate == 0.0:
        check_rest(bounds, pending, discs, plan, tick, own)
    ahead, checked, wait = predict(bounds, pending, tick, own)
    update_plan(pending, plan)
    if contradicts_plan(bounds, discs, plan):
        flags.contradicted = 1
    return Beginning(ahead, expected, checked, wait)


@compiled
def end_decision(
    bounds: SafetyBounds,
    memory: FilterMemory,
    tick: int,
    own: State,
    beginning: Beginning,
    acceleration: tuple[float, float],
    source: int,
) -> None:
    """Record the decision: the acceleration [m/s²] and its source. Other arguments as in `decide`."""
    decision = memory.decision[0]
    checked = source != BEST_EFFORT
    send_plan(bounds, memory.pending, memory.plan, tick, own, acceleration, checked)
    memory.flags[0].tick = tick
    decision.acceleration[0], decision.acceleration[1] = acceleration
    decision.source = source
    decision.reason = _reason(
        bounds, memory, tick, source, beginning.expected, beginning.checked, beginning.wait
    )


@compiled
def decide(
    bounds: SafetyBounds,
    memory: FilterMemory,
    tick: int,
    own: State,
    u_x: float,
    u_y: float,
    committed: int = NO_TRAJECTORY,
) -> None:
    """Decide on the nominal acceleration: apply it if the UGV stays in sight after it, else a backup trajectory.

    Call it once per tick, since it advances the plan. The decision is in `memory.decision`, the plan of the command in
    `memory.pending`.

    Args:
        bounds: Bounds of the filter.
        memory: Memory of the filter, changed in place.
        tick: Current tick.
        own: Current state of the UAV.
        u_x, u_y: Nominal acceleration [m/s²].
        committed: First tick of the plan executed in the previous tick; NO_TRAJECTORY: none.
    """
    beginning = begin_decision(bounds, memory, tick, own, IN_PLANE, committed)
    begins = tick + bounds.delay_ticks
    u_x, u_y, source = choose_control(
        bounds, memory.discs, memory.plan, begins, beginning.ahead, u_x, u_y
    )
    if source == BEST_EFFORT:
        u_x, u_y = search_control(bounds, memory, begins, beginning.ahead, u_x, u_y)
    end_decision(bounds, memory, tick, own, beginning, (u_x, u_y), source)
