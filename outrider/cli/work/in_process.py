"""Flight of `outrider run --in-process`."""

import time
from pathlib import Path

from outrider.cli.console import FlightProgress, flight_progress, print_warnings
from outrider.cli.stopping import Stop
from outrider.running.assumptions import assumption_warnings
from outrider.running.flying import fly
from outrider.running.launch import Outcome
from outrider.running.parent import Output
from outrider.running.warming import warm_up_flight
from outrider.view.output import write_flight
from sim.scenario.types import Scenario
from sim.server.flight import Flight


def fly_here(flown: Scenario, secret: str, output: Output, stop: Stop) -> Outcome:
    """Fly a scenario in this process, record it and write its files; a failed file is the outcome's fault."""
    record = Path(output.record) if output.record else None
    print_warnings(assumption_warnings(flown))
    shown = 0.0
    recorder = None
    if record is not None:
        from outrider.recording.writer import FlightRecorder  # noqa: PLC0415 - the extra [record]

        recorder = FlightRecorder(record, flown, flown.seed, secret=secret)

    def follow(flight: Flight, progress: FlightProgress) -> None:
        nonlocal shown
        if recorder is not None:
            recorder.tick(flight)
        if stop:
            flight.stop()
        now = time.monotonic()
        if now - shown > 0.1 or flight.over:
            shown = now
            progress.show(flight.world.tick)

    with flight_progress(flown, "compiling") as progress:
        warm_up_flight(flown)
        flight, summary = fly(
            flown, flown.seed, secret=secret, on_tick=lambda flight: follow(flight, progress)
        )
    outcome = Outcome(summary=summary)
    if recorder is not None and record is not None:
        try:
            recorder.close()
            outcome.files.append(record)
        except OSError as error:
            outcome.fault = f"{error.filename or record}: {error.strerror or error}"
    if output.folder:
        folder = Path(output.folder)
        try:
            outcome.files += write_flight(flight, summary, folder, picture=output.picture)
        except OSError as error:
            outcome.fault = f"{error.filename or folder}: {error.strerror or error}"
    return outcome
