"""Recordings for the tests: of a run in this process, and of messages that a test provides."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from bus.keys import COVERAGE, GROUND, STATUS, TRUTH
from outrider.recording.observer import RunRecorder
from outrider.recording.writer import FlightRecorder
from outrider.running.flying import InProcess, make_pilots
from sim.scenario.types import Scenario
from sim.server.flight import Exchange, Flight
from statuses import Box, a_status


def recorded(
    path: Path,
    scenario: Scenario,
    seed: int | None = None,
    *,
    secret: str = "",
    exchange: Exchange | None = None,
) -> Flight:
    """Record a run; by default with the pilots and the scenario's seed."""
    seed = scenario.seed if seed is None else seed
    recorder = FlightRecorder(path, scenario, seed, secret=secret)
    flight = Flight(scenario, seed, secret=secret)
    exchange = exchange or InProcess(make_pilots(scenario, seed, secret=secret))
    flight.fly(exchange, on_tick=lambda: recorder.tick(flight))
    recorder.close()
    return flight


class Observer:
    """A recorder of an observer that writes the messages of its inboxes into this file."""

    def __init__(self, file: Any, scenario: Scenario | None) -> None:
        boxes = self._boxes = {key: Box() for key in (TRUTH, COVERAGE, GROUND, STATUS)}
        session: Any = SimpleNamespace(inbox=lambda key, newest: boxes[key])
        self.recorder = RunRecorder(session, file, scenario)

    def receive(self, flight: Flight, **fields: Any) -> None:
        """Receive a status with these fields, and the truth of the run."""
        of_the_flight = {"scenario": flight.scenario.name, "seed": flight.seed}
        self._boxes[TRUTH].messages.append(flight.truth())
        self._boxes[STATUS].messages.append(a_status(**of_the_flight | fields))
        self.recorder.record(0.0)
