"""Recording of a flight from inside the simulator: the flight queues messages, and a thread encodes and writes them."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from bus.messages.base import fitted_lines
from bus.messages.control import Action, Change, Control
from bus.messages.ground import GroundMap, Hazard
from bus.messages.telemetry import CoverageMap, Status, Truth, VehicleStatus
from bus.messages.vehicle import Teleoperation
from outrider.recording.mcap_file import RecordingFile
from outrider.recording.schemas import (
    CHANGES,
    COMMANDS,
    COVERAGE,
    GROUND,
    STATUS,
    TRUTH,
    commands_of,
    head_of,
)
from outrider.running.assumptions import assumption_warnings
from sim.compiling.compile import FloatArray
from sim.scenario.types import Scenario
from sim.scene.ground_map import ground_map
from sim.server.flight import Flight
from sim.server.perception import News

_WAKE = 0.02
"""Wall time between two checks of the queue by the thread [s]."""
_BLOCK = 64
"""Items that the thread writes before it releases the interpreter for the flight's thread."""
_ROOM = 1024
"""Number of queued items beyond which the flight waits for the thread."""
_MAP_PERIOD = 1.0
"""Simulated time between two maps [s], for a grid of up to `_MAP_CELLS`; larger maps are written less often."""
_MAP_CELLS = 50_000
_STATUS_PERIOD = 0.5
"""Shortest simulated time between two status messages [s]; the shortest wall time is a tenth of it."""


class _Received(NamedTuple):
    """Operator's command received by a UGV."""

    ugv: str
    command: Teleoperation


_Content = Truth | _Received | Change | CoverageMap | GroundMap | Status | str
"""Content of a recording; a text is a log line."""


def _news_in(received: Mapping[str, News], tick: int) -> Iterator[_Received | Change]:
    """Yield the operators' commands and changes at a tick."""
    laws = []
    for name, news in received.items():
        for command in news.operator:
            yield _Received(name, command)
        if news.driver is not None:
            yield Change(
                tick=tick, control=Control(action=Action.DRIVER, vehicle=name, driver=news.driver)
            )
        if news.request is not None:
            yield Change(
                tick=tick,
                control=Control(action=Action.REQUEST, vehicle=name, request=news.request),
            )
        if news.law is not None and news.law not in laws:  # one change applies to all UAVs
            laws.append(news.law)
            yield Change(tick=tick, control=Control(action=Action.LAW, law=news.law))


