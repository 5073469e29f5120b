"""Safety filter of one UAV in a tick, compiled: its measurements, then its decision."""

from typing import Any

from agents.safety.altitude import Acceleration, decide_height, decide_in_space
from agents.safety.decision import decide
from agents.safety.memory import FilterMemory, add_measurement, add_position
from agents.uav_inputs import DETECTION, UavInputs
from sim.compiling.compile import compiled
from sim.compiling.records import RecordArray


@compiled
def record_measurements(safety: RecordArray, memory: FilterMemory, inputs: UavInputs) -> None:
    """Update the filter's memory of own positions and detections.

    Args:
        safety: `SafetyBounds` of the filter. Shape (1,).
        memory: Memory of the filter, changed in place.
        inputs: State and messages.
    """
    tick, own, rows = inputs.tick, inputs.own, inputs.detections
    add_position(memory, tick, own.p_x, own.p_y)
    for n in range(inputs.received):
        taken, relative = (
            int(rows[n, DETECTION.taken]),
            (rows[n, DETECTION.x], rows[n, DETECTION.y]),
        )
        add_measurement(safety[0], memory, taken, relative, tick, own)


@compiled
def bare_control(
    levels: RecordArray | None, memory: FilterMemory, inputs: UavInputs, nominal: Acceleration
) -> tuple[float, float, float]:
    """Return the acceleration of a UAV that flies without its safety filter [m/s²]; see `decide_height`.

    In the plane it is the nominal one. With an altitude, the filter's memory holds the plan of the command.

    Args:
        levels, memory, inputs, nominal: As in `filter_control`.
    """
    vertical: Any = inputs.vertical
    if levels is None:
        return nominal.x, nominal.y, nominal.z
    if not vertical.flies:
        return nominal.x, nominal.y, nominal.z
    decide_height(levels, memory, inputs.tick, inputs.own, vertical, nominal, inputs.committed)
    decision = memory.decision[0]
    return decision.acceleration[0], decision.acceleration[1], decision.vertical_acceleration


@compiled
def filter_control(
    safety: RecordArray,
    levels: RecordArray | None,
    memory: FilterMemory,
    inputs: UavInputs,
    nominal: Acceleration,
) -> tuple[float, float, float]:
    """Return the acceleration that the safety filter permits [m/s²]; decision and plan are in its memory.

    Args:
        safety: `SafetyBounds` of the filter; with an altitude, those at the initial altitude. Shape (1,).
        levels: Its bounds by increasing floor; None: all UAVs fly in the plane. Shape (levels,).
        memory: Memory of the filter, changed in place.
        inputs: State and messages, after `record_measurements`.
        nominal: Nominal acceleration of the law, the operator or the policy.
    """
    tick, own, committed = inputs.tick, inputs.own, inputs.committed
    vertical: Any = inputs.vertical  # not None if levels are not
    if levels is None:
        decide(safety[0], memory, tick, own, nominal.x, nominal.y, committed)
    elif vertical.flies:
        decide_in_space(levels, memory, tick, own, vertical, nominal, committed)
    else:
        decide(safety[0], memory, tick, own, nominal.x, nominal.y, committed)
    decision = memory.decision[0]
    return decision.acceleration[0], decision.acceleration[1], decision.vertical_acceleration
