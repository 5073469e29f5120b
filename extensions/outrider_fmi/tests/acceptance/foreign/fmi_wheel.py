"""A UGV's driver as somebody writes one with plain pythonfmu3: to its goal by proportional control.

`python -m pythonfmu3 build -f fmi_wheel.py` makes the unit `Wheel.fmu`. It imports nothing of Outrider.
"""

from functools import partial
from typing import Any

from pythonfmu3 import Boolean, Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability


class Wheel(Fmi3Slave):
    """Position, velocity and goal in; acceleration out."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.told: dict[str, float] = {"time": 0.0}
        clock = {
            "causality": Fmi3Causality.independent,
            "variability": Fmi3Variability.continuous,
        }
        self.register_variable(Float64("time", getter=lambda: self.told["time"], **clock))
        for what in ("position", "velocity", "goal"):
            for axis in "xy":
                self.add(Float64, f"{what}.{axis}", Fmi3Causality.input)
        self.add(Boolean, "underway", Fmi3Causality.input)
        for axis in "xy":
            self.add(Float64, f"acceleration.{axis}", Fmi3Causality.output)

    def add(self, kind: Any, name: str, causality: Fmi3Causality) -> None:
        """Register a variable."""
        self.told[name] = 0.0
        get, put = partial(self.told.__getitem__, name), partial(self.told.__setitem__, name)
        variable = kind(name, causality=causality, getter=get, setter=put)
        self.register_variable(variable, nested=False)

    def do_step(self, current_time: float, step_size: float) -> bool:
        """One step."""
        told = self.told
        told["time"] = current_time + step_size
        for axis in "xy":
            off = told[f"goal.{axis}"] - told[f"position.{axis}"] if told["underway"] else 0.0
            wanted = max(-0.14, min(0.14, 0.5 * off))
            told[f"acceleration.{axis}"] = max(-0.07, min(0.07, wanted - told[f"velocity.{axis}"]))
        return True
