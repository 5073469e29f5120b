"""The UAV's pilot: observation in, command out."""

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np

from agents.control.guard import guard_state
from agents.control.laws import (
    PATH,
    WATCHED,
    WEIGHTED,
    LawParameters,
    OwnTerms,
    initial_state,
    law_parameters,
)
from agents.control.lookahead import Target, lookahead_memory
from agents.control.orbit import Path, check_path
from agents.control.promise import Promise
from agents.control.telling import GroundTeller
from agents.control.uav_tick import UavMemory, uav_perceive, uav_tick
from agents.control.visibility import SafetyFilter, Verdict, flown_in, promise_of
from agents.control.weighting import Weighting, check_weighting
from agents.estimation.estimator import Estimate, estimator_of
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
from bus.ticks import Look, looks_of
from sim.kernels.compile import FloatArray, borrowing, entry_point
from sim.kernels.records import RecordArray, records
from sim.models.field import cover, coverage_error, empty_coverage
from sim.models.vehicles import Motion, norm

Inner = Callable[[UavObservation], Vector | None]
"""An inner control of one's own: the acceleration [m/s²] that it wants at this tick; None: the law flies."""

_RADIO_PERIOD = 0.2
"""Time between two radio messages to the UGV [s]."""

_PATH_HORIZON = 600.0
"""The time that a path of one's own is checked ahead [s]: a pilot does not know how long the run will be."""

_NOTHING_OWN = OwnTerms()

