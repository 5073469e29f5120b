"""The visibility constraint (5), the radius from which only tracking acts (18), and the filter that keeps sight."""

from collections import Counter

import msgspec

from agents.control.certificate import CERTIFIED, INNER, UNCERTIFIED
from agents.control.guard import (
    forget_commands,
    guard,
    guard_state,
    note_detection,
    note_position,
    track_ticks,
)
from agents.control.handover import certificate, check_assumptions
from agents.control.underway import carried
from bus.errors import ScenarioError
from bus.messages import (
    BackupTrajectory,
    UavBriefing,
    UavObservation,
    Vector,
)
from bus.ticks import looks_of
from sim.kernels.compile import compiled
from sim.kernels.records import struct_of
from sim.models.motion import NO_MOTION
from sim.models.safety import SafetyBounds, safety_bounds
from sim.models.vehicles import Motion, norm, raw_switching_radius


@compiled
def is_visible(p_ax: float, p_ay: float, p_gx: float, p_gy: float, r_v: float) -> bool:
    r"""True if the UAV surely sees the UGV, Klodt 2015, eq. (5): $\|p_a - p_g\| < r_v$. Positions and r_v in [m]."""
    return norm(p_ax - p_gx, p_ay - p_gy) < r_v


def switching_radius(r_v: float, v_a: float, v_g: float, u_a: float) -> float:
    r"""Distance from which only tracking acts, Klodt 2015, eq. (18).

    $$ r_s = r_v - \frac{(v_a + v_g)^2}{2 u_a} $$

    The paper prints the same value as two phases, braking and catching up:
    $r_v - \frac{1}{u_a}\left(v_g (v_a + v_g) + \frac12 (v_a^2 - v_g^2)\right)$.

    Args:
        r_v: Visibility radius [m].
        v_a: Largest speed of the UAV [m/s].
        v_g: Largest speed of the UGV [m/s].
        u_a: Largest acceleration of the UAV [m/s²]; infinite means that it stops on the spot.

    Raises:
        ScenarioError: If r_s is not positive: the UAV is too weak for this radius.
    """
    r_s: float = raw_switching_radius(r_v, v_a, v_g, u_a)
    if not r_s > 0.0:
        raise ScenarioError(
            f"r_s = {r_s:.6g} m: the UAV (v_a {v_a:g} m/s, u_a {u_a:g} m/s²) is too weak to keep a UGV of {v_g:g} m/s "
            f"within r_v = {r_v:g} m; r_s must be positive"
        )
    return r_s


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
    """The motion that the vehicle says that it flew, as `agents.control.guard.guard` takes it."""
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
        """The memory that the compiled functions of `agents.control.guard` work on."""

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
