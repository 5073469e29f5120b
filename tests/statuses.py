"""Messages of a run to observers, for the tests of views."""

from types import SimpleNamespace
from typing import Any

from bus.messages.telemetry import EscortTruth, Status, Truth, VehicleStatus, VehicleTruth
from bus.messages.vehicle import UavReport

PRESENT = {name: VehicleStatus(present=True) for name in ("uav_0", "ugv_0")}
"""Both vehicles of an escort, for a status."""


def a_status(**fields: Any) -> Status:
    """Return a status with these fields and defaults."""
    least = {"scenario": "escort", "seed": 1, "tick": 1, "ticks": 100, "time": 0.05}
    return Status(**least | {"realtime_factor": 1.0, "vehicles": {}} | fields)


def a_vehicle(
    position: Any = (0.0, 0.0), velocity: Any = (0.0, 0.0), **fields: Any
) -> VehicleTruth:
    """Return the truth of a vehicle, without a command by default."""
    still = {"acceleration": (0.0, 0.0), "command": (0.0, 0.0)}
    return VehicleTruth(position=position, velocity=velocity, **still | fields)


def a_truth(time: float, uav: VehicleTruth, ugv: VehicleTruth, **fields: Any) -> Truth:
    """Return the truth of an escort with these fields at this time."""
    least = {"distance": 1.0, "coverage_error": 1.0, "detection": None, "report": None}
    escort = EscortTruth(uav="uav_0", ugv="ugv_0", **least | fields)
    vehicles = {"uav_0": uav, "ugv_0": ugv}
    return Truth(tick=round(20 * time), time=time, vehicles=vehicles, escorts=(escort,))


class Box:
    """An inbox with given messages."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def next_waiting(self) -> Any:
        return SimpleNamespace(message=self.messages.pop(0)) if self.messages else None

    def receive(self, _patience: float) -> Any:
        return self.next_waiting()


def truth_at(tick: int = 40) -> Truth:
    """Return the truth of an escort whose UAV reports an estimate."""
    uav, ugv = (a_vehicle(position, (0.25, -0.5)) for position in ((3.0, 4.5), (5.0, 4.0)))
    report = UavReport(estimate=(6.0, 7.0), covariance=(0.04, 0.01, 0.09), age=0.0, rejected=0)
    return a_truth(tick * 0.05, uav, ugv, detection=(-2.125, 0.5), report=report)
