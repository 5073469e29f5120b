"""A UGV driver of plain pythonfmu3: proportional control towards the goal.

`python -m pythonfmu3 build -f fmi_wheel.py` makes the unit `Wheel.fmu`. It imports nothing of Outrider.
"""

from functools import partial
from typing import Any

from pythonfmu3 import Boolean, Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability


class Wheel(Fmi3Slave):
    """A unit with position, velocity and goal as inputs, and acceleration as output."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.values: dict[str, float] = {"time": 0.0}
        clock = {
            "causality": Fmi3Causality.independent,
            "variability": Fmi3Variability.continuous,
        }
        self.register_variable(Float64("time", getter=lambda: self.values["time"], **clock))
        for what in ("position", "velocity", "goal"):
            for axis in "xy":
                self.add(Float64, f"{what}.{axis}", Fmi3Causality.input)
        self.add(Boolean, "underway", Fmi3Causality.input)
        for axis in "xy":
            self.add(Float64, f"acceleration.{axis}", Fmi3Causality.output)

    def add(self, kind: Any, name: str, causality: Fmi3Causality) -> None:
        """Register a variable."""
        self.values[name] = 0.0
        get, put = partial(self.values.__getitem__, name), partial(self.values.__setitem__, name)
        variable = kind(name, causality=causality, getter=get, setter=put)
        self.register_variable(variable, nested=False)

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance by one step."""
        values = self.values
        values["time"] = current_time + step_size
        for axis in "xy":
            off = values[f"goal.{axis}"] - values[f"position.{axis}"] if values["underway"] else 0.0
            wanted = max(-0.14, min(0.14, 0.5 * off))
            values[f"acceleration.{axis}"] = max(
                -0.07, min(0.07, wanted - values[f"velocity.{axis}"])
            )
        return True
