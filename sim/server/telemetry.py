"""Telemetry of a run, for observers.

Truth, maps and status are sent only while observers subscribe. They never delay a tick, and none of their errors ends
the run: an observer changes nothing.
"""

import time
from collections import Counter
from collections.abc import Callable

import msgspec

from bus.keys import COVERAGE, GROUND, SAMPLED_TRUTH, STATUS, TRUTH, Key
from bus.messages.base import Message, fitted_lines
from bus.messages.ground import GroundMap
from bus.messages.telemetry import Status
from bus.session import Session
from sim.input.faults import one_line
from sim.scenario.types import LinkTable, Scenario
from sim.scene.ground_map import ground_map, hazards_of
from sim.scene.known import geometry_of
from sim.server.flight import Flight
from sim.server.operator_controls import OperatorControls
from sim.server.sessions import Sessions

_PERIOD = 0.2
"""Wall time between two status messages, and between two coverage maps [s]."""
_GROUND_PERIOD = 0.5
"""Wall time between two ground maps with hazards [s]."""
_TRUTH_PERIOD = 0.025
"""Wall time between two samples of the truth [s]: twice the drawing rate of pages."""


_SHOWN = 20
"""Number of changes in a status."""


Warn = Callable[[Scenario, LinkTable], tuple[str, ...]]
"""Function that returns one line for each assumption of the certificate that the present links violate."""


class Telemetry:
    """Sender of telemetry that has subscribers.

    Args:
        session: The simulator's session.
        flight: The run.
        sessions: The vehicles' sessions.
        operators: Operator controls, for the pace and their changes.
        warn: Returns one line for each assumption of the certificate that the present links violate.
        on_event: Called with one line for the user.
    """

    def __init__(
        self,
        session: Session,
        flight: Flight,
        sessions: Sessions,
        operators: OperatorControls,
        warn: Warn,
        on_event: Callable[[str], None],
    ) -> None:
        self._warn, self._on_event = warn, on_event
        self.faults: Counter[str] = Counter()
        """Messages that could not be made or sent, by topic."""
        self._flight, self._sessions, self._operators = flight, sessions, operators
        self._geometry = geometry_of(flight.scenario, flight.world.buildings)
        keys = (TRUTH, SAMPLED_TRUTH, COVERAGE, STATUS, GROUND)
        self._outboxes = {key.topic: session.outbox(key) for key in keys}
        self._hazards = hazards_of(flight.world)
        self._due = self._truth_due = self._ground_due = 0.0
        self._last = (0.0, 0)

    def fly(self, flight: Flight) -> None:
        """Switch to another run."""
        self._flight, self._last = flight, (0.0, 0)
        self._hazards = hazards_of(flight.world)
        self._geometry = geometry_of(flight.scenario, flight.world.buildings)

    def send_tick(self) -> None:
        """Send the truth of this tick, and other telemetry that is due."""
        self._send(TRUTH, self._flight.truth)
        self.refresh()

    def refresh(self, *, at_once: bool = False) -> None:
        """Send the sampled truth, status and maps, each a few times per second.

        Args:
            at_once: Send them even if they are not due.
        """
        now = time.monotonic()
        if now >= self._truth_due or at_once:
            self._truth_due = now + _TRUTH_PERIOD
            self._send(SAMPLED_TRUTH, self._flight.truth)
        if now < self._due and not at_once:
            return
        self._due = now + _PERIOD
        self._sessions.follow()
        self._send(STATUS, lambda: self.status(now))
        self._send(COVERAGE, self._flight.world.coverage_map)
        if now >= self._ground_due or at_once:
            self._ground_due = now + _GROUND_PERIOD - 0.5 * _PERIOD
            self._send(GROUND, self._ground_map)

    def _ground_map(self) -> GroundMap | None:
        return ground_map(self._flight.world, self._hazards, self._flight.routes)

    def _send(self, key: Key, make: Callable[[], Message | None]) -> None:
        """Make and send a message if it has readers; count a failure, and report the first of its topic."""
        outbox = self._outboxes[key.topic]
        if not outbox.wanted:
            return
        self._flight.take_down()  # part of the flight: its errors are not the message's
        try:
            message = make()
            if message is not None:
                outbox.send(message)
        except Exception as error:  # noqa: BLE001 - whatever it is, an observer must change nothing
            self.faults[key.topic] += 1
            if self.faults[key.topic] == 1:
                self._on_event(
                    f"observers miss the {key.topic} of tick {self._flight.world.tick}: "
                    f"{one_line(str(error)) or type(error).__name__}; further ones are only counted"
                )

    def status(self, now: float) -> Status:
        """Return the status of the run at `now` on the monotonic clock [s]."""
        flight, world = self._flight, self._flight.world
        before, tick = self._last
        self._last = (now, world.tick)
        elapsed = now - before
        status = flight.status()
        return msgspec.structs.replace(
            status,
            realtime_factor=(world.tick - tick) * flight.scenario.dt / elapsed
            if before and elapsed > 0.0
            else 0.0,
            target_factor=self._operators.pace.factor,
            late_ticks=self._operators.late_ticks,
            paused=self._operators.paused,
            operators=dict(self._operators.operators),
            changes=tuple(self._operators.changes)[-_SHOWN:],
            rejections=tuple(self._operators.rejections),
            geometry=self._geometry,
            warnings=fitted_lines((*status.warnings, *self._warn(flight.flown, world.link_table))),
            vehicles=self._sessions.statuses(),
        )
