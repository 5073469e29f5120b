"""An observer that records a run whose messages are put into its inboxes by hand, for the tests of recordings."""

from types import SimpleNamespace
from typing import Any

from bus.keys import COVERAGE, GROUND, STATUS, TRUTH
from bus.messages import Status
from outrider.recording.observer import RunRecorder
from sim.scenario.types import Scenario
from sim.server.flight import Flight


class _Box:
    """An inbox whose messages are there already."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def next_waiting(self) -> Any:
        return SimpleNamespace(message=self.messages.pop(0)) if self.messages else None

    def receive(self, _patience: float) -> Any:
        return self.next_waiting()


class Observer:
    """Its recorder, which writes into this file."""

    def __init__(self, file: Any, scenario: Scenario | None) -> None:
        boxes = self._boxes = {key: _Box() for key in (TRUTH, COVERAGE, GROUND, STATUS)}
        session: Any = SimpleNamespace(inbox=lambda key, newest: boxes[key])
        self.recorder = RunRecorder(session, file, scenario)

    def take(self, flight: Flight, **told: Any) -> None:
        """Be told how the flight is, in a status with these fields."""
        fields = {"scenario": flight.scenario.name, "seed": flight.seed, "tick": 0, "ticks": 1}
        fields |= {"time": 0.0, "realtime_factor": 1.0, "vehicles": {}}
        self._boxes[TRUTH].messages.append(flight.truth())
        self._boxes[STATUS].messages.append(Status(**fields | told))
        self.recorder.take(0.0)
