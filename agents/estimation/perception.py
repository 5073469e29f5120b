"""Perception of the UAVs of a batch, compiled."""

from typing import Any

from agents.safety.memory import FilterMemory, add_measurement, add_position
from agents.uav_parameters import UavParameters
from bus.ticks import Look
from sim.compiling.compile import FloatArray, compiled
from sim.models.field import accumulate
from sim.models.safety import SafetyBounds
from sim.models.vehicles import Motion

DETECTION: Any = Look._make(range(3))
"""Columns of an array of detections."""


@compiled
def uav_perceive(
    uav: UavParameters,
    bounds: SafetyBounds,
    filtered: bool,
    coverage: FloatArray,
    memory: FilterMemory,
    looked: int,
    tick: int,
    here: Motion,
    detections: FloatArray,
    arrived: int,
) -> None:
    """Update the coverage grid, and the safety filter's memory of own positions and detections.

    Args:
        uav, bounds: Constants of the UAV, and bounds of the safety filter.
        filtered: True if the safety filter is active.
        coverage: Coverage grid C of the UAV, changed in place. Shape (rows, columns).
        memory: Memory of the safety filter, changed in place.
        looked: Ticks of sensing since the last update of the grid; 0: no update.
        tick: Current tick.
        here: Current state of the UAV.
        detections: Detections. Shape (rows, 3).
        arrived: Number of valid rows of `detections`.
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
    if filtered:
        add_position(memory, tick, here.p_x, here.p_y)
        for n in range(arrived):
            taken, x, y = (
                int(detections[n, DETECTION.taken]),
                detections[n, DETECTION.x],
                detections[n, DETECTION.y],
            )
            add_measurement(bounds, memory, taken, (x, y), tick, here)
