"""Safety filter of one UAV: `SafetyFilter` and its bounds."""

from collections import Counter
from typing import Any

from agents.safety.altitude import Acceleration
from agents.safety.control import bare_control, filter_control, record_measurements
from agents.safety.handover import check_assumptions
from agents.safety.levels import bounds_of, levels_of
from agents.safety.memory import filter_memory, invalidate_plans, track_ticks
from agents.safety.pending import carried
from agents.uav_inputs import UavInputs, uav_inputs
from bus.messages.base import Vector, or_none
from bus.messages.decision import FilterDecision, NotCertified, Source
from bus.messages.vehicle import BackupTrajectory, UavBriefing, UavObservation
from bus.ticks import detection_rows
from sim.compiling.records import RecordArray, choice, records, struct_of
from sim.models.altitude import vertical_state
from sim.models.safety import SafetyBounds


def decision_of(row: Any) -> FilterDecision:  # noqa: ANN401 - a record
    """Return the message form of a decision."""
    u_x, u_y = row["acceleration"].tolist()
    return FilterDecision(
        acceleration=(u_x, u_y),
        source=choice(Source, int(row["source"])) or Source.NOMINAL,
        reason=choice(NotCertified, int(row["reason"])),
        certified_distance=or_none(float(row["certified_distance"])),
        vertical_acceleration=float(row["vertical_acceleration"]),
    )


class SafetyFilter:
    """Filter that keeps the UGV in sight, for any nominal control: a law, an operator, a learned policy.

    See docs/explanation/proof.md. Call `see` with every observation, then `filter` with the nominal acceleration,
    and send `backup_trajectories` with the command.

    Args:
        briefing: Briefing of the UAV: its limits, r_v, and the declared safety parameters.
    """

    def __init__(self, briefing: UavBriefing) -> None:
        self.bounds = bounds_of(briefing)
        """Bounds of the filter; with an altitude, those at the initial altitude."""
        self.rows = records(SafetyBounds, [self.bounds])
        """The same for compiled code. Shape (1,)."""
        self._levels: RecordArray | None = None
        self._vertical: RecordArray | None = None
        if briefing.altitude is not None:
            self._levels, self._vertical = levels_of(briefing), vertical_state(briefing.altitude)
        self.faults = check_assumptions(self.bounds)
        """Violated assumptions, one line each; if there are any, nothing can be certified."""
        self.ticks = 0
        """Number of filtered commands."""
        self.overridden = 0
        """Number of overridden commands."""
        self.not_certified: Counter[NotCertified] = Counter()
        """Number of ticks that were not certified, by reason."""
        self.memory = filter_memory(self.bounds.delay_ticks, depth=track_ticks(self.bounds))
        """Memory for the compiled functions of `agents.safety`."""

    def invalidate_plans(self) -> None:
        """Mark all plans unchecked, since the last commands may not have been sent.

        Nothing is certified until the vehicle executes a plan that is sent after this call.
        """
        invalidate_plans(self.memory)

    def see(self, observation: UavObservation) -> None:
        """Record the UAV's position, and the detections received, in any order."""
        record_measurements(self.rows, self.memory, self._inputs(observation))

    def filter(
        self, observation: UavObservation, acceleration: Vector, vertical: float = 0.0
    ) -> FilterDecision:
        """Decide on the nominal acceleration: apply it if the UGV stays in sight after it, else a backup trajectory.

        Args:
            observation: Same observation as in the last call of `see`.
            acceleration: Nominal acceleration of the law, the operator or the policy [m/s²].
            vertical: Its nominal vertical acceleration, if it has an altitude [m/s²].
        """
        u_x, u_y = acceleration
        return self.decide(self._inputs(observation), Acceleration(u_x, u_y, vertical))

    def _inputs(self, observation: UavObservation) -> UavInputs:
        detections = detection_rows(observation.detections, self.bounds.dt)
        return uav_inputs(observation, detections, vertical=self._vertical)

    def decide(self, inputs: UavInputs, nominal: Acceleration) -> FilterDecision:
        """Decide on the nominal acceleration, as `filter` does, after `record_measurements`."""
        floats = Acceleration(*map(float, nominal))
        filter_control(self.rows, self._levels, self.memory, inputs, floats)
        decision = decision_of(self.memory.decision[0])
        self.ticks += 1
        self.overridden += decision.overridden
        if decision.reason is not None:
            self.not_certified[decision.reason] += 1
        return decision

    def pass_bare(self, inputs: UavInputs, nominal: Acceleration) -> Acceleration:
        """Return the acceleration of a UAV without the filter: at an altitude, its vertical rule still acts.

        Then `backup_trajectories` are part of the command; in the plane they are not.
        """
        floats = Acceleration(*map(float, nominal))
        return Acceleration(*bare_control(self._levels, self.memory, inputs, floats))

    def backup_trajectories(self, tick: int) -> tuple[BackupTrajectory, ...]:
        """Return the plans of this tick's command: earlier ones that may be missing, then its own."""
        sent, last = self.memory.pending.sent, tick + self.bounds.delay_ticks
        count = carried(self.bounds, self.memory.pending, tick)
        rows = [begins % len(sent) for begins in range(last - count + 1, last + 1)]
        return tuple(struct_of(BackupTrajectory, sent[row]) for row in rows)
