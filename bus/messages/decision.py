"""Decision of a UAV's safety filter, and the reasons why a tick is not certified."""

from enum import StrEnum

from bus.messages.base import Coordinate, Message, NonNegative, Vector


class Source(StrEnum):
    """Origin of the acceleration that the safety filter applies."""

    NOMINAL = "NOMINAL"
    """The nominal control, unchanged."""
    BACKUP = "BACKUP"
    """A backup trajectory instead of the nominal control."""
    BEST_EFFORT = "BEST_EFFORT"
    """No backup trajectory exists: the UAV flies to the newest measurement and searches, or brakes if it has none."""


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
    TOO_LOW = "TOO_LOW"
    NO_REPORT = "NO_REPORT"
    """Given by the simulator, never by a filter: counts ticks without a report from a filter."""
    NO_CLEARANCE = "NO_CLEARANCE"
    """Given by the simulator, never by a filter: the UAV does not know which driver is in control of the UGV."""
    NO_ROBOT_STATE = "NO_ROBOT_STATE"
    """Given by the simulator, never by a filter: the UAV's robot has no valid reported state."""
    ROLE = "ROLE"
    """Given by environments, never by a filter: the UAV's role in its team has no filter in this tick."""

    @property
    def text(self) -> str:
        """Return a plain-English description of the reason."""
        return WHAT_HAPPENED[self]


WHAT_HAPPENED = {
    NotCertified.ASSUMPTIONS: "the declared bounds allow no certificate; `outrider check` names the assumption",
    NotCertified.NO_MEASUREMENT: "no detection has arrived yet",
    NotCertified.MEASUREMENT_TOO_OLD: "the newest detection is older than max_measurement_age",
    NotCertified.CONTRADICTION: "detections contradict each other: their errors exceed max_measurement_error, or the "
    "UGV exceeds its speed limit",
    NotCertified.COMMAND_INTERVAL: "commands are lost: no new plan can start within max_command_interval",
    NotCertified.NO_PLAN: "no plan from here keeps the UGV in sight",
    NotCertified.OFF_TRAJECTORY: "the UAV is not on the trajectory that it reported",
    NotCertified.UNCHECKED_PLAN: "the UAV executes, or may start, a plan that was not checked from its state",
    NotCertified.TOO_LOW: "the UAV is, or will be, below the lowest altitude that can be certified",
    NotCertified.NO_REPORT: "the UAV has no estimate yet, or its command did not arrive",
    NotCertified.NO_CLEARANCE: "the driver of the UGV keeps no distance from buildings, or the UGV is nearer than it "
    "declares",
    NotCertified.NO_ROBOT_STATE: "the UAV's process reports no valid state of its robot",
    NotCertified.ROLE: "the role of the UAV in its team needs no certificate",
}
"""Plain-English description of each reason."""


class FilterDecision(Message, frozen=True, kw_only=True):
    """Decision of a UAV's safety filter in one tick."""

    acceleration: Vector
    """Acceleration applied [m/s²]."""
    source: Source
    """Origin of the acceleration."""
    reason: NotCertified | None
    """Reason why the tick is not certified; None: visibility is guaranteed from this tick on."""
    certified_distance: NonNegative | None
    """Upper bound of the present distance to the UGV [m]; None before the first detection."""
    vertical_acceleration: Coordinate = 0.0
    """Vertical acceleration applied [m/s²], if the UAV has an altitude."""

    @property
    def certified(self) -> bool:
        """True if visibility is guaranteed from this tick on, for every UGV motion within its bounds."""
        return self.reason is None

    @property
    def overridden(self) -> bool:
        """True if the filter replaces the nominal control."""
        return self.source is not Source.NOMINAL
