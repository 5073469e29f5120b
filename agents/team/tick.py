"""A UAV's part in its team in a tick, compiled. A part that is None is not compiled."""

from typing import Any

from agents.safety.memory import FilterMemory
from agents.team.coverage import hear_blocks, share_coverage
from agents.team.records import SCOUT, TeamMemory
from agents.team.roles import accept, begin_tick, control_of_role
from agents.uav_inputs import UavInputs
from agents.uav_parameters import UavParameters
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray
from sim.models.altitude import VerticalState
from sim.models.vehicles import State


@compiled
def perceive_team(
    parameters: RecordArray | None,
    memory: TeamMemory | None,
    inputs: UavInputs,
    safety: RecordArray,
    filter_memory: FilterMemory,
    fixed: UavParameters,
    uav: UavParameters,
    coverage: FloatArray,
    filtered: bool,
) -> bool:
    """Receive the messages of a tick; return whether the UAV's commands pass its safety filter.

    Args:
        parameters: `TeamParameters`; None: there are no teams, and the result is `filtered`. Shape (1,).
        memory: Memory of the UAV in its team, changed in place.
        inputs: State and messages.
        safety: `SafetyBounds` of its filter. Shape (1,).
        filter_memory: Memory of its filter, changed in place.
        fixed: Constants of the UAV.
        uav: The same as the law reads them: a scout's `max_distance` and `switching_radius` are changed.
        coverage: Its own map. Shape (rows, columns).
        filtered: Result without a team.
    """
    if parameters is None:
        return filtered
    one = parameters[0]
    own_memory: Any = memory
    team: Any = inputs.team
    changing: Any = uav
    begin_tick(one, own_memory, team, inputs, safety[0], filter_memory)
    for n in range(team.messages.shape[0]):
        hear_blocks(own_memory, team.messages[n])
    if inputs.tick % one.period == 0:
        share_coverage(
            one, own_memory, coverage, inputs.own, inputs.tick, uav.cell, uav.desired_coverage
        )
    own = own_memory.own[0]
    changing.max_distance = one.scout_range if own.role == SCOUT else fixed.max_distance
    changing.switching_radius = one.scout_range if own.role == SCOUT else fixed.switching_radius
    return bool(own.filtered)


@compiled
def role_filters(memory: TeamMemory | None, filtered: bool) -> bool:
    """Return whether a UAV's commands pass its safety filter in this tick; `filtered`: result without a team."""
    return filtered if memory is None else memory.own[0].filtered


@compiled
def role_carries_plans(
    memory: TeamMemory | None, levels: RecordArray | None, vertical: VerticalState | None
) -> bool:
    """Return whether a UAV's commands carry plans in every role, as they do at an altitude; see `decide_height`."""
    if memory is None or levels is None:
        return False
    return False if vertical is None else vertical.flies


@compiled
def role_control(
    parameters: RecordArray | None,
    memory: TeamMemory | None,
    state: State,
    safety: RecordArray,
    nominal: tuple[float, float],
) -> tuple[float, float]:
    """Return the acceleration of a UAV's role, see `control_of_role`; without a team, the nominal one [m/s²]."""
    if parameters is None or memory is None:
        return nominal
    u_x, u_y = control_of_role(parameters[0], memory, state, safety[0], nominal)
    return u_x, u_y


@compiled
def role_accepts(
    parameters: RecordArray | None, memory: TeamMemory | None, certified: bool
) -> None:
    """Let a UAV begin to guard if its filter certifies this tick (R1)."""
    if parameters is not None and memory is not None:
        accept(parameters[0], memory, certified)


@compiled
def law_coverage(memory: TeamMemory | None, coverage: FloatArray) -> FloatArray:
    """Return the map that the law sees: its own, or the team's in which ground nearer to a team-mate is covered."""
    return coverage if memory is None else memory.coverage
