"""Lockstep and a dying router: Zenoh may report the loss of the vehicles before that of their router."""

import time
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from bus.messages.vehicle import UgvObservation
from sim.scenario.types import Run
from sim.server.pace import Lockstep

NAMES = ("uav_0", "ugv_0")
SEEN = {
    name: UgvObservation(tick=0, time=0.0, position=(1.0, 1.0), velocity=(0.0, 0.0))
    for name in NAMES
}


class Bus:
    """A session and slots that follow a timetable.

    Each row holds the time until which it is valid [s], the present routers, and the absent vehicles.
    """

    def __init__(self, *timetable: tuple[float, set[str], set[str]]) -> None:
        self.timetable = timetable
        self.started = time.monotonic()
        self._briefed = set(NAMES)
        self.commands = self
        self.silent: set[str] = set()
        self.sent: list[str] = []
        self._requested: list[str] = []

    def _now(self) -> tuple[float, set[str], set[str]]:
        elapsed = time.monotonic() - self.started
        row = next((row for row in self.timetable if elapsed < row[0]), self.timetable[-1])
        self._briefed -= row[2]
        return row

    @property
    def routers(self) -> frozenset[str]:
        return frozenset(self._now()[1])

    @property
    def absent(self) -> list[str]:
        return sorted(self._now()[2])

    @property
    def unbriefed(self) -> list[str]:
        return sorted(set(NAMES) - self._now()[2] - self._briefed)

    def follow(self) -> None:
        self._now()

    def send(self, observations: Mapping[str, Any]) -> set[str]:
        given = set(observations) - self._now()[2]
        self._briefed |= given
        self._requested += sorted(given - self.silent)
        self.sent += sorted(given)
        return given

    def receive(self, patience: float) -> Any:
        self._requested = [name for name in self._requested if name not in self._now()[2]]
        if self._requested:
            return SimpleNamespace(sender=self._requested.pop(0))
        time.sleep(min(patience, 0.01))
        return None

    def accept(self, envelope, _tick, commands, *, oldest=None):
        commands[envelope.sender] = envelope
        return True


def lockstep(bus: Any, on_event: Callable[[str], None], *, patience: float = 5.0) -> Lockstep:
    return Lockstep(bus, bus, Run(deadline=2.0, join_timeout=patience), on_event)


BOTH = set(NAMES)
BEGIN, END = [(0.05, {"r"}, set()), (0.15, {"r"}, BOTH), (0.5, set(), BOTH)], (9.0, {"s"}, set())
UAV_LATER = (0.8, {"s"}, {"uav_0"})
TIMETABLES = {
    "tokens first": (BOTH, [*BEGIN, (0.8, {"s"}, BOTH), END]),
    "one comes back late": (BOTH, [*BEGIN, UAV_LATER, END]),
    "too fast to be noticed": (BOTH, [(0.2, {"r"}, set()), (0.6, {"s"}, BOTH), END]),
    "the UAV answers before": (
        {"ugv_0"},
        [(0.3, {"r"}, set()), (0.5, set(), BOTH), UAV_LATER, END],
    ),
    "between ticks": (set(), [(0.1, {"r"}, set()), (0.2, {"r"}, BOTH), (0.5, set(), BOTH), END]),
}
"""Vehicles whose request is lost with the router, and the timetable of the bus."""


@pytest.mark.parametrize(("silent", "timetable"), TIMETABLES.values(), ids=TIMETABLES)
def test_vehicles_lost_with_their_router_are_awaited(silent: set[str], timetable: Any) -> None:
    events: list[str] = []
    bus = Bus(*timetable)
    bus.silent = silent
    pace = lockstep(bus, events.append)
    pace.publish(SEEN)
    bus.silent = set()
    for tick in range(2):
        assert set(pace.collect(tick, lambda: False)) == BOTH
        time.sleep(0.12)
        pace.publish(SEEN)
    assert events[-1] == "router reconnected"


@pytest.mark.parametrize(("tick", "least", "most"), [(0, 1.9, 4.0), (1, 0.0, 1.5)])
def test_dead_vehicle_is_awaited_in_the_first_tick_alone(
    tick: int, least: float, most: float
) -> None:
    events: list[str] = []
    bus = Bus((9.0, {"r"}, {"uav_0"}))
    pace = lockstep(bus, events.append)
    bus.timetable = ((0.1, {"r"}, set()), (9.0, {"r"}, {"uav_0"}))
    bus.silent = {"uav_0"}
    pace.publish(SEEN)
    started = time.monotonic()
    assert set(pace.collect(tick, lambda: False)) == {"ugv_0"}
    assert least < time.monotonic() - started < most
    assert events == []
