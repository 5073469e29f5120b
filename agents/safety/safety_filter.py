"""The safety filter of one UAV: `SafetyFilter`, its bounds, and its answer."""

from collections import Counter

import msgspec

from agents.safety.decision import (
    forget_commands,
    guard,
    guard_state,
    note_detection,
    note_position,
    track_ticks,
)
from agents.safety.handover import certificate, check_assumptions
from agents.safety.pending import carried
from agents.safety.trajectories import CERTIFIED, INNER, UNCERTIFIED
from bus.messages.base import Vector
from bus.messages.vehicle import BackupTrajectory, UavBriefing, UavObservation
from bus.ticks import looks_of
from sim.compiling.records import struct_of
from sim.models.motion import NO_MOTION
from sim.models.safety import SafetyBounds, safety_bounds
from sim.models.vehicles import Motion


def bounds_of(briefing: UavBriefing) -> SafetyBounds:
    """Return the bounds of a UAV's safety filter, hand-over included."""
    (v_a, u_a), (v_g, _) = briefing.limits.numbers, briefing.target_limits.numbers
    return certificate(
        safety_bounds(
            briefing.safety,
            visibility_radius=briefing.visibility_radius,
            v_a=v_a,
            u_a=u_a,
            v_g=v_g,
            dt=briefing.dt,
            width=briefing.area.width,
            height=briefing.area.height,
        )
    )


def flown_in(observation: UavObservation) -> int:
    """The motion that the vehicle says that it flew, as `agents.safety.decision.guard` takes it."""
    return NO_MOTION if observation.flown is None else observation.flown


class Verdict(msgspec.Struct, frozen=True):
    """The filter's answer to a command."""

    acceleration: Vector
    """The command that is to act [m/s²]."""
    intervened: bool
    """True if that is not what was asked for."""
    certified: bool
    """True if sight is kept from here on, whatever the UGV does within its bounds."""
    reason: str
    """Why not."""
    distance: float
    """The UGV is surely no farther than this [m]; infinite before the first detection."""
    motions: tuple[BackupTrajectory, ...]
    """The motions that the command is to carry; a receiver of bare accelerations ignores them."""


class SafetyFilter:
    """Keeps sight of the UGV around any way to fly: a law, a person, a learned policy.

    See docs/explanation/certificate.md. Call `see` with every observation, and `filter` with the command for it.

    Args:
        briefing: What the UAV is told when it joins: bounds, r_v, and what is declared of detections and commands.
    """

    def __init__(self, briefing: UavBriefing) -> None:
        self.promise = bounds_of(briefing)
        """The declared numbers, and what follows from them."""
        self.faults = check_assumptions(self.promise)
        """Why nothing can be certified with these numbers, a line each."""
        self.ticks = 0
        """Commands that were filtered."""
        self.interventions = 0
        """Those that were not let through."""
        self.uncertified: Counter[str] = Counter()
        """Ticks that were not certified, by reason."""
        self.state = guard_state(self.promise.delay_ticks, depth=track_ticks(self.promise))
        """The memory that the compiled functions of `agents.safety.decision` work on."""

    def forget_commands(self) -> None:
        """It is not known whether the last commands were sent.

        Until the vehicle flies one that is sent after this, nothing is certified.
        """
        forget_commands(self.state)

    def see(self, observation: UavObservation) -> None:
        """Take in where the UAV is, and the detections that have arrived, in any order."""
        state, tick, (p_x, p_y) = self.state, observation.tick, observation.position
        note_position(state, tick, p_x, p_y)
        for taken, x, y in looks_of(observation.detections, self.promise.dt):
            note_detection(self.promise, state, taken, tick, x, y, p_x, p_y)

    def filter(self, observation: UavObservation, acceleration: Vector) -> Verdict:
        """Let a command through if sight is kept after it; else give the one that keeps it.

        Args:
            observation: What `see` was called with last.
            acceleration: What the law, the person or the policy wants [m/s²].
        """
        here, tick = Motion(*observation.position, *observation.velocity), observation.tick
        u_x, u_y, flown = float(acceleration[0]), float(acceleration[1]), flown_in(observation)
        return self.verdict(tick, *guard(self.promise, self.state, tick, here, u_x, u_y, flown))

    def _motions(self, tick: int) -> tuple[BackupTrajectory, ...]:
        """The motions that this tick's command carries: its own last, before it those that may be missing."""
        sent, last = self.state.underway.sent, tick + self.promise.delay_ticks
        count = carried(self.promise, self.state.underway, tick)
        places = [begins % len(sent) for begins in range(last - count + 1, last + 1)]
        return tuple(struct_of(BackupTrajectory, sent[place]) for place in places)

    def verdict(
        self, tick: int, u_x: float, u_y: float, acts: int, code: int, distance: float
    ) -> Verdict:
        """Count what `guard` has made of the command for this tick, and say it in words."""
        reason = "" if code == CERTIFIED else UNCERTIFIED[code]
        if self.faults:
            reason = self.faults[0]
        intervened = acts != INNER
        self.ticks += 1
        self.interventions += intervened
        if reason:
            self.uncertified[reason] += 1
        return Verdict((u_x, u_y), intervened, not reason, reason, distance, self._motions(tick))
