"""Tests that the safety filters tell the truth: what each UAV reports, held against what the simulator knows."""

import math
from collections import Counter

from bus.messages import CertificateStatus, UavCommand
from sim.engine.briefing import declared
from sim.engine.certificate_counts import (
    NEVER,
    CertificateBounds,
    certificate_bounds,
    certificate_counts,
    count_tick,
    count_tracking,
    note_end,
    sent_commands,
)
from sim.kernels.compile import FloatArray
from sim.kernels.records import RecordArray, records
from sim.scenario.types import Scenario, Uav

_SILENT = "the UAV has no estimate yet, or its command did not come"
"""Why a tick is not certified of which no filter has said anything."""
_NOTHING_SENT = (NEVER, 0.0, 0.0)
_NOBODY = -2
"""The last tick that was watched, before the first: the one before tick 0 is -1."""


Evidence = tuple[RecordArray, FloatArray, RecordArray]
"""The truth of a tick, as `count_tick` takes it; arrays that change with the flight."""


class Assurance:
    """Collects the reports of all UAVs' safety filters.

    Args:
        scenario: What is flown.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.reasons: Counter[str] = Counter()
        """Why ticks were not certified."""
        self.tracking_error = 0.0
        """The farthest that a UAV was from where it was told that it is [m]."""
        rows = [k for k, one in enumerate(scenario.vehicles) if isinstance(one, Uav)]
        uavs, self._rows = [scenario.vehicles[k].name for k in rows], rows  # as the world's
        self._radius, self._dt = scenario.visibility.radius, scenario.dt
        self._disturbed = scenario.disturbed
        told = [declared(scenario, uav) for uav in uavs]
        self._outage = max((one.outage for one in told if one.outage is not None), default=None)
        tracking = (math.inf if one.tracking is None else one.tracking for one in told)
        self._tracking = max(tracking, default=math.inf)
        bounds = [certificate_bounds(one, scenario.dt) for one in told]
        self._bounds = records(CertificateBounds, bounds)
        self._counts = certificate_counts(len(uavs))
        self._sent = sent_commands(bounds)
        self._tables = self._bounds, self._counts, self._sent
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
        return self._sum("lost")

    @property
    def certificate_broken(self) -> int:
        """Ticks that were not certified although the one before was and all assumptions hold; likewise."""
        return self._sum("broken")

    def track(self, uav: int, off: float) -> None:
        """A UAV truly is so far from where it is told that it is at the tick that is taken next [m]."""
        self.tracking_error = max(self.tracking_error, off)
        count_tracking(self._bounds, self._counts, uav, off)

    def excuse(self, uav: int) -> None:
        """This UAV's certificate may end at the coming tick: its law has changed, or its process has joined again."""
        self._counts["promised"][uav] = False

    def disregard(self, uav: int) -> None:
        """A program that knows no certificate flies this UAV: what it does not say is no fault of a filter."""
        self._counts["ticks"][uav] -= self._silent[uav]
        self.reasons[_SILENT] -= self._silent[uav]
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
        certified = intervened = says = False
        sent, reason = _NOTHING_SENT, _SILENT
        if command is not None:
            (u_x, u_y), report = command.acceleration, command.report
            sent = command.tick, u_x, u_y
            if report is not None and report.certified is not None:
                says, certified, intervened = True, report.certified, report.intervened
                reason = report.uncertified
        if not says and (not watched or self._disregarded[uav]):
            if command is not None:  # the next one may be watched
                self._sent[uav, command.tick % self._sent.shape[1]] = sent
            return
        if self._last[uav] != tick - 1:  # not watched just before: a new filter, without a memory
            count = self._counts[uav]
            count["newest"], count["exact"], count["promised"] = NEVER, True, False
        self._last[uav] = tick
        if not certified:
            self.reasons[reason] += 1
        if not says:
            self._silent[uav] += 1
        claim = certified, intervened, distance >= self._radius, says and sent[0] == tick
        count_tick(self._tables, evidence, (uav, self._rows[uav], tick), sent, claim)

    def end(self, uav: int, distance: float) -> None:
        """The flight is over with this UAV so far from its UGV [m]: the last tick's certificate is held against it."""
        note_end(self._counts[uav], distance >= self._radius)

    def shares(self, uav: int) -> tuple[float | None, float | None]:
        """Return the shares of a UAV's watched ticks that were certified, and in which its filter acted."""
        count = self._counts[uav]
        ticks = int(count["ticks"])
        if not ticks:
            return None, None
        return int(count["certified"]) / ticks, int(count["intervened"]) / ticks

    def status(self) -> CertificateStatus | None:
        """All of it as a message; None where no filter has watched over anything."""
        if not self.ticks:
            return None
        longest = int(self._counts["longest_outage"].max())
        return CertificateStatus(
            ticks=self.ticks,
            certified=self.certified,
            intervened=self._sum("intervened"),
            uncertified=dict(self.reasons),
            certified_while_lost=self.certified_while_lost,
            certificate_broken=self.certificate_broken,
            outage=self._outage,
            longest_outage=None if self._outage is None else longest * self._dt,
            tracking=self._tracking if self._disturbed and math.isfinite(self._tracking) else None,
            tracking_error=self.tracking_error if self._disturbed else None,
        )
