"""A UAV's tick on board, compiled: the pilot calls it for one vehicle, batches for many.

In a tick: `uav_perceive` with what has arrived, then a step of the filter (`agents.estimation.filtering`), then
`uav_tick` for the command.
"""

from typing import NamedTuple

from agents.control.certificate import INNER, NO_DETECTION
from agents.control.guard import GuardState, guard, note_detection, note_position
from agents.control.laws import (
    LOOKAHEAD,
    LawParameters,
    OwnTerms,
    uav_control,
)
from agents.control.lookahead import LookaheadMemory, Target, lookahead_control
from bus.ticks import Look
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray, columns
from sim.models.field import accumulate
from sim.models.safety import SafetyBounds
from sim.models.vehicles import Motion, brake, clip_norm

LOOK = columns(Look)
"""Columns of an array of looks."""


class UavMemory(NamedTuple):
    """The memory of a UAV; its arrays change in place."""

    coverage: FloatArray
    """Its own map C of (3). Shape (rows, columns)."""
    law: RecordArray
    """Of the law, from `agents.control.laws.initial_state`."""
    guard: GuardState
    """Of the safety filter."""


@compiled
def uav_perceive(
    law: LawParameters,
    promise: SafetyBounds,
    guarded: bool,
    memory: UavMemory,
    looked: int,
    tick: int,
    here: Motion,
    looks: FloatArray,
    arrived: int,
) -> None:
    """Take in what is seen of the ground, and for the safety filter where the UAV is and what has arrived.

    Args:
        law, promise: Parameters of the law and of the safety filter.
        guarded: Whether the safety filter watches over the UAV.
        memory: Is changed.
        looked: Ticks for which it has looked at the ground below since it perceived last; 0: not at all.
        tick: Now.
        here: Where it is.
        looks: Detections. Shape (rows, 3).
        arrived: How many rows count.
    """
    c = law
    if looked > 0:
        accumulate(
            memory.coverage, here.p_x, here.p_y, c.sensor, c.peak, c.reach, c.cell, looked * c.dt
        )
    if guarded:
        note_position(memory.guard, tick, here.p_x, here.p_y)
        for n in range(arrived):
            taken, x, y = int(looks[n, LOOK.taken]), looks[n, LOOK.x], looks[n, LOOK.y]
            note_detection(promise, memory.guard, taken, tick, x, y, here.p_x, here.p_y)


@compiled
def uav_tick(
    law: LawParameters,
    promise: SafetyBounds,
    guarded: bool,
    memory: UavMemory,
    lookahead: LookaheadMemory | None,
    own: OwnTerms,
    tick: int,
    here: Motion,
    target: Target,
    flown: int,
) -> tuple[float, float, int, int, float]:
    """The UAV's command under any law, within the bound of (1), and within the safety filter where there is one.

    Before the first detection it stays where it is.

    Args:
        law, promise, guarded, memory, tick, here: As in `uav_perceive`.
        lookahead: Memory of the law `lookahead`; None: another law flies, and nothing of this one is compiled.
        own: What the user's function says at this tick, for the laws `weighted` and `path`.
        target: What is believed of the UGV.
        flown: As in `agents.control.guard.guard`.

    Returns:
        As `agents.control.guard.guard`; without the filter nothing acts but the law, and nothing is certified.
    """
    if not target.known:
        u_x, u_y = brake(here.v_x, here.v_y, law.u_max, law.dt)
    elif lookahead is not None and law.law == LOOKAHEAD:
        u_x, u_y = lookahead_control(law, memory.coverage, lookahead, tick, here, target)
    else:
        u_x, u_y = uav_control(
            law, own, memory.coverage, memory.law, tick, here, target.p_x, target.p_y
        )
        u_x, u_y = clip_norm(u_x, u_y, law.u_max)
    if not guarded:
        return u_x, u_y, INNER, NO_DETECTION, 0.0
    return guard(promise, memory.guard, tick, here, u_x, u_y, flown)
