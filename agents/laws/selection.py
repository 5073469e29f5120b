"""Selection of the law that a pilot flies: row, parameters and memory."""

from typing import Any

from agents.control.visibility import switching_radius
from agents.laws.dispatch import FlownLaw, flown_law
from agents.uav_parameters import UavParameters
from bus.errors import ScenarioError
from bus.messages.scenario import Law
from bus.messages.vehicle import UavBriefing
from bus.registry import LAWS
from sim.models.randomness import words_of


class SelectedLaw:
    """Law of one UAV, with its memory.

    Args:
        briefing: Briefing of the UAV.
        law: Name and parameters of the law.
        uav: Constants of the UAV.
        before: Previous law; memory fields that both have are kept.

    Raises:
        ScenarioError: If the law is unknown, its parameters are not allowed, or the UAV is too weak for r_s.
    """

    def __init__(
        self,
        briefing: UavBriefing,
        law: Law,
        uav: UavParameters,
        before: "SelectedLaw | None" = None,
    ) -> None:
        if law.name not in LAWS:
            raise ScenarioError(f"law.name = {law.name!r}: unknown; allowed: {', '.join(LAWS)}")
        self.row = LAWS[law.name]
        """Row of the law in the registry."""
        if self.row.needs_radius:
            r_v, v_g = briefing.visibility_radius, uav.target_max_speed
            switching_radius(r_v, uav.max_speed, v_g, uav.max_acceleration)
        self.flown: FlownLaw | None = None if before is None else before.flown
        """Law in the form of `agents.uav_tick`; the previous one if the user's policy flies instead."""
        if not self.row.module:
            return
        kept, self.flown = self.memory, flown_law(law)
        memory = self.memory
        if "key_0" in memory.dtype.names:
            memory["key_0"], memory["key_1"] = words_of(briefing.key)
        if kept is not None:
            for name in set(kept.dtype.names) & set(memory.dtype.names):
                memory[name] = kept[name]

    @property
    def memory(self) -> Any:  # noqa: ANN401 - the law's own record
        """Memory record of the law; None before the first law with a memory."""
        if self.flown is None:
            return None
        (name,) = self.flown.memory.dtype.names or ()
        return self.flown.memory[0][name]
