"""Paper's driver: straight to one goal after the other (section II)."""

import msgspec

from agents.drivers.parameters import DriverInputs, UgvParameters
from agents.drivers.steering import goal_control
from sim.compiling.compile import FloatArray, compiled
from sim.models.kinematics import UgvState
from sim.models.vehicles import next_goal


class Parameters(msgspec.Struct, frozen=True, kw_only=True):
    """Parameters of the driver: none."""


class Memory:
    """Memory of the driver."""

    goal: int
    """Number of the current goal."""


@compiled
def waypoint_command(
    ugv: UgvParameters, memory: Memory, goals: FloatArray, own: UgvState
) -> tuple[float, float]:
    """Return the command [m/s²] to one goal after the other; without goals, to the UGV's own position.

    A goal is reached when it is nearer than the tolerance; the last one stays.

    Args:
        ugv: Constants of the UGV; bounds may be infinite.
        memory: Changed in place.
        goals: Goals [m]. Shape (goals, 2).
        own: State of the UGV.
    """
    goal_x, goal_y = own.p_x, own.p_y
    if len(goals) > 0:
        reached, _ = next_goal(goals, memory.goal, ugv.goal_tolerance, own.p_x, own.p_y)
        memory.goal = min(reached, len(goals) - 1)
        goal_x, goal_y = goals[memory.goal, 0], goals[memory.goal, 1]
    return goal_control(ugv, own, goal_x, goal_y, ugv.max_speed)


@compiled
def command(
    ugv: UgvParameters,
    driver: Parameters,
    memory: Memory,
    inputs: DriverInputs,
) -> tuple[float, float]:
    """Return the acceleration that drives from goal to goal [m/s²]."""
    return waypoint_command(ugv, memory, inputs.goals, inputs.own)
