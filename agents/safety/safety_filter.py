"""Safety filter of one UAV: `SafetyFilter` and its bounds."""

from collections import Counter
from typing import Any

from agents.safety.altitude import decide_in_space
from agents.safety.decision import decide
from agents.safety.handover import check_assumptions
from agents.safety.levels import bounds_of, levels_of
from agents.safety.memory import (
    add_measurement,
    add_position,
    filter_memory,
    invalidate_plans,
    track_ticks,
)
from agents.safety.pending import carried
from bus.messages.base import Vector, or_none
from bus.messages.decision import FilterDecision, NotCertified, Source
from bus.messages.vehicle import BackupTrajectory, UavBriefing, UavObservation
from bus.ticks import looks_of
from sim.compiling.records import choice, struct_of
from sim.models.altitude import vertical_motion
from sim.models.motion import NO_MOTION
from sim.models.vehicles import Motion


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
        self._levels = levels_of(briefing)
        self._vertical = vertical_motion(briefing.altitude)
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
        memory, tick = self.memory, observation.tick
        here = Motion(*observation.position, *observation.velocity)
        add_position(memory, tick, here.p_x, here.p_y)
        for taken, x, y in looks_of(observation.detections, self.bounds.dt):
            add_measurement(self.bounds, memory, taken, (x, y), tick, here)

    def filter(
        self, observation: UavObservation, acceleration: Vector, vertical: float = 0.0
    ) -> FilterDecision:
        """Decide on the nominal acceleration: apply it if the UGV stays in sight after it, else a backup trajectory.

        Args:
            observation: Same observation as in the last call of `see`.
            acceleration: Nominal acceleration of the law, the operator or the policy [m/s²].
            vertical: Its nominal vertical acceleration, if it has an altitude [m/s²].
        """
        here, tick = Motion(*observation.position, *observation.velocity), observation.tick
        u_x, u_y = float(acceleration[0]), float(acceleration[1])
        committed = (
            NO_MOTION
            if observation.committed_trajectory is None
            else observation.committed_trajectory
        )
        if observation.altitude is None:
            decide(self.bounds, self.memory, tick, here, u_x, u_y, committed)
        else:
            own = self._vertical[0]
            own["altitude"], own["rate"] = observation.altitude, observation.climb_rate
            wanted = u_x, u_y, float(vertical)
            decide_in_space(self._levels, self.memory, tick, here, own, wanted, committed)
        decision = decision_of(self.memory.decision[0])
        self.ticks += 1
        self.overridden += decision.overridden
        if decision.reason is not None:
            self.not_certified[decision.reason] += 1
        return decision

    def backup_trajectories(self, tick: int) -> tuple[BackupTrajectory, ...]:
        """Return the plans of this tick's command: earlier ones that may be missing, then its own."""
        sent, last = self.memory.pending.sent, tick + self.bounds.delay_ticks
        count = carried(self.bounds, self.memory.pending, tick)
        places = [begins % len(sent) for begins in range(last - count + 1, last + 1)]
        return tuple(struct_of(BackupTrajectory, sent[place]) for place in places)
