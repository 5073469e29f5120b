"""The telemetry of a run, for observers.

The truth, the map and the status, to whoever listens, and never in the tick's way.
"""

import time
from collections.abc import Callable

import msgspec

from bus.keys import COVERAGE, GROUND, SAMPLED_TRUTH, STATUS, TRUTH
from bus.messages.telemetry import Status
from bus.session import Session
from sim.scenario.types import LinkTable, Scenario
from sim.scene.known import geometry_of
from sim.scene.told_tiles import ground_map, hazards_of
from sim.server.flight import Flight
from sim.server.operator_controls import OperatorControls
from sim.server.sessions import Slots

_PERIOD = 0.2
"""Wall time between two status messages, and between two maps [s]."""
_GROUND_PERIOD = 0.5
"""Wall time between two maps of the ground with its hazards [s]."""
_TRUTH_PERIOD = 0.025
"""Wall time between two ticks of the sampled truth [s]: twice as often as pages draw."""


_SHOWN = 20
"""Changes that a status shows."""


Warn = Callable[[Scenario, LinkTable], tuple[str, ...]]
"""Tells what cannot be promised of a scenario whose links are now these, a line each."""


class Telemetry:
    """Sends what is wanted.

    Args:
        session: The simulator's session.
        flight: What is flown.
        slots: The vehicles' places.
        operators: The operator controls: how time goes on, and what they have changed.
        warn: What cannot be promised of a scenario whose links are now these, a line each.
    """

    def __init__(
        self,
        session: Session,
        flight: Flight,
        slots: Slots,
        operators: OperatorControls,
        warn: Warn,
    ) -> None:
        self._warn = warn
        self._flight, self._slots, self._operators = flight, slots, operators
        self._geometry = geometry_of(flight.scenario)
        self._truth, self._sampled = session.outbox(TRUTH), session.outbox(SAMPLED_TRUTH)
        self._map, self._status = session.outbox(COVERAGE), session.outbox(STATUS)
        self._ground = session.outbox(GROUND)
        self._hazards = hazards_of(flight.world)
        self._due = self._truth_due = self._ground_due = 0.0
        self._last = (0.0, 0)

    def fly(self, flight: Flight) -> None:
        """Another flight begins."""
        self._flight, self._last = flight, (0.0, 0)
        self._hazards = hazards_of(flight.world)

    def tell(self) -> None:
        """Send the truth of this tick, and the rest if it is time."""
        if self._truth.wanted:
            self._truth.send(self._flight.truth())
        self.refresh()

    def refresh(self, *, at_once: bool = False) -> None:
        """Send the downsampled truth, status and map some times a second each.

        Args:
            at_once: Send them whenever the last ones were.
        """
        now = time.monotonic()
        if now >= self._truth_due or at_once:
            self._truth_due = now + _TRUTH_PERIOD
            if self._sampled.wanted:
                self._sampled.send(self._flight.truth())
        if now < self._due and not at_once:
            return
        self._due = now + _PERIOD
        self._slots.follow()
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
        """The status of the run at `now` on the monotonic clock [s]."""
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
            refusals=tuple(self._operators.refusals),
            geometry=self._geometry,
            warnings=self._warn(flight.flown, world.link_table),
            vehicles=self._slots.statuses(),
        )
