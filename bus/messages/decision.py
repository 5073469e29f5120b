"""Decision of a UAV's safety filter, and the reasons why a tick is not certified."""

from enum import StrEnum

from bus.messages.base import Message, NonNegative, Vector


class Source(StrEnum):
    """Origin of the acceleration that a safety filter lets act."""

    NOMINAL = "NOMINAL"
    """The nominal control, unchanged."""
    BACKUP = "BACKUP"
    """A backup trajectory, in the place of the nominal control."""
    BEST_EFFORT = "BEST_EFFORT"
    """No backup trajectory exists: the UAV flies to the newest measurement, or brakes without one."""


class NotCertified(StrEnum):
    """Reason why a tick is not certified."""

    ASSUMPTIONS = "ASSUMPTIONS"
    NO_MEASUREMENT = "NO_MEASUREMENT"
    MEASUREMENT_TOO_OLD = "MEASUREMENT_TOO_OLD"
    CONTRADICTION = "CONTRADICTION"
    COMMAND_INTERVAL = "COMMAND_INTERVAL"
    NO_PLAN = "NO_PLAN"
    OFF_TRAJECTORY = "OFF_TRAJECTORY"
    UNCHECKED_PLAN = "UNCHECKED_PLAN"
    NO_REPORT = "NO_REPORT"
    """No filter gives this reason: the simulator counts ticks of which no filter has reported."""

    @property
    def text(self) -> str:
        """Plain English: what happened."""
        return WHAT_HAPPENED[self]


WHAT_HAPPENED = {
    NotCertified.ASSUMPTIONS: "the declared numbers allow no certificate; `outrider check` names the assumption",
    NotCertified.NO_MEASUREMENT: "no detection has arrived yet",
    NotCertified.MEASUREMENT_TOO_OLD: "the newest detection is older than declared",
    NotCertified.CONTRADICTION: "detections contradict each other: their errors exceed the declared bound, or the UGV "
    "is faster than declared",
    NotCertified.COMMAND_INTERVAL: "commands are lost: no plan can begin within the declared interval",
    NotCertified.NO_PLAN: "no plan from here keeps the UGV in sight",
    NotCertified.OFF_TRAJECTORY: "the UAV is not in the state to which the reported trajectory leads",
    NotCertified.UNCHECKED_PLAN: "the UAV flies, or may begin, a plan that was not checked from its state",
    NotCertified.NO_REPORT: "the UAV has no estimate yet, or its command did not come",
}
"""Plain-English text for each reason."""


class FilterDecision(Message, frozen=True, kw_only=True):
    """Decision of a UAV's safety filter in one tick."""

    acceleration: Vector
    """Acceleration that acts [m/s²]."""
    source: Source
    """Origin of the acceleration."""
    reason: NotCertified | None
    """Reason why the tick is not certified; None: visibility is guaranteed from here on."""
    certified_distance: NonNegative | None
    """Upper bound of the distance to the UGV now [m]; None before the first detection."""

    @property
    def certified(self) -> bool:
        """True if visibility is guaranteed from here on, whatever the UGV does within its bounds."""
        return self.reason is None

    @property
    def overridden(self) -> bool:
        """True if the filter does not let the nominal control act."""
        return self.source is not Source.NOMINAL