_NO_TARGET = Target(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

_NO_LOOKS = np.zeros((0, 3))
_NOWHERE = Motion(0.0, 0.0, 0.0, 0.0)


class _Seen(NamedTuple):
    """An observation, as compiled code takes it."""

    looked: int
    """Ticks for which the ground below has been looked at since the last one."""
    tick: int
    here: Motion
    looks: FloatArray
    """Detections. Shape (rows, 3)."""
    flown: int
    """As in `agents.control.guard.guard`."""


_NOTHING_SEEN = _Seen(0, 0, _NOWHERE, _NO_LOOKS, 0)


@borrowing
def _perceive(
    laws: RecordArray,
    promises: RecordArray,
    guarded: bool,
    memory: UavMemory,
    seen: _Seen,
) -> None:
    law, promise, arrived = laws[0], promises[0], seen.looks.shape[0]
    looked, tick, here, looks = seen.looked, seen.tick, seen.here, seen.looks
    uav_perceive(law, promise, guarded, memory, looked, tick, here, looks, arrived)


@borrowing
def _act(
    laws: RecordArray,
    promises: RecordArray,
    guarded: bool,
    memory: UavMemory,
    seen: _Seen,
    own: OwnTerms,
    target: Target,
) -> tuple[float, float, int, int, float]:
    """Both parts of the tick in one call: handing over the memory costs as much as either of them."""
    _perceive(laws, promises, guarded, memory, seen)
    tick, here = seen.tick, seen.here
    return uav_tick(laws[0], promises[0], guarded, memory, own, tick, here, target, seen.flown)


def radio_ticks(dt: float) -> int:
    """Every how many ticks of this length [s] a UAV radios to its UGV."""
    return max(1, round(_RADIO_PERIOD / dt))


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
        inner: Inner | None = None,
    ) -> None:
        self._briefing = briefing
        self._parameters: LawParameters = law_parameters(briefing, briefing.law)
        self._weighting, self._path, self._inner = weighting, path, inner
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
        self._take_on()
        seen, target = _NOTHING_SEEN, _NO_TARGET
        self._perceive = entry_point(_perceive, *self._fixed, seen)
        self._act = entry_point(_act, *self._fixed, seen, _NOTHING_OWN, target)

    def _take_on(self) -> None:
        """The law and the filter that there are now, as compiled code takes them."""
        guard = self._no_guard if self.filter is None else self.filter.state
        self._fixed = (
            records(LawParameters, [self._parameters]),
            self._promises,
            self.filter is not None,
            UavMemory(self.coverage, *self._law_memory, guard),
        )

    def _make_filter(self) -> SafetyFilter | None:
        return SafetyFilter(self._briefing, sent=self._sent) if self._watched else None

    @property
    def _watched(self) -> bool:
        return self._inner is not None or self._parameters.law in WATCHED

    def _check_own_functions(self) -> None:
        law, limits = self._parameters.law, self._briefing.limits
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
        command = self._answer(observation)
        self._sent.append(command.acceleration)
        return command

    def forget_commands(self) -> None:
        """The last answers may not have been sent."""
        if self.filter is not None:
            self.filter.forget_commands()

    def _answer(self, observation: UavObservation) -> UavCommand:
        if observation.law is not None:
            self._fly(observation.law)
        looks = looks_of(observation.detections, self._briefing.dt)
        estimate = self._estimate(observation, looks)
        target = _NO_TARGET if estimate is None else self._target(estimate)
        seen = self._seen(observation, looks)
        wanted = None if self._inner is None else self._inner(observation)
        verdict: Verdict | None = None
        if wanted is None or self.filter is None:
            own = self._own_terms(observation, estimate)
            acted = self._act(*self._fixed, seen, own, target)
            u_x, u_y = acted[:2]
            if self.filter is not None:
                verdict = self.filter.verdict(observation.tick, *acted)
        else:
            self._perceive(*self._fixed, seen)
            verdict = self.filter.filter(observation, wanted)
            u_x, u_y = verdict.acceleration
        motions = () if verdict is None else verdict.motions
        if estimate is None:
            return UavCommand(tick=observation.tick, acceleration=(u_x, u_y), motions=motions)
        return UavCommand(
            tick=observation.tick,
            acceleration=(u_x, u_y),
            motions=motions,
            radio=self._radio(observation, estimate),
            blocks=self.teller.blocks(observation.tick, estimate.position),
            report=_report(estimate, verdict),
        )

    def perceive(self, observation: UavObservation) -> None:
        """Take an observation into the map and the filters that comes too late to be answered."""
        looks = looks_of(observation.detections, self._briefing.dt)
        self._estimate(observation, looks)
        self._perceive(*self._fixed, self._seen(observation, looks))

    def _estimate(self, observation: UavObservation, looks: tuple[Look, ...]) -> Estimate | None:
        self.teller.note(observation.ground)
        return self.estimator.update(
            tick=observation.tick, own_position=observation.position, looks=looks
        )

    def _target(self, estimate: Estimate) -> Target:
        """The filter's belief, as compiled code takes it."""
        variance = estimate.covariance[0]
        return Target(
            True, *estimate.position, *estimate.velocity, variance, self.estimator.velocity_variance
        )

    def _seen(self, observation: UavObservation, looks: tuple[Look, ...]) -> _Seen:
        """An observation as compiled code takes it."""
        tick, before, rows = observation.tick, self._tick, _NO_LOOKS
        self._tick = tick
        if looks and self.filter is not None:
            rows = np.array(looks, dtype=np.float64)
        here = Motion(*observation.position, *observation.velocity)
        looked = 0 if before is None else tick - before
        return _Seen(looked, tick, here, rows, flown_in(observation))

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

    def _own_terms(self, observation: UavObservation, estimate: Estimate | None) -> OwnTerms:
        """The answer of the user's own function at this tick, if the law asks it."""
        law = self._parameters.law
        if estimate is None:
            return _NOTHING_OWN
        if self._weighting is not None and law == WEIGHTED:
            (p_x, p_y), (g_x, g_y) = observation.position, estimate.position
            alpha, beta = self._weighting(norm(p_x - g_x, p_y - g_y), self._parameters.r_s)
            return OwnTerms(alpha=float(alpha), beta=float(beta))
        if self._path is not None and law == PATH:
            (v_x, v_y), (a_x, a_y) = self._path(observation.time)
            return OwnTerms(p_vx=float(v_x), p_vy=float(v_y), a_vx=float(a_x), a_vy=float(a_y))
        return _NOTHING_OWN

    def _radio(
        self, observation: UavObservation, estimate: Estimate
    ) -> tuple[RelativeInformation, ...]:
        if observation.tick % self._radio_ticks:
            return ()
        c = self._parameters
        (p_x, p_y), (g_x, g_y) = observation.position, estimate.position
        error = coverage_error(self.coverage, g_x, g_y, c.r_o, c.desired, c.cell)
        return (
            RelativeInformation(
                time=observation.time,
                relative_position=(p_x - g_x, p_y - g_y),
                coverage_error=max(0.0, error),
            ),
        )
