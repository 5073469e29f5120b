"""A pilot's part in its team: role, number and messages. The rules are compiled (`agents.team.roles`)."""

import numpy as np

from agents.team.coverage import choose_blocks
from agents.team.records import TeamMemory, message_blocks
from agents.team.roles import accept, control_of_role
from agents.uav_inputs import UavInputs
from bus.messages.base import Vector, or_none
from bus.messages.decision import FilterDecision
from bus.messages.team import MOST_COVERAGE_BLOCKS, Role, TeamMessage
from bus.messages.vehicle import UavBriefing, UavObservation
from bus.ticks import NO_TICK
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray, choice
from sim.models.vehicles import State


@compiled
def _control(
    parameters: RecordArray,
    memory: TeamMemory,
    state: State,
    safety: RecordArray,
    u_x: float,
    u_y: float,
) -> tuple[float, float]:
    return control_of_role(parameters[0], memory, state, safety[0], (u_x, u_y))


@compiled
def _accept(parameters: RecordArray, memory: TeamMemory, certified: bool) -> None:
    accept(parameters[0], memory, certified)


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
        self._name, self._mates = briefing.vehicle, briefing.mates
        self._desired = briefing.desired_coverage
        self._parameters, self._memory, self._safety = parameters, memory, safety
        self._row, self._period = int(parameters[0]["row"]), int(parameters[0]["period"])
        self._blocks = np.zeros(MOST_COVERAGE_BLOCKS, dtype=np.int64)

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
        u_x, u_y = _control(
            self._parameters, self._memory, inputs.own, self._safety, *map(float, acceleration)
        )
        return u_x, u_y

    def forget_commands(self) -> None:
        """Return to the stored number at the next tick: a greater one may not have been sent."""
        self._memory.own[0]["unsent"] = True

    def accept(self, decision: FilterDecision | None) -> None:
        """Begin to guard if the safety filter has certified this tick."""
        certified = decision is not None and decision.certified
        _accept(self._parameters, self._memory, certified)

    def message(self, observation: UavObservation, coverage: FloatArray) -> TeamMessage | None:
        """Return the message of this tick to the team-mates; None: none is due.

        Args:
            observation: Observation of the tick.
            coverage: Its own map. Shape (rows, columns).
        """
        tick = observation.tick
        if len(self._mates) < 2 or (tick + self._row) % self._period:
            return None
        own = self._memory.own[0]
        measured = int(own["own_tick"])
        choose_blocks(self._memory, coverage, self._desired, tick, self._blocks)
        return TeamMessage(
            sender=self._name,
            tick=tick,
            number=self.number,
            role=self.role,
            certified=bool(own["certified"]),
            position=observation.position,
            measured=None if measured == NO_TICK else measured,
            measurement=(float(own["own_x"]), float(own["own_y"])),
            charge=or_none(float(own["charge"])),
            asks=None if own["asks"] < 0 else self._mates[int(own["asks"])],
            blocks=message_blocks(self._memory, self._blocks.tolist()),
        )
