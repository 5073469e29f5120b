"""Tests that the safety filters tell the truth: what each UAV reports, held against what the simulator knows.

Two counts must be 0 in every flight of every law and network: ticks that are certified while the UGV is out of
sight, and certificates that are lost although every declared assumption holds.
"""

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from bus.messages import CertificateStatus, DeclaredBounds, UavReport, Vector
from sim.channel.link import DUST, in_ticks
from sim.engine.briefing import declared
from sim.models.motion import NO_MOTION, waited
from sim.scenario.types import Scenario, Uav

_SILENT = "the UAV has no estimate yet, or its command did not come"
"""Why a tick is not certified of which no filter has said anything."""
_ROUNDING = 1e-9
"""A measured error that is larger than declared by no more than this [m] is as declared."""
_NOBODY = -2
"""The last tick that was watched, before the first: the one before tick 0 is -1."""


class Arrival(NamedTuple):
    """A detection that has reached a UAV's computer."""

    taken: int
    """Tick at which it was taken."""
    error: float
    """Norm of its error, by the true relative position at that tick [m]."""


class Assumptions:
    """Follows whether the declared assumptions of one UAV's certificate hold, as the simulator sees them.

    Args:
        certificate: What is declared to the UAV.
        dt: Length of a tick [s].
    """

    def __init__(self, certificate: DeclaredBounds, dt: float) -> None:
        self._error = math.inf if certificate.error is None else certificate.error + _ROUNDING
        self._age = math.floor(certificate.age / dt + DUST)
        self._delay = in_ticks(certificate.delay, dt)
        outage = certificate.outage
        self._outage = None if outage is None else math.floor(outage / dt + DUST)
        self._tracking = math.inf
        if certificate.tracking is not None:
            self._tracking = certificate.tracking + _ROUNDING
        self._tracked = True
        self._suspected = (
            0  # ticks at which a certificate ended, and outages later than that are yet to be seen
        )
        self._since = 0  # the last of them
        self.longest_outage = 0
        """The longest time from the beginning of a motion to that of the next so far [ticks]."""
        self.broken = 0
        """The number of certificates that have ended although all assumptions held."""
        size = self._delay + 1
        nothing: list[tuple[int, Vector]] = [(tick - size, (0.0, 0.0)) for tick in range(size)]
        self._sent = nothing  # a ring: the tick that each answers, and the command
        self._obeyed = True
        self.begin()

    def begin(self) -> None:
        """A filter begins that remembers no detection."""
        self._newest = -math.inf
        self._exact = True

    def track(self, off: float) -> None:
        """The UAV truly is so far from where it is told that it is [m].

        Once that is farther than declared, what is seen from there may be wrong for as long as it is remembered.
        """
        self._tracked = self._tracked and off <= self._tracking

    def send(self, answered: int, acceleration: Vector) -> None:
        """The UAV's command [m/s²] for this tick has set out."""
        self._sent[answered % len(self._sent)] = (answered, acceleration)

    def perceive(self, arrivals: Sequence[Arrival]) -> None:
        """Detections have arrived that the UAV has seen."""
        for taken, error in arrivals:
            self._newest = max(self._newest, taken)
            self._exact = self._exact and error <= self._error

    def act(self, tick: int, acceleration: Vector, flown: int | None = None) -> None:
        """A command [m/s²] acts in this tick, or a motion that began in the tick `flown`."""
        if self._outage is not None:
            wait = waited(tick, NO_MOTION if flown is None else flown, self._delay) + 1
            self.longest_outage = max(self.longest_outage, wait)  # so long at least
            self._obeyed = wait <= self._outage
            if not self._obeyed:
                self._suspected = 0
            self._confirm(tick)
            return
        due = tick - self._delay
        self._obeyed = self._sent[due % len(self._sent)] == (due, acceleration)

    def suspect(self, tick: int) -> None:
        """A certificate has ended at this tick although the assumptions hold.

        Where commands carry motions it is broken only if they hold until the motion of this tick's command may begin: a
        pilot knows of an outage as soon as nothing that is under way can end it in time.
        """
        self._suspected, self._since = self._suspected + 1, tick
        self._confirm(tick - 1)

    def _confirm(self, tick: int) -> None:
        """Count what was suspected, if the assumptions have held for long enough at this tick."""
        if self._outage is None or tick >= self._since + self._delay - 1:
            self.broken, self._suspected = self.broken + self._suspected, 0

    def hold(self, tick: int) -> bool:
        """True if they hold at this tick.

        The newest detection's age, all detections' errors and own positions, the command or motion that acted just
        before.
        """
        return self._exact and self._tracked and self._obeyed and tick - self._newest <= self._age


