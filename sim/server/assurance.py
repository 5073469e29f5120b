"""Tests that the safety filters tell the truth: what each UAV reports, held against what the simulator knows."""

import math
from collections import Counter

from bus.messages.decision import NotCertified
from bus.messages.telemetry import CertificateStatus
from bus.messages.vehicle import UavCommand
from sim.compiling.records import RecordArray, records
from sim.engine.briefing import monitored_bounds
from sim.engine.monitor import (
    certificate_counters,
    record_end,
    record_tick,
    record_tracking_error,
    reset_filter,
)
from sim.models.safety import SafetyBounds
from sim.scenario.types import Scenario, Uav

_NOBODY = -2
"""The last tick that was watched, before the first: the one before tick 0 is -1."""


Evidence = tuple[RecordArray, RecordArray, RecordArray]
"""The truth of a tick, as `record_tick` takes it; arrays that change with the flight."""


class Assurance:
    """Collects the reports of all UAVs' safety filters.

    Args:
        scenario: What is flown.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.reasons: Counter[NotCertified] = Counter()
        """Ticks that were not certified, by reason."""
        self.tracking_error = 0.0
        """The farthest that a UAV was from where it was told that it is [m]."""
        rows = [k for k, one in enumerate(scenario.vehicles) if isinstance(one, Uav)]
        uavs, self._rows = [scenario.vehicles[k].name for k in rows], rows  # as the world's
        self._radius, self._dt = scenario.visibility.radius, scenario.dt
        self._disturbed = scenario.disturbed
        bounds = [monitored_bounds(scenario, uav) for uav in uavs]
        self._interval = max((one.interval_ticks for one in bounds), default=1)
        self._tracking = max((one.max_tracking_error for one in bounds), default=math.inf)
        self._bounds = records(SafetyBounds, bounds)
        self._counts = certificate_counters(len(uavs))
        self._tables = self._bounds, self._counts
        self._last = [_NOBODY] * len(uavs)
        self._silent = [0] * len(uavs)  # ticks of which nothing was said
        self._disregarded = [False] * len(uavs)

    def _sum(self, name: str) -> int:
        return int(self._counts[name].sum())

    @property
    def ticks(self) -> int:
        """Ticks of a UAV that flies a law that a filter watches over."""
        return self._sum("ticks")

    @property
    def certified(self) -> int:
        """Those that were certified."""
        return self._sum("certified")

    @property
    def certified_while_lost(self) -> int:
        """Ticks that were certified although the UGV was out of sight then.

        The certificate is wrong if there is one.
        """
        return self._sum("certified_while_lost")

    @property
    def certificate_broken(self) -> int:
        """Ticks that were not certified although the one before was and all assumptions hold; likewise."""
        return self._sum("broken")

    def track(self, uav: int, off: float) -> None:
        """A UAV truly is so far from where it is told that it is at the tick that is taken next [m]."""
        self.tracking_error = max(self.tracking_error, off)
        record_tracking_error(self._bounds, self._counts, uav, off)

    def excuse(self, uav: int) -> None:
        """This UAV's certificate may end at the coming tick: its law has changed, or its process has joined again."""
        self._counts["certified_before"][uav] = False

    def disregard(self, uav: int) -> None:
        """A program that knows no certificate flies this UAV: what it does not say is no fault of a filter."""
        self._counts["ticks"][uav] -= self._silent[uav]
        self.reasons[NotCertified.NO_REPORT] -= self._silent[uav]
        self.reasons += Counter()  # drops what is zero
        self._silent[uav] = 0
        self._disregarded[uav] = True

    def take(
        self,
        uav: int,
        tick: int,
        command: UavCommand | None,
        evidence: Evidence,
        distance: float,
        *,
        watched: bool = True,
    ) -> None:
        """Count a tick of a UAV that a safety filter watches over: by the law, or around whatever flies it.

        Args:
            uav: Row of the UAV.
            tick: Which.
            command: Its new command, with what it says; with a clock that waits for nobody it may be of an earlier
                tick. None: it has none.
            evidence: What is true of this tick.
            distance: The true one at the tick that is reported of [m].
            watched: Whether a filter watches over its law.
        """
        report = None if command is None else command.report
        decision = None if report is None else report.decision
        if decision is None and (not watched or self._disregarded[uav]):
            self.excuse(uav)  # nothing vouches for this tick
            return
        if self._last[uav] != tick - 1:  # not watched just before: a new filter, without a memory
            reset_filter(self._counts[uav])
        self._last[uav] = tick
        certified = overridden = current = False
        reason: NotCertified | None = NotCertified.NO_REPORT
        if decision is None:
            self._silent[uav] += 1
        else:
            certified, overridden = decision.certified, decision.overridden
            reason, current = decision.reason, command is not None and command.tick == tick
        if reason is not None:
            self.reasons[reason] += 1
        claim = certified, overridden, distance >= self._radius, current
        place = uav, self._rows[uav], tick
        record_tick(self._tables, evidence, place, command is not None, claim)

    def end(self, uav: int, distance: float) -> None:
        """The flight is over with this UAV so far from its UGV [m]: the last tick's certificate is held against it."""
        record_end(self._counts[uav], distance >= self._radius)

    def shares(self, uav: int) -> tuple[float | None, float | None]:
        """Return the shares of a UAV's watched ticks that were certified, and in which its filter acted."""
        count = self._counts[uav]
        ticks = int(count["ticks"])
        if not ticks:
            return None, None
        return int(count["certified"]) / ticks, int(count["overridden"]) / ticks

    def status(self) -> CertificateStatus | None:
        """All of it as a message; None where no filter has watched over anything."""
        if not self.ticks:
            return None
        longest = int(self._counts["longest_interval"].max())
        return CertificateStatus(
            ticks=self.ticks,
            certified=self.certified,
            overridden=self._sum("overridden"),
            uncertified=dict(self.reasons),
            certified_while_lost=self.certified_while_lost,
            certificate_broken=self.certificate_broken,
            max_command_interval=self._interval * self._dt,
            longest_command_interval=longest * self._dt,
            max_tracking_error=self._tracking
            if self._disturbed and math.isfinite(self._tracking)
            else None,
            largest_tracking_error=self.tracking_error if self._disturbed else None,
        )
