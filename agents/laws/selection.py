"""Selection of the law that a pilot flies: file, parameters and memory."""

from typing import Any

from agents.control.visibility import switching_radius
from agents.laws.inputs import LawInputs
from agents.uav_parameters import UavParameters
from bus.errors import ScenarioError
from bus.law_parameters import law_parameters
from bus.messages.scenario import Law
from bus.messages.vehicle import UavBriefing
from bus.registry import LAWS, module_of
from sim.compiling.records import fill, fresh, records
from sim.models.randomness import words_of
from sim.models.sensor import SensorParameters


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
        self._memory: Any = None if before is None else before._memory
        if not self.row.module:
            return
        module, kept = module_of(self.row), self._memory
        memory: Any = fresh(module.Memory)
        self._memory = memory
        if "key_0" in memory.dtype.names:
            memory["key_0"], memory["key_1"] = words_of(briefing.key)
        if kept is not None:
            for name in set(kept.dtype.names) & set(memory.dtype.names):
                memory[name] = kept[name]
        own = records(UavParameters, [uav])
        parameters = records(self.row.parameters, [law_parameters(law)])
        # Arrays of one row: a single row becomes read-only when pickled.
        self._command, self._fixed = module.command, (own, parameters, memory)

    @property
    def memory(self) -> Any:  # noqa: ANN401 - the law's own record
        """Memory record of the law; None before the first law with a memory."""
        return None if self._memory is None else self._memory[0]

    def set_sensor(self, sensor: SensorParameters) -> None:
        """Set the sensor of the UAV at its altitude."""
        if self.row.module:
            fill(self._fixed[0][0]["sensor"], sensor)

    def command(self, inputs: LawInputs) -> tuple[float, float]:
        """Return the nominal command [m/s²], before the bound of (1)."""
        uav, parameters, memory = (rows[0] for rows in self._fixed)
        u_x, u_y = self._command(uav, parameters, memory, inputs)
        return u_x, u_y