class Assurance:
    """Collects the reports of all UAVs' safety filters.

    Args:
        scenario: What is flown.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.ticks = 0
        """Ticks of a UAV that flies a law that a filter watches over."""
        self.certified = 0
        """Those that were certified."""
        self.interventions = 0
        """Those in which a filter acted instead of the law."""
        self.reasons: Counter[str] = Counter()
        """Why ticks were not certified."""
        self.certified_while_lost = 0
        """Ticks that were certified although the UGV was out of sight then.

        The certificate is wrong if there is one.
        """
        uavs = [
            one.name for one in scenario.vehicles if isinstance(one, Uav)
        ]  # rows as the world's
        self._radius, self._dt = scenario.visibility.radius, scenario.dt
        self.tracking_error = 0.0
        """The farthest that a UAV was from where it was told that it is [m]."""
        self._disturbed = scenario.disturbed
        bounds = [declared(scenario, uav) for uav in uavs]
        self._outage = max((b.outage for b in bounds if b.outage is not None), default=None)
        self._assumptions = [Assumptions(one, scenario.dt) for one in bounds]
        told = (math.inf if b.tracking is None else b.tracking for b in bounds)
        self._tracking = max(told, default=math.inf)
        self._promised = [False] * len(uavs)
        """True where the tick before was certified, and nothing excuses that this one is not."""
        self._last = [_NOBODY] * len(uavs)
        self._silent = [0] * len(uavs)  # ticks of which nothing was said
        self._disregarded = [False] * len(uavs)

    @property
    def certificate_broken(self) -> int:
        """Ticks that were not certified although the one before was and all assumptions hold; likewise."""
        return sum(assumptions.broken for assumptions in self._assumptions)

    def send(self, uav: int, answered: int, acceleration: Vector) -> None:
        """A command has set out: whatever the law, the next one may be watched.

        Args:
            uav: Row of the UAV.
            answered: The tick whose observation it answers.
            acceleration: [m/s²]
        """
        self._assumptions[uav].send(answered, acceleration)

    def track(self, uav: int, off: float) -> None:
        """A UAV truly is so far from where it is told that it is at the tick that is taken next [m]."""
        self.tracking_error = max(self.tracking_error, off)
        self._assumptions[uav].track(off)

    def excuse(self, uav: int) -> None:
        """This UAV's certificate may end at the coming tick: its law has changed, or its process has joined again."""
        self._promised[uav] = False

    def disregard(self, uav: int) -> None:
        """A program that knows no certificate flies this UAV: what it does not say is no fault of a filter."""
        self.ticks -= self._silent[uav]
        self.reasons[_SILENT] -= self._silent[uav]
        self.reasons += Counter()  # drops what is zero
        self._silent[uav] = 0
        self._disregarded[uav] = True

    def take(
        self,
        uav: int,
        tick: int,
        report: UavReport | None,
        *,
        distance: float,
        arrivals: Sequence[Arrival] = (),
        acts: Vector = (0.0, 0.0),
        flown: int | None = None,
        current: bool = True,
    ) -> None:
        """Count a tick in which a UAV flies a law that a filter watches over.

        Args:
            uav: Row of the UAV.
            tick: Which.
            report: What it says; None if no command came, or one without a report.
            distance: The true one at the tick that is reported of [m].
            arrivals: What has reached it at this tick.
            acts: The command that acts in this tick [m/s²].
            flown: The tick in which the motion began that is flown in this tick; None: none is.
            current: Whether the report is of this tick; with a clock that waits for nobody it may be of an earlier one.
        """
        if self._disregarded[uav] and (report is None or report.certified is None):
            return
        assumptions = self._assumptions[uav]
        if self._last[uav] != tick - 1:  # not watched just before: the filter is new
            assumptions.begin()
            self._promised[uav] = False
        self._last[uav] = tick
        assumptions.perceive(arrivals)
        self.ticks += 1
        certified = report is not None and bool(report.certified)
        if report is None or report.certified is None:
            self.reasons[_SILENT] += 1
            self._silent[uav] += 1
        else:
            self.certified += certified
            self.interventions += report.intervened
            self.certified_while_lost += certified and distance >= self._radius
            if not certified:
                self.reasons[report.uncertified] += 1
                if current and self._promised[uav] and assumptions.hold(tick):
                    assumptions.suspect(tick)
        self._promised[uav] = certified and current
        assumptions.act(tick, acts, flown)

    def status(self) -> CertificateStatus | None:
        """All of it as a message; None where no filter has watched over anything."""
        if not self.ticks:
            return None
        longest = max(assumptions.longest_outage for assumptions in self._assumptions)
        return CertificateStatus(
            ticks=self.ticks,
            certified=self.certified,
            intervened=self.interventions,
            uncertified=dict(self.reasons),
            certified_while_lost=self.certified_while_lost,
            certificate_broken=self.certificate_broken,
            outage=self._outage,
            longest_outage=None if self._outage is None else longest * self._dt,
            tracking=self._tracking if self._disturbed and math.isfinite(self._tracking) else None,
            tracking_error=self.tracking_error if self._disturbed else None,
        )
