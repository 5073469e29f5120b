"""Telemetry of a run, for observers.

Truth, maps and status are sent only while observers subscribe, and never delay a tick.
"""

import time
from collections.abc import Callable

import msgspec

from bus.keys import COVERAGE, GROUND, SAMPLED_TRUTH, STATUS, TRUTH
from bus.messages.telemetry import Status
from bus.session import Session
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
    """

    def __init__(
        self,
        session: Session,
        flight: Flight,
        sessions: Sessions,
        operators: OperatorControls,
        warn: Warn,
    ) -> None:
        self._warn = warn
        self._flight, self._sessions, self._operators = flight, sessions, operators
        self._geometry = geometry_of(flight.scenario, flight.world.buildings)
        self._truth, self._sampled = session.outbox(TRUTH), session.outbox(SAMPLED_TRUTH)
        self._map, self._status = session.outbox(COVERAGE), session.outbox(STATUS)
        self._ground = session.outbox(GROUND)
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
        if self._truth.wanted:
            self._truth.send(self._flight.truth())
        self.refresh()

    def refresh(self, *, at_once: bool = False) -> None:
        """Send the sampled truth, status and maps, each a few times per second.

        Args:
            at_once: Send them even if they are not due.
        """
        now = time.monotonic()
        if now >= self._truth_due or at_once:
            self._truth_due = now + _TRUTH_PERIOD
            if self._sampled.wanted:
                self._sampled.send(self._flight.truth())
        if now < self._due and not at_once:
            return
        self._due = now + _PERIOD
        self._sessions.follow()
        if self._status.wanted:
            self._status.send(self.status(now))
        if self._map.wanted:
            self._map.send(self._flight.world.coverage_map())
        if self._ground.wanted and (now >= self._ground_due or at_once):
            self._ground_due = now + _GROUND_PERIOD - 0.5 * _PERIOD
            ground = ground_map(self._flight.world, self._hazards, self._flight.routes)
            if ground is not None:
                self._ground.send(ground)

    def status(self, now: float) -> Status:
        """Return the status of the run at `now` on the monotonic clock [s]."""
        flight, world = self._flight, self._flight.world
        before, tick = self._last
        self._last = (now, world.tick)
        elapsed = now - before
        return msgspec.structs.replace(
            flight.status(),
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
            warnings=self._warn(flight.flown, world.link_table),
            vehicles=self._sessions.statuses(),
        )
