"""A pilot's part in its team: role, number and messages. The rules are compiled (`agents.team.roles`)."""

import numpy as np

from agents.team.messages import is_due, to_bus, write_message
from agents.team.records import TeamMemory
from agents.team.row import entries, write_team_row
from agents.team.tick import role_accepts, role_control
from agents.uav_inputs import TeamPacket, UavInputs
from bus.messages.base import Vector
from bus.messages.decision import FilterDecision
from bus.messages.team import Role, TeamMessage
from bus.messages.vehicle import UavBriefing
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray, choice, record_type
from sim.models.vehicles import State


@compiled
def _write(
    parameters: RecordArray,
    memory: TeamMemory,
    coverage: FloatArray,
    desired: float,
    state: State,
    tick: int,
    message: RecordArray,
) -> bool:
    """Write the message of a tick; return False if none is due."""
    one = parameters[0]
    if not is_due(one, tick):
        return False
    write_message(one, memory, coverage, desired, state, tick, message[0])
    return True


@compiled
def _write_row(
    parameters: RecordArray,
    memory: TeamMemory,
    state: State,
    tick: int,
    dt: float,
    never: float,
    row: FloatArray,
) -> None:
    write_team_row(parameters[0], memory, state, tick, dt, never, row)


class TeamMember:
    """Role of a UAV in its team.

    Args:
        briefing: Briefing of the UAV, with a team.
        parameters: Its `TeamParameters`. Shape (1,).
        memory: Its memory, which `perceive_team` changes in each tick.
        safety: `SafetyBounds` of its filter. Shape (1,).
    """

    def __init__(
        self,
        briefing: UavBriefing,
        parameters: RecordArray,
        memory: TeamMemory,
        safety: RecordArray,
    ) -> None:
        self._mates, self._area = briefing.mates, briefing.area
        self._desired = briefing.desired_coverage
        self._parameters, self._memory, self._safety = parameters, memory, safety
        self._message = np.zeros(1, record_type(TeamPacket))

    @property
    def role(self) -> Role:
        """Its role."""
        return choice(Role, int(self._memory.own[0]["role"])) or Role.RELIEF

    @property
    def number(self) -> int:
        """Its number, to be stored; 0: it has never guarded."""
        return int(self._memory.own[0]["number"])

    @property
    def filtered(self) -> bool:
        """True if its commands pass the safety filter in this tick."""
        return bool(self._memory.own[0]["filtered"])

    def control(self, inputs: UavInputs, acceleration: Vector) -> Vector:
        """Return the acceleration of its role, before the safety filter, see `control_of_role` [m/s²]."""
        u_x, u_y = map(float, acceleration)
        found: Vector = role_control(
            self._parameters, self._memory, inputs.own, self._safety, (u_x, u_y)
        )
        return found

    def row(self, inputs: UavInputs, dt: float, never: float) -> FloatArray:
        """Return the team entries of the UAV's observation row, see `write_team_row`."""
        found = np.zeros(entries(len(self._mates)))
        _write_row(self._parameters, self._memory, inputs.own, inputs.tick, dt, never, found)
        return found

    def forget_commands(self) -> None:
        """Return to the stored number at the next tick: a greater one may not have been sent."""
        self._memory.own[0]["unsent"] = True

    def accept(self, decision: FilterDecision | None) -> None:
        """Begin to guard if the safety filter has certified this tick."""
        certified = decision is not None and decision.certified
        role_accepts(self._parameters, self._memory, certified)

    def message(self, inputs: UavInputs, coverage: FloatArray) -> TeamMessage | None:
        """Return the message of this tick to the team-mates; None: none is due.

        Args:
            inputs: State of the tick.
            coverage: Its own map. Shape (rows, columns).
        """
        given = self._parameters, self._memory, coverage, self._desired
        if not _write(*given, inputs.own, inputs.tick, self._message):
            return None
        return to_bus(self._message, self._mates, self._area)
