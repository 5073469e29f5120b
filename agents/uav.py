"""The UAV's pilot: observation in, command out."""

import math
from collections import deque
from collections.abc import Callable

from agents.control.certificate import INNER, NO_DETECTION
from agents.control.guard import guard_state
from agents.control.laws import (
    PATH,
    POLICY,
    WATCHED,
    WEIGHTED,
    LawParameters,
    OwnTerms,
    initial_state,
    law_parameters,
)
from agents.control.lookahead import lookahead_memory
from agents.control.orbit import Path, check_path
from agents.control.promise import Promise
from agents.control.telling import GroundTeller
from agents.control.uav_policy import PolicyControl, TargetEstimate, UavPolicy
from agents.control.uav_tick import UavMemory, uav_perceive, uav_tick
from agents.control.visibility import SafetyFilter, Verdict, flown_in, promise_of
from agents.control.weighting import Weighting, check_weighting
from agents.estimation.estimator import estimator_of
from agents.estimation.filtering import (
    DONE,
    KalmanState,
    kalman_begin,
    kalman_estimate,
    kalman_go_on,
    kalman_refused,
)
from agents.looks import LookRows
from bus.errors import ScenarioError
from bus.messages import (
    LONGEST_TEXT,
    Law,
    RelativeInformation,
    UavBriefing,
    UavCommand,
    UavObservation,
    UavReport,
    Vector,
    or_infinite,
)
from bus.registry import LAWS, UAV_POLICY_FORMS
from bus.ticks import radio_ticks
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray, records
from sim.models.field import cover, coverage_error, empty_coverage
from sim.models.vehicles import Motion, norm

Inner = Callable[[UavObservation], Vector | None]
"""An inner control of one's own: the acceleration [m/s²] that it wants at this tick; None: the law flies."""

_PATH_HORIZON = 600.0
"""The time that a path of one's own is checked ahead [s]: a pilot does not know how long the run will be."""

_NOTHING_OWN = OwnTerms()

_Seen = tuple[int, int, int, float, float, float, float]
"""An observation, as compiled code takes it: ticks for which the ground below has been looked at since the last one,
tick, the motion flown as in `agents.control.guard.guard`, position [m] and velocity [m/s]."""

_Command = tuple[float, float, int, int, float]
"""As `agents.control.uav_tick.uav_tick` returns it."""

_Acted = tuple[int, bool, float, float, float, int, int, _Command]
"""The outcome of `_act`: what the filter needs, as `agents.estimation.filtering.kalman_go_on` says it; unless it is
`DONE`, the rest means nothing. Whether the UGV was ever seen, where it is believed to be [m], the variance of that per
axis [m²], ticks since the newest believed detection, detections refused so far. The command, where it was asked for."""

_OWN = frozenset(row.code for row in LAWS.values() if row.own)
"""Codes of the laws that ask a function of the user's own."""

_FLIES_POLICY = frozenset(row.code for row in LAWS.values() if "uav_policy" in (row.own, row.inner))
"""Codes of the laws under which a policy flies."""

PERCEIVE, DECIDE, BOTH = 1, 2, 3
"""The parts of a tick: to take the observation in, and to make the command."""


@compiled
def _act(
    laws: RecordArray,
    promises: RecordArray,
    guarded: bool,
    memory: UavMemory,
    filters: RecordArray,
    kalman: KalmanState,
    own: OwnTerms,
    seen: _Seen,
    looks: FloatArray,
    parts: tuple[int, int],
) -> _Acted:
    """A tick in one call, since handing over the memory costs as much as either part of it.

    Where the filter needs a product of matrices it ends there, to be called again without the first part.

    Args:
        laws, promises, guarded, memory: As in `uav_tick`.
        filters, kalman: Parameters and memory of the Kalman filter.
        own: As in `uav_tick`.
        seen: The observation.
        looks: Its detections. Shape (rows, 3).
        parts: How many rows of these count, and which parts of the tick are asked for.
    """
    looked, tick, flown, p_x, p_y, v_x, v_y = seen
    here, (count, part) = Motion(p_x, p_y, v_x, v_y), parts
    law, promise = laws[0], promises[0]
    if part & PERCEIVE:
        uav_perceive(law, promise, guarded, memory, looked, tick, here, looks, count)
        kalman_begin(kalman, tick, p_x, p_y, looks, count)
    needs = kalman_go_on(filters[0], kalman)
    command = 0.0, 0.0, INNER, NO_DETECTION, 0.0
    if needs == DONE and part & DECIDE:
        target = kalman_estimate(kalman)
        command = uav_tick(law, promise, guarded, memory, own, tick, here, target, flown)
    belief = kalman.belief[0]
    return (
        needs,
        belief.known,
        belief.x,
        belief.y,
        belief.p_pp,
        belief.age,
        kalman_refused(kalman),
        command,
    )