class FlightRecorder:
    """Recorder of all ticks inside the simulator's process, exact to the last bit.

    Args:
        path: File to write; an existing file is replaced.
        scenario: Scenario that is flown.
        seed: Seed of all random numbers.
        secret: Secret of the run; a file with a secret is readable by its owner only.

    Raises:
        OSError: If the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        scenario: Scenario,
        seed: int,
        *,
        secret: str = "",
    ) -> None:
        self.vehicles: Callable[[], Mapping[str, VehicleStatus]] = dict
        """Callback that returns the status of the vehicles' processes, in addition to the flight's own counts."""
        self._file = RecordingFile(path, private=bool(secret))
        self._items: deque[tuple[Flight, int, _Content]] = deque()  # each with its tick
        self._done = threading.Event()
        self._fault: Exception | None = None
        # The current flight of the flight's thread; `_written` is the writer's.
        self._flight: Flight | None = None
        self._degradations = 0  # number of the flight's changes of links that are queued
        self._written: Flight | None = None
        self._early: list[str] = []
        self._scratch: FloatArray = np.empty((0, 0))
        self._file.begin(head_of(scenario, seed, secret=secret), scenario)
        self._head = (scenario, seed, secret, 0)
        self._thread = threading.Thread(target=self._run, name="outrider-recorder", daemon=True)
        self._thread.start()

    def tick(self, flight: Flight) -> None:
        """Record the tick that was just flown; called after each tick from the flight's thread.

        Nothing is dropped: if the disk stays slower than the flight, the call waits. After a write error, the call does
        nothing, and `close` raises the error.

        Args:
            flight: Current flight; a different flight starts a new flight in the file.
        """
        if self._fault is not None:
            return
        tick, items = flight.world.tick, self._items
        if flight is not self._flight:
            self._start(flight)
        received = flight.news(tick - 1)
        if received:
            items.extend((flight, tick, what) for what in _news_in(received, tick - 1))
        if len(flight.degradations) > self._degradations:
            new = flight.degradations[self._degradations :]
            items.extend((flight, tick, change) for change in new)
            self._degradations = len(flight.degradations)
        items.append((flight, tick, flight.truth()))
        while self._early:
            self.event(self._early.pop(0))
        if tick >= self._next_map or tick >= self._next_status or flight.over:
            self._queue_overview(flight, tick)
        while len(items) > _ROOM and self._fault is None:
            time.sleep(0.001)

    def _start(self, flight: Flight) -> None:
        self._flight, self._next_map, self._next_status = flight, 0, 0
        self._hazards: tuple[Hazard, ...] | None = None
        self._degradations = 0
        self._pace = (time.monotonic(), 0)

    def _queue_overview(self, flight: Flight, tick: int) -> None:
        """Queue maps and status if they are due."""
        if tick >= self._next_map or flight.over:
            cells = flight.world.coverage.size
            self._next_map = tick + max(
                1, round(max(_MAP_PERIOD, _MAP_PERIOD * cells / _MAP_CELLS) / flight.scenario.dt)
            )
            if self._scratch.shape != flight.world.coverage.shape:
                self._scratch = np.empty_like(flight.world.coverage)
            covered = flight.world.coverage_map(self._scratch)
            self._items.append((flight, tick, covered))
            ground = ground_map(flight.world, self._hazards, flight.routes)
            if ground is not None:
                self._hazards = ground.hazards
                self._items.append((flight, tick, ground))
        if tick >= self._next_status or flight.over:
            self._next_status = tick + max(1, round(_STATUS_PERIOD / flight.scenario.dt))
            if time.monotonic() - self._pace[0] > 0.1 * _STATUS_PERIOD or flight.over:
                self._items.append((flight, tick, self._status(flight)))

    def event(self, line: str) -> None:
        """Record a log line at the current tick."""
        if self._flight is None:
            self._early.append(line)  # vehicles join before the first tick
        else:
            self._items.append((self._flight, self._flight.world.tick, line))

    def _status(self, flight: Flight) -> Status:
        now, (before, tick) = time.monotonic(), self._pace
        self._pace = (now, flight.world.tick)
        status = flight.status()
        return msgspec.structs.replace(
            status,
            realtime_factor=max(0, flight.world.tick - tick)
            * flight.scenario.dt
            / max(now - before, 1e-6),
            warnings=fitted_lines(assumption_warnings(flight.flown, flight.world.link_table)),
            vehicles={**status.vehicles, **self.vehicles()},
        )

    def close(self) -> None:
        """Write the queued items and close the file; called once, after the flight's end or failure.

        Raises:
            OSError: If a write failed.
        """
        flight = self._flight
        if flight is not None and self._fault is None:
            tick, why = flight.world.tick, "complete" if flight.complete else "cut short"
            self._items.append((flight, tick, self._status(flight)))
            self._items.append((flight, tick, f"the flight is over: {why}"))
        self._done.set()
        self._thread.join()
        try:
            self._file.close()
        except (OSError, RuntimeError) as error:
            self._fault = self._fault or error
        if isinstance(self._fault, OSError):
            raise self._fault
        if self._fault is not None:
            raise OSError(f"the recording is incomplete: {self._fault}") from self._fault

    def _run(self) -> None:
        try:
            last = False
            while not last:
                last = self._done.wait(_WAKE)
                while self._items:
                    for _ in range(min(_BLOCK, len(self._items))):
                        self._write(*self._items.popleft())
                    self._file.flush_if_due()
                    time.sleep(2e-5)
                self._file.flush_if_due()
        except Exception as error:  # noqa: BLE001 - the flight continues after any error, and `close` raises it
            self._fault = error
            self._items.clear()

    def _write(self, flight: Flight, tick: int, what: _Content) -> None:
        if flight is not self._written:
            self._begin(flight, tick)
        now, before = tick * flight.scenario.dt, (tick - 1) * flight.scenario.dt
        if isinstance(what, Truth):
            self._file.take(COMMANDS, commands_of(what), before)
            self._file.take(TRUTH, what, now)
        elif isinstance(what, _Received):
            self._file.operator_command(what.ugv, tick - 1, what.command, before)
        elif isinstance(what, Change):
            self._file.take(CHANGES, what, before)
        elif isinstance(what, CoverageMap):
            self._file.take(COVERAGE, what, now)
        elif isinstance(what, GroundMap):
            self._file.take(GROUND, what, now)
        elif isinstance(what, Status):
            self._file.take(STATUS, what, what.time)
        else:
            self._file.log(what, now)

    def _begin(self, flight: Flight, tick: int) -> None:
        self._written = flight
        identity = (flight.scenario, flight.seed, flight.secret, flight.episode)
        if identity != self._head:
            self._head, start = identity, self._file.next_start
            head = head_of(
                flight.scenario,
                flight.seed,
                secret=flight.secret,
                episode=flight.episode,
                start=start,
            )
            self._file.begin(head, flight.scenario)
        if tick == 1:
            # The truth and the ground before the first tick.
            before = Flight(flight.scenario, flight.seed, secret=flight.secret)
            self._file.take(TRUTH, before.truth(), 0.0)
            self._file.take(COVERAGE, before.world.coverage_map(), 0.0)
            ground = ground_map(before.world)
            if ground is not None:
                self._file.take(GROUND, ground, 0.0)
