"""Perception of the UAVs of a batch, compiled."""

from typing import Any

from agents.safety.memory import FilterMemory, add_measurement, add_position
from bus.ticks import Look
from sim.compiling.compile import FloatArray, compiled
from sim.models.safety import SafetyBounds
from sim.models.vehicles import Motion

DETECTION: Any = Look._make(range(3))
"""Columns of an array of detections."""


@compiled
def add_detections(
    bounds: SafetyBounds,
    memory: FilterMemory,
    tick: int,
    here: Motion,
    detections: FloatArray,
    arrived: int,
) -> None:
    """Update the safety filter's memory of own positions and detections.

    Args:
        bounds: Bounds of the safety filter.
        memory: Memory of the safety filter, changed in place.
        tick: Current tick.
        here: Current state of the UAV.
        detections: Detections. Shape (rows, 3).
        arrived: Number of valid rows of `detections`.
    """
    add_position(memory, tick, here.p_x, here.p_y)
    for n in range(arrived):
        taken, x, y = (
            int(detections[n, DETECTION.taken]),
            detections[n, DETECTION.x],
            detections[n, DETECTION.y],
        )
        add_measurement(bounds, memory, taken, (x, y), tick, here)