def _report(acted: _Acted, dt: float, verdict: Verdict | None) -> UavReport:
    _, _, g_x, g_y, variance, age, refused, _ = acted
    if verdict is None:
        return UavReport(
            estimate=(g_x, g_y), covariance=(variance, 0.0, variance), age=age * dt, refused=refused
        )
    return UavReport(
        estimate=(g_x, g_y),
        covariance=(variance, 0.0, variance),
        age=age * dt,
        refused=refused,
        certified=verdict.certified,
        uncertified=verdict.reason[:LONGEST_TEXT],
        intervened=verdict.intervened,
        certified_distance=verdict.distance if math.isfinite(verdict.distance) else None,
    )


class UavPilot:
    """Any of the laws, on the filter's estimate and the UAV's own map. Pure: no input or output of its own.

    Args:
        briefing: What the UAV is told when it joins.
        weighting: A weighting of one's own, for the law `weighted`.
        path: A path of one's own, for the law `path`.
        policy: A policy of one's own, for the laws `policy` and `certified`; it remembers this flight alone.
        policy_name: Of it, in errors.
        inner: A control of one's own, asked once a tick before the law; the safety filter watches over both, whatever
            the law. While it acts the law's own state stands still.

    Raises:
        ScenarioError: If the briefing asks for what cannot be flown, or the user's function is missing or does not fit.
    """

    def __init__(
        self,
        briefing: UavBriefing,
        *,
        weighting: Weighting | None = None,
        path: Path | None = None,
        policy: UavPolicy | None = None,
        policy_name: str = "policy",
        inner: Inner | None = None,
    ) -> None:
        self._briefing = briefing
        self._parameters: LawParameters = law_parameters(briefing, briefing.law)
        self._weighting, self._path, self._inner = weighting, path, inner
        self._policy: PolicyControl | None = None
        if policy is not None:
            self._policy = PolicyControl(briefing, self._parameters, policy, policy_name)
        self._check_own_functions()
        self.coverage: FloatArray = empty_coverage(
            briefing.area.width, briefing.area.height, briefing.area.cell
        )
        """The UAV's own map, built from its own track. Shape (rows, columns)."""
        for region in briefing.covered:
            cover(
                self.coverage,
                region.lower,
                region.upper,
                briefing.area.cell,
                briefing.desired_coverage,
            )
        self.estimator = estimator_of(briefing)
        promise = promise_of(briefing)
        self._promises = records(Promise, [promise])
        self._law_memory = initial_state(), lookahead_memory()
        self._no_guard = guard_state(promise.delay_ticks, depth=1)
        self._sent: deque[Vector] = deque(maxlen=promise.delay_ticks)  # that may be under way
        self.filter: SafetyFilter | None = self._make_filter()
        """The safety filter of the law `certified`, and of an inner control of one's own."""
        self.teller = GroundTeller(briefing)
        """The sender of the ground's blocks."""
        self._tick: int | None = None
        self._radio_ticks = radio_ticks(briefing.dt)
        self._dt = briefing.dt
        c = self._parameters
        self._fixed_error = c.r_o, c.desired, c.cell
        self._looks = LookRows(briefing.dt)
        self._take_on()

    def _take_on(self) -> None:
        """The law and the filter that there are now, as compiled code takes them."""
        guard = self._no_guard if self.filter is None else self.filter.state
        self._asks = self._parameters.law in _OWN
        self._flies_policy = self._parameters.law in _FLIES_POLICY
        self._fixed = (
            records(LawParameters, [self._parameters]),
            self._promises,
            self.filter is not None,
            UavMemory(self.coverage, *self._law_memory, guard),
            *self.estimator.arrays,
        )

    def _make_filter(self) -> SafetyFilter | None:
        return SafetyFilter(self._briefing, sent=self._sent) if self._watched else None

    @property
    def _watched(self) -> bool:
        return self._inner is not None or self._parameters.law in WATCHED

    def _check_own_functions(self) -> None:
        law, limits = self._parameters.law, self._briefing.limits
        if law == POLICY and self._policy is None:
            raise ScenarioError(
                f"law.name = 'policy': needs a policy, given to the UAV as {UAV_POLICY_FORMS}"
            )
        if law == WEIGHTED:
            if self._weighting is None:
                raise ScenarioError(
                    "law.name = 'weighted': needs a weighting, given to the UAV as module:function"
                )
            check_weighting(self._weighting, self._parameters.r_s)
        if law == PATH:
            if self._path is None:
                raise ScenarioError(
                    "law.name = 'path': needs a path, given to the UAV as module:function"
                )
            v_a, u_a = (or_infinite(limits.max_speed), or_infinite(limits.max_acceleration))
            v_g = or_infinite(self._briefing.target_limits.max_speed)
            check_path(self._path, _PATH_HORIZON, self._briefing.visibility_radius, v_a, v_g, u_a)

    def act(self, observation: UavObservation) -> UavCommand:
        """The command for this observation."""
        tick = observation.tick
        if observation.law is not None:
            self._fly(observation.law)
        wanted = None if self._inner is None else self._inner(observation)
        verdict: Verdict | None = None
        if wanted is not None:
            acted = self._take(observation, PERCEIVE)
        elif self._policy is not None and self._flies_policy:
            acted = self._take(observation, PERCEIVE)
            estimate = TargetEstimate(acted[1], acted[2], acted[3], acted[5])
            wanted = self._policy.acceleration(observation, estimate, self.coverage)
        if wanted is not None:
            verdict = None if self.filter is None else self.filter.filter(observation, wanted)
            acceleration = wanted if verdict is None else verdict.acceleration
        else:
            own, part = _NOTHING_OWN, BOTH
            if self._asks:
                acted = self._take(observation, PERCEIVE)
                own, part = self._own_terms(observation, acted), DECIDE
            acted = self._take(observation, part, own)
            u_x, u_y, acts, code, distance = acted[-1]
            acceleration = u_x, u_y
            if self.filter is not None:
                verdict = self.filter.verdict(tick, u_x, u_y, acts, code, distance)
        self._sent.append(acceleration)
        motions = () if verdict is None else verdict.motions
        if not acted[1]:
            return UavCommand(tick=tick, acceleration=acceleration, motions=motions)
        report = _report(acted, self._dt, verdict)
        target = report.estimate
        return UavCommand(
            tick=tick,
            acceleration=acceleration,
            motions=motions,
            radio=() if tick % self._radio_ticks else self._radio(observation, *target),
            blocks=self.teller.blocks(tick, target),
            report=report,
        )

    def forget_commands(self) -> None:
        """The last answers may not have been sent."""
        if self.filter is not None:
            self.filter.forget_commands()

    def perceive(self, observation: UavObservation) -> None:
        """Take an observation into the map and the filters that comes too late to be answered."""
        self._take(observation, PERCEIVE)

    def _take(
        self, observation: UavObservation, parts: int, own: OwnTerms = _NOTHING_OWN
    ) -> _Acted:
        """One part of a tick or both, with the products of matrices that the filter needs on the way."""
        tick, before, estimator = observation.tick, self._tick, self.estimator
        if parts & PERCEIVE:
            if observation.ground:
                self.teller.note(observation.ground)
            if self._policy is not None:
                self._policy.perceive(observation)
            estimator.get_ready(tick)
            self._tick = tick
        looked = 0 if before is None else tick - before
        flown = flown_in(observation)
        seen = looked, tick, flown, *observation.position, *observation.velocity
        rows, count = self._looks.take(observation.detections)
        acted = _act(*self._fixed, own, seen, rows, (count, parts))
        while acted[0] != DONE:
            estimator.work_out(acted[0])
            acted = _act(*self._fixed, own, seen, rows, (count, parts & DECIDE))
        return acted

    def _fly(self, law: Law) -> None:
        """Take another law; map, filter and the state of the law before stay."""
        self._parameters = law_parameters(self._briefing, law)
        self._check_own_functions()
        if self.filter is None or not self._watched:
            self.filter = self._make_filter()
        self._take_on()

    def prepare(self) -> None:
        """Work ahead for the next observation, while the simulator is busy; changes nothing but when it is done."""
        self.estimator.prepare()

    def _own_terms(self, observation: UavObservation, acted: _Acted) -> OwnTerms:
        """The answer of the user's own function at this tick."""
        _, known, g_x, g_y, *_ = acted
        if known and self._weighting is not None and self._parameters.law == WEIGHTED:
            p_x, p_y = observation.position
            alpha, beta = self._weighting(norm(p_x - g_x, p_y - g_y), self._parameters.r_s)
            return OwnTerms(alpha=float(alpha), beta=float(beta))
        if known and self._path is not None and self._parameters.law == PATH:
            (v_x, v_y), (a_x, a_y) = self._path(observation.time)
            return OwnTerms(p_vx=float(v_x), p_vy=float(v_y), a_vx=float(a_x), a_vy=float(a_y))
        return _NOTHING_OWN

    def _radio(
        self, observation: UavObservation, g_x: float, g_y: float
    ) -> tuple[RelativeInformation, ...]:
        p_x, p_y = observation.position
        error = coverage_error(self.coverage, g_x, g_y, *self._fixed_error)
        return (
            RelativeInformation(
                time=observation.time,
                relative_position=(p_x - g_x, p_y - g_y),
                coverage_error=max(0.0, error),
            ),
        )
