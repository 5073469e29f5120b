"""Starts and goals of UGVs."""

from collections.abc import Iterator

from bus.messages.base import Vector
from bus.registry import DRIVERS
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Ugv


def stops(ugv: Ugv) -> tuple[Vector, ...]:
    """Return the start of a UGV, and its goals if its driver uses them [m]."""
    driver = DRIVERS[ugv.driver]
    roams = driver.provided and driver.wants != "goals"
    return (ugv.position, *(() if roams else ugv.goals))


def all_stops(scenario: Scenario) -> Iterator[tuple[str, Vector]]:
    """Yield all starts and goals of UGVs with their paths, in the order of the tables."""
    for k, ugv in enumerate(scenario.ugv):
        for n, point in enumerate(stops(ugv)):
            yield f"ugv.{k}.goals.{n - 1}" if n else f"ugv.{k}.position", point
