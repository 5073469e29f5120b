"""The UAV's pilot: observation in, command out."""

import math
from collections import deque
from collections.abc import Callable

import msgspec

from agents.control.guard import guard_state
from agents.control.laws import (
    LOOKAHEAD,
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
from agents.estimation.estimator import Estimate, estimator_of
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
from bus.registry import LAWS
from bus.ticks import looks_of, radio_ticks
from sim.kernels.compile import FloatArray
from sim.kernels.records import records
from sim.models.field import cover, coverage_error, empty_coverage
from sim.models.vehicles import Motion, norm

Inner = Callable[[UavObservation], Vector | None]
"""An inner control of one's own: the acceleration [m/s²] that it wants at this tick; None: the law flies."""

_PATH_HORIZON = 600.0
"""The time that a path of one's own is checked ahead [s]: a pilot does not know how long the run will be."""

_NOTHING_OWN = OwnTerms()

_FLIES_POLICY = frozenset(row.code for row in LAWS.values() if "uav_policy" in (row.own, row.inner))
"""Codes of the laws under which a policy flies."""


def _report(estimate: Estimate, verdict: Verdict | None) -> UavReport:
    report = UavReport(
        estimate=estimate.position,
        covariance=estimate.covariance,
        age=estimate.age,
        refused=estimate.refused,
    )
    if verdict is None:
        return report
    return msgspec.structs.replace(
        report,
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
        (self._promise,) = records(Promise, [promise])
        self._law_memory, self._lookahead_memory = initial_state(), lookahead_memory()
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
        self._estimate: Estimate | None = None
        self._take_on()

    def _take_on(self) -> None:
        """Prepare the arguments of compiled code for the present law and safety filter."""
        guard = self._no_guard if self.filter is None else self.filter.state
        self._flies_policy = self._parameters.law in _FLIES_POLICY
        self._lookahead = self._lookahead_memory if self._parameters.law == LOOKAHEAD else None
        self._fixed = (
            records(LawParameters, [self._parameters])[0],
            self._promise,
            self.filter is not None,
            UavMemory(self.coverage, self._law_memory, guard),
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
                "law.name = 'policy': needs a policy, given to the UAV as module:function or KIND:FILE"
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
        self.perceive(observation)
        estimate = self._estimate
        if wanted is None and self._policy is not None and self._flies_policy:
            wanted = self._policy.acceleration(observation, self._policy_estimate(), self.coverage)
        verdict: Verdict | None = None
        if wanted is not None:
            verdict = None if self.filter is None else self.filter.filter(observation, wanted)
            acceleration = wanted if verdict is None else verdict.acceleration
        else:
            here = Motion(*observation.position, *observation.velocity)
            own, target = self._own_terms(observation), self.estimator.target
            u_x, u_y, acts, code, distance = uav_tick(
                *self._fixed, self._lookahead, own, tick, here, target, flown_in(observation)
            )
            acceleration = u_x, u_y
            if self.filter is not None:
                verdict = self.filter.verdict(tick, u_x, u_y, acts, code, distance)
        self._sent.append(acceleration)
        motions = () if verdict is None else verdict.motions
        if estimate is None:
            return UavCommand(tick=tick, acceleration=acceleration, motions=motions)
        target_position = estimate.position
        return UavCommand(
            tick=tick,
            acceleration=acceleration,
            motions=motions,
            radio=() if tick % self._radio_ticks else self._radio(observation, *target_position),
            blocks=self.teller.blocks(tick, target_position),
            report=_report(estimate, verdict),
        )

    def forget_commands(self) -> None:
        """The last answers may not have been sent."""
        if self.filter is not None:
            self.filter.forget_commands()

    def perceive(self, observation: UavObservation) -> None:
        """Update map, estimator and safety filter, also by an observation that comes too late to be answered."""
        tick, before, dt = observation.tick, self._tick, self._dt
        if observation.ground:
            self.teller.note(observation.ground)
        if self._policy is not None:
            self._policy.perceive(observation)
        self._estimate = self.estimator.update(
            tick=tick, own_position=observation.position, looks=looks_of(observation.detections, dt)
        )
        self._tick = tick
        looked = 0 if before is None else tick - before
        here = Motion(*observation.position, *observation.velocity)
        rows, count = self._looks.take(observation.detections)
        uav_perceive(*self._fixed, looked, tick, here, rows, count)

    def _fly(self, law: Law) -> None:
        """Take another law; map, filter and the state of the law before stay."""
        self._parameters = law_parameters(self._briefing, law)
        self._check_own_functions()
        if self.filter is None or not self._watched:
            self.filter = self._make_filter()
        self._take_on()

    def _policy_estimate(self) -> TargetEstimate:
        s = self.estimator.target
        return TargetEstimate(s.known, s.p_x, s.p_y, self.estimator.age)

    def _own_terms(self, observation: UavObservation) -> OwnTerms:
        """Return the answer of the user's own function at this tick, if the law asks one."""
        target = self.estimator.target
        if not target.known:
            return _NOTHING_OWN
        if self._weighting is not None and self._parameters.law == WEIGHTED:
            p_x, p_y = observation.position
            distance = norm(p_x - target.p_x, p_y - target.p_y)
            alpha, beta = self._weighting(distance, self._parameters.r_s)
            return OwnTerms(alpha=float(alpha), beta=float(beta))
        if self._path is not None and self._parameters.law == PATH:
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
