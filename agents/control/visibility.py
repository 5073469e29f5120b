"""The visibility constraint (5), the radius from which only tracking acts (18), and the filter that keeps the constraint."""

import math
from collections import Counter, deque
from typing import NamedTuple

import numpy as np

from agents.control.certificate import CERTIFIED, INNER, UNCERTIFIED, no_plan, safe_control, state_ahead, uncertified_reason
from agents.control.discs import certified_distance, keep_detection, no_detections
from agents.control.handover import Promise, certificate, check_assumptions
from bus.errors import ScenarioError
from bus.messages import UavBriefing, UavObservation, Vector
from sim.compile import compiled
from sim.vehicles import norm, stopping_distance

_TRACK = 120.0
"""The UAV's own positions are kept for so long [s]; detections that are older are of no use."""


@compiled
def is_visible(p_ax: float, p_ay: float, p_gx: float, p_gy: float, r_v: float) -> bool:
    r"""Whether the UAV surely sees the UGV, Klodt 2015, eq. (5): $\|p_a - p_g\| < r_v$. Positions and r_v in [m]."""
    return norm(p_ax - p_gx, p_ay - p_gy) < r_v


@compiled
def raw_switching_radius(r_v: float, v_a: float, v_g: float, u_a: float) -> float:
    r"""The right side of (18) in one phase, $r_v - (v_a + v_g)^2 / (2 u_a)$ [m], whatever its sign."""
    return r_v - stopping_distance(v_a + v_g, u_a)


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


def promise_of(briefing: UavBriefing) -> Promise:
    """The certificate that a UAV can give on what it is told."""
    own, target, declared = briefing.limits, briefing.target_limits, briefing.certificate
    bounds = [math.inf if bound is None else bound for bound in (own.max_speed, own.max_acceleration, target.max_speed)]
    return certificate(
        r_v=briefing.visibility_radius,
        v_a=bounds[0],
        u_a=bounds[1],
        v_g=bounds[2],
        dt=briefing.dt,
        eps=math.inf if declared.error is None else declared.error,
        age=declared.age,
        delay=declared.delay,
        margin=declared.margin,
        width=briefing.area.width,
        height=briefing.area.height,
    )


class Verdict(NamedTuple):
    """What the filter made of a command."""

    acceleration: Vector
    """What is to act [m/s²]."""
    intervened: bool
    """Whether that is not what was asked for."""
    certified: bool
    """Whether sight is kept from here on, whatever the UGV does within its bounds."""
    reason: str
    """Why not."""
    distance: float
    """The UGV is surely no farther than this [m]; infinite before the first detection."""


class SafetyFilter:
    """Keeps sight of the UGV around any way to fly: a law, a person, a learned policy. See docs/certificate.md.

    Call `see` with every observation, and `filter` with the command for it.

    Args:
        briefing: What the UAV is told when it joins: bounds, r_v, and what is declared of detections and commands.
    """

    def __init__(self, briefing: UavBriefing) -> None:
        self.promise = promise_of(briefing)
        """The declared numbers, and what follows from them."""
        self.faults = check_assumptions(self.promise)
        """Why nothing can be certified with these numbers, a line each."""
        self.ticks = 0
        """Commands that were filtered."""
        self.interventions = 0
        """Those that were not let through."""
        self.uncertified: Counter[str] = Counter()
        """Ticks that were not certified, by reason."""
        self._detections, self._plan = no_detections(), no_plan()
        self._pending = np.zeros((round(self.promise.delay / self.promise.dt), 2))
        self._track: deque[tuple[int, Vector]] = deque(maxlen=max(1, math.ceil(_TRACK / briefing.dt)))
        self._contradicted = False

    def see(self, observation: UavObservation) -> None:
        """Take in where the UAV is, and the detections that have arrived, in any order."""
        c, (p_x, p_y) = self.promise, observation.position
        self._track.append((observation.tick, observation.position))
        for found in observation.detections:
            own = self._position_at(round(found.time / c.dt))
            if own is None:
                continue
            z_x, z_y = own[0] - found.relative_position[0], own[1] - found.relative_position[1]
            z_x, z_y = min(max(z_x, 0.0), c.width), min(max(z_y, 0.0), c.height)  # the UGV is in the area
            agrees = keep_detection(self._detections, z_x, z_y, found.time, observation.time, p_x, p_y, c.eps, c.v_g)
            self._contradicted |= not agrees

    def _position_at(self, tick: int) -> Vector | None:
        place = len(self._track) - 1 - (self._track[-1][0] - tick)
        if 0 <= place < len(self._track) and self._track[place][0] == tick:
            return self._track[place][1]
        return next((position for seen, position in self._track if seen == tick), None)  # where ticks were missed

    def filter(self, observation: UavObservation, acceleration: Vector) -> Verdict:
        """Let a command through if sight is kept after it; else give the one that keeps it.

        Args:
            observation: What `see` was called with last.
            acceleration: What the law, the person or the policy wants [m/s²].
        """
        c, pending = self.promise, self._pending
        (p_x, p_y), (v_x, v_y), (u_x, u_y) = observation.position, observation.velocity, acceleration
        q_x, q_y, w_x, w_y = state_ahead(pending, p_x, p_y, v_x, v_y, c.v_a, c.u_a, c.dt)
        u_x, u_y, acts = safe_control(
            c, self._detections, self._plan, observation.time + c.delay, q_x, q_y, w_x, w_y, float(u_x), float(u_y)
        )
        if len(pending):
            pending[:-1], pending[-1] = pending[1:], (u_x, u_y)
        code = uncertified_reason(c, self._detections, self._plan, observation.time, self._contradicted, acts)
        reason = "" if code == CERTIFIED else UNCERTIFIED[code]
        if self.faults:
            reason = self.faults[0]
        self.ticks += 1
        self.interventions += acts != INNER
        if reason:
            self.uncertified[reason] += 1
        distance = certified_distance(p_x, p_y, observation.time, self._detections, c.eps, c.v_g)
        return Verdict((u_x, u_y), acts != INNER, not reason, reason, distance)
