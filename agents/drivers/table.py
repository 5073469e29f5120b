"""The drivers by name: a new one is one file and one row."""

from collections.abc import Callable
from typing import Protocol

from agents.drivers.compiled import EvadeDriver, ScriptDriver, WanderDriver, WaypointDriver
from agents.drivers.teleop import TeleopDriver
from bus.messages import UgvBriefing, UgvObservation


class Driver(Protocol):
    """Who sits in the UGV: an observation in, an acceleration [m/s²] out."""

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation."""


DRIVERS: dict[str, Callable[[UgvBriefing], Driver]] = {
    "waypoints": WaypointDriver,
    "wander": WanderDriver,
    "script": ScriptDriver,
    "evade": EvadeDriver,
    "teleop": TeleopDriver,
}
