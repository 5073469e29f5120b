"""Perception of the UAVs of a batch, compiled."""

from typing import Any

from agents.safety.decision import GuardState, note_detection, note_position
from agents.uav_parameters import UavParameters
from bus.ticks import Look
from sim.compiling.compile import FloatArray, compiled
from sim.models.field import accumulate
from sim.models.safety import SafetyBounds
from sim.models.vehicles import Motion

LOOK: Any = Look._make(range(3))
"""Columns of an array of looks."""


@compiled
def uav_perceive(
    uav: UavParameters,
    promise: SafetyBounds,
    guarded: bool,
    coverage: FloatArray,
    guard: GuardState,
    looked: int,
    tick: int,
    here: Motion,
    looks: FloatArray,
    arrived: int,
) -> None:
    """Take in what is seen of the ground, and for the safety filter where the UAV is and what has arrived.

    Args:
        uav, promise: Constants of the UAV, and parameters of the safety filter.
        guarded: Whether the safety filter watches over the UAV.
        coverage: The UAV's coverage grid C, changed in place. Shape (rows, columns).
        guard: Memory of the safety filter, changed in place.
        looked: Ticks for which it has looked at the ground below since it perceived last; 0: not at all.
        tick: Now.
        here: Where it is.
        looks: Detections. Shape (rows, 3).
        arrived: How many rows count.
    """
    if looked > 0:
        accumulate(
            coverage,
            here.p_x,
            here.p_y,
            uav.sensor,
            uav.cell,
            looked * uav.dt,
        )
    if guarded:
        note_position(guard, tick, here.p_x, here.p_y)
        for n in range(arrived):
            taken, x, y = int(looks[n, LOOK.taken]), looks[n, LOOK.x], looks[n, LOOK.y]
            note_detection(promise, guard, taken, tick, x, y, here.p_x, here.p_y)
