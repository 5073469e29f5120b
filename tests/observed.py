"""Recordings for the tests: of a flight in this process, and of a run whose messages are put in by hand."""

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
    """Such a flight; of the pilots, and with the scenario's own seed, unless there are others."""
    seed = scenario.seed if seed is None else seed
    recorder = FlightRecorder(path, scenario, seed, secret=secret)
    flight = Flight(scenario, seed, secret=secret)
    exchange = exchange or InProcess(make_pilots(scenario, seed, secret=secret))
    flight.fly(exchange, on_tick=lambda: recorder.tick(flight))
    recorder.close()
    return flight


class Observer:
    """An observer's recorder, which writes into this file what is put into its inboxes."""

    def __init__(self, file: Any, scenario: Scenario | None) -> None:
        boxes = self._boxes = {key: Box() for key in (TRUTH, COVERAGE, GROUND, STATUS)}
        session: Any = SimpleNamespace(inbox=lambda key, newest: boxes[key])
        self.recorder = RunRecorder(session, file, scenario)

    def take(self, flight: Flight, **told: Any) -> None:
        """Be told how the flight is, in a status with these fields."""
        of_the_flight = {"scenario": flight.scenario.name, "seed": flight.seed}
        self._boxes[TRUTH].messages.append(flight.truth())
        self._boxes[STATUS].messages.append(a_status(**of_the_flight | told))
        self.recorder.record(0.0)
