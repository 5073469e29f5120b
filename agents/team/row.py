"""Team entries of a UAV's observation row, compiled: `bus.observations.TEAM`, then `MATE` for each other UAV."""

import math

from agents.team.records import AWAY, GUARD, RELIEF, SCOUT, TeamMemory, TeamParameters
from bus.observations import MATE, TEAM
from sim.compiling.compile import FloatArray, compiled
from sim.models.vehicles import State

_OWN, _OF_MATE = len(TEAM), len(MATE)


def entries(mates: int) -> int:
    """Return the number of entries in a team of this number of UAVs."""
    return _OWN + _OF_MATE * (mates - 1)


@compiled
def _write_role(row: FloatArray, first: int, role: int) -> None:
    """Write a role as four entries, of which one is 1."""
    row[first] = 1.0 if role == SCOUT else 0.0
    row[first + 1] = 1.0 if role == RELIEF else 0.0
    row[first + 2] = 1.0 if role == GUARD else 0.0
    row[first + 3] = 1.0 if role == AWAY else 0.0


@compiled
def write_team_row(
    parameters: TeamParameters,
    memory: TeamMemory,
    state: State,
    tick: int,
    dt: float,
    never: float,
    row: FloatArray,
) -> None:
    """Write the team entries of a UAV's row.

    Args:
        parameters: Constants of the UAV.
        memory: Its memory in its team.
        state: Its state.
        tick: Current tick.
        dt: Length of a tick [s].
        never: Age of what was never received [s].
        row: Written. Shape (`entries`,) or more.
    """
    own, endurance = memory.own[0], parameters.endurance.endurance
    row[:] = 0.0
    _write_role(row, 0, own.role)
    row[4] = 1.0 if math.isinf(endurance) else own.charge / endurance
    row[8] = never
    if own.known_tick >= 0:
        row[5], row[6], row[7] = 1.0, state.p_x - own.known_x, state.p_y - own.known_y
        row[8] = (tick - own.known_tick) * dt
    first = _OWN
    for k in range(parameters.mates):
        if k == parameters.row:
            continue
        mate = memory.mates[k]
        row[first + 7] = never
        if mate.tick >= 0:
            row[first], row[first + 1] = 1.0, state.p_x - mate.x
            row[first + 2] = state.p_y - mate.y
            _write_role(row, first + 3, mate.role)
            row[first + 7] = (tick - mate.tick) * dt
        first += _OF_MATE
