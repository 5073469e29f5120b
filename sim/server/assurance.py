"""Checks of the safety filters: each UAV's report, compared with the true state."""

import math
from collections import Counter

from bus.messages.decision import NotCertified
from bus.messages.telemetry import CertificateStatus
from bus.messages.vehicle import UavCommand
from sim.compiling.records import records
from sim.engine.briefing import monitored_bounds
from sim.engine.monitor import (
    Claim,
    Evidence,
    certificate_counters,
    record_end,
    record_tick,
    record_tracking_error,
    reset_filter,
)
from sim.models.safety import SafetyBounds
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav

_NEVER_SUPERVISED = -2
"""Initial value for the last supervised tick: the tick before tick 0 is -1."""


class Assurance:
    """Evaluation of the reports of all UAVs' safety filters.

    Args:
        scenario: Scenario of the run.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.reasons: Counter[NotCertified] = Counter()
        """Ticks not certified, by reason."""
        self.tracking_error = 0.0
        """Largest distance so far of a UAV from its reference position [m]."""
        rows = [k for k, one in enumerate(scenario.vehicles) if isinstance(one, Uav)]
        uavs, self._rows = [scenario.vehicles[k].name for k in rows], rows  # in the world's order
        self._dt = scenario.dt
        self._disturbed = scenario.disturbed
        bounds = [monitored_bounds(scenario, uav) for uav in uavs]
        self._interval = max((one.interval_ticks for one in bounds), default=1)
        self._tracking = max((one.max_tracking_error for one in bounds), default=math.inf)
        self._bounds = records(SafetyBounds, bounds)
        self._counts = certificate_counters(len(uavs))
        self._tables = self._bounds, self._counts
        self._last = [_NEVER_SUPERVISED] * len(uavs)
        self._silent = [0] * len(uavs)  # ticks without a report
        self._disregarded = [False] * len(uavs)

    def _sum(self, name: str) -> int:
        return int(self._counts[name].sum())

    @property
    def ticks(self) -> int:
        """Supervised ticks, summed over all UAVs."""
        return self._sum("ticks")

    @property
    def certified(self) -> int:
        """Certified ticks."""
        return self._sum("certified")

    @property
    def certified_while_lost(self) -> int:
        """Certified ticks in which the UGV was out of sight.

        Any value above 0 shows an error in the certificate.
        """
        return self._sum("certified_while_lost")

    @property
    def certificate_broken(self) -> int:
        """Ticks not certified although the previous tick was and all assumptions hold: an error in the certificate."""
        return self._sum("broken")

    def track(self, uav: int, off: float) -> None:
        """Record the tracking error of a UAV [m] at the tick that `record` receives next."""
        self.tracking_error = max(self.tracking_error, off)
        record_tracking_error(self._bounds, self._counts, uav, off)

    def excuse(self, uav: int) -> None:
        """Allow this UAV's certificate to end at the next tick, after a new control law or with a new pilot."""
        self._counts["certified_before"][uav] = False

    def disregard(self, uav: int) -> None:
        """Exclude a UAV that is flown by a program without certificates: its missing reports are not faults."""
        self._counts["ticks"][uav] -= self._silent[uav]
        self.reasons[NotCertified.NO_REPORT] -= self._silent[uav]
        self.reasons += Counter()  # drops zero counts
        self._silent[uav] = 0
        self._disregarded[uav] = True

    def record(
        self,
        uav: int,
        tick: int,
        command: UavCommand | None,
        evidence: Evidence,
        lost: bool,
        *,
        watched: bool = True,
        clear: bool = True,
        known: bool = True,
    ) -> None:
        """Record a tick of a UAV with a safety filter, whether the filter belongs to the control law or to a pilot.

        Args:
            uav: Row of the UAV.
            tick: The tick.
            command: New command with its report; in real time it may answer an earlier tick. None: no command.
            evidence: True state of the tick.
            lost: True if the UGV was out of sight at the reported tick.
            watched: True if its control law has a safety filter.
            clear: True if the UGV keeps the distance from buildings that the filter assumes.
            known: True if the UAV's true state is known; else nothing is certified, and no certificate breaks.
        """
        report = None if command is None else command.report
        decision = None if report is None else report.decision
        if decision is None and (not watched or self._disregarded[uav]):
            self.excuse(uav)  # no filter certifies this tick
            return
        if (
            self._last[uav] != tick - 1
        ):  # not supervised in the previous tick: a new filter, without memory
            reset_filter(self._counts[uav])
        self._last[uav] = tick
        certified = overridden = current = False
        reason: NotCertified | None = NotCertified.NO_REPORT
        if decision is None:
            self._silent[uav] += known
        else:
            certified, overridden = decision.certified, decision.overridden
            reason, current = decision.reason, command is not None and command.tick == tick
        if certified and not clear:
            reason = NotCertified.NO_CLEARANCE
        if not known:
            certified, reason = False, NotCertified.NO_ROBOT_STATE
            self.excuse(uav)
        if reason is not None:
            self.reasons[reason] += 1
        claim = Claim(certified, overridden, lost, current, clear)
        row = self._rows[uav]
        record_tick(self._tables, evidence, uav, row, tick, command is not None, claim)

    def end(self, uav: int, lost: bool, *, clear: bool = True) -> None:
        """Finish the run: check the last tick's certificate.

        Args:
            uav: Row of the UAV.
            lost: True if the UGV is out of sight at the end.
            clear: As in `record`.
        """
        record_end(self._counts[uav], lost, clear)

    def shares(self, uav: int) -> tuple[float | None, float | None]:
        """Return the shares of a UAV's supervised ticks that were certified, and that were overridden."""
        count = self._counts[uav]
        ticks = int(count["ticks"])
        if not ticks:
            return None, None
        return int(count["certified"]) / ticks, int(count["overridden"]) / ticks

    def status(self) -> CertificateStatus | None:
        """Return all counts as a message; None if no filter has been active."""
        if not self.ticks:
            return None
        longest = int(self._counts["longest_interval"].max())
        return CertificateStatus(
            ticks=self.ticks,
            certified=self.certified,
            overridden=self._sum("overridden"),
            uncertified=dict(self.reasons),
            certified_while_lost=self.certified_while_lost,
            lost_without_clearance=self._sum("lost_without_clearance")
            if self._sum("revoked")
            else None,
            certificate_broken=self.certificate_broken,
            max_command_interval=self._interval * self._dt,
            longest_command_interval=longest * self._dt,
            max_tracking_error=self._tracking
            if self._disturbed and math.isfinite(self._tracking)
            else None,
            largest_tracking_error=self.tracking_error if self._disturbed else None,
            tracking_exceeded=self._sum("tracking_exceeded") if self._disturbed else None,
        )
