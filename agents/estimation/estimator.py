r"""The UAV's Kalman filter: where the UGV is and how fast, from relative detections alone.

The state is $(x, y, v_x, v_y)$ of the UGV in the world frame, moving at constant velocity but for random accelerations.
The UAV knows its own position exactly, so a detection $\tilde p_\Delta$ of $p_\Delta = p_a - p_g$ measures the UGV's
position: $z = p_a - \tilde p_\Delta$. The equations are filterpy's; here is what feeds them.

A detection may come late and out of order. It counts at its own time: the filter goes back to what it believed before
then, takes it up, and runs again through all that was detected since. So what it believes depends on which detections
have arrived, not on when: the same bits as if all had come in order.

Deviation: the paper's laws see the true $p_\Delta$. Ours see this estimate, never the truth.
"""

import math
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np

from agents.estimation.kalman import BareFilter
from agents.estimation.motion_model import (
    SURE,
    kalman_parameters,
    motion,
    strayed_distance,
)
from agents.estimation.past import SPAN, FilterHistory, PastTick
from bus.messages import Detector, Estimator, Limits, UavBriefing
from bus.ticks import NO_TICK, Look
from sim.kernels.compile import FloatArray
from sim.models.vehicles import clip_norm


class Estimate(msgspec.Struct, frozen=True, kw_only=True):
    """The UAV's belief about the UGV, in the world frame."""

    position: tuple[float, float]  # [m]
    velocity: tuple[float, float]  # [m/s], never longer than v_g,max
    covariance: tuple[float, float, float]  # xx, xy, yy of the position [m²]
    age: float  # since the newest believed detection [s]
    refused: int  # detections, by the gate (as if all had come in order) or for the wrong time


class RelativeEstimator:
    """The filter of one UAV on the UGV it escorts.

    Detections whose normalized innovation squared is beyond the gate are refused. After `settings.patience` refusals
    in a row the filter starts anew from the last of them.

    Deviation from the plain filter, where the UGV's largest speed is known: the velocity is never believed longer than
    v_g,max; its standard deviation per axis never larger than v_g,max; and that of the position never grows faster than
    at v_g,max. While nothing is believed for long, that of the position is never smaller than 1/√8 of how far the UGV
    can have strayed from its course: one that turned round comes to a NEES of 8, no more, and is let in again. Without
    this the covariance forgets the speed that the mean goes on at: NEES 16 after 2 minutes, refused soon after. The
    deviations are scaled, the correlations stay, so the covariance stays one.

    F, Q, R and the first covariance are alike in x and y, and so P stays: one axis stands for both where it is capped.
    """

    def __init__(
        self,
        *,
        detector: Detector,
        target: Limits,
        dt: float,
        settings: Estimator,
        span: float = SPAN,
    ) -> None:
        """Prepare the filter; it believes nothing until the first detection.

        Args:
            detector: The UAV's detector; its noise and cut make R.
            target: The UGV's bounds.
            dt: Length of a tick [s].
            settings: Gate, patience, manoeuvre, and whether to filter at all.
            span: How late a detection may come and still be used [s].

        Raises:
            ValueError: If dt is not positive and finite, or the span is negative.
        """
        c = kalman_parameters(detector=detector, target=target, dt=dt, settings=settings)
        self._parameters = c
        self._motions: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._first_covariance = np.diag(
            [c.variance, c.variance, c.first_variance, c.first_variance]
        )
        self._filter: Any = BareFilter(dim_x=4, dim_z=2)
        self._filter.x = np.zeros(4)
        self._filter.P = self._first_covariance.copy()
        self._filter.H = np.eye(2, 4)
        self._filter.R = c.variance * np.eye(2)
        # Gain, and covariance after it, for a detection at this tick; and before them x and P for the next one.
        self._weighed: tuple[list[float], FloatArray] | None = None
        self._ahead: tuple[FloatArray, FloatArray, tuple[list[float], FloatArray]] | None = None
        self._history = FilterHistory(span=span, dt=dt)
        self._now: PastTick | None = None  # None: never called
        self._age: int | None = None  # ticks; None: nothing was ever believed
        self._refused = 0  # by the gate
        self._refused_in_a_row = 0
        self._innovation_squared: float | None = None
        self._misdated = self._duplicates = self._too_old = 0

    @property
    def state(self) -> FloatArray:
        """Position [m] and velocity [m/s] of the UGV, x before y; meaningless before the first detection."""
        state: FloatArray = self._filter.x.copy()
        return state

    @property
    def covariance(self) -> FloatArray:
        """The 4 x 4 covariance of the state."""
        covariance: FloatArray = self._filter.P.copy()
        return covariance

    @property
    def velocity_variance(self) -> float:
        """Of the velocity, per axis [m²/s²]; meaningless before the first detection."""
        variance: float = self._filter.P.item(10)
        return variance

    @property
    def innovation_squared(self) -> float | None:
        """Normalized innovation squared (NIS) of the newest detection that met the gate; None before."""
        return self._innovation_squared

    @property
    def duplicates(self) -> int:
        """Detections ignored so far because that of their tick was there."""
        return self._duplicates

    @property
    def too_old(self) -> int:
        """Detections dropped so far because they came later than the span allows."""
        return self._too_old

    def update(
        self, *, tick: int, own_position: tuple[float, float], looks: Iterable[Look]
    ) -> Estimate | None:
        """Move on to a tick and take up what has arrived, each detection at its own tick.

        Of several detections of one tick only the first is used, also over several calls. What cannot be placed
        counts as refused: a detection of the future, or of a time at which the filter was not called, so that p_a is
        not known, or whose time is that of no tick, or one that comes late and contradicts that of its tick.

        Args:
            tick: Now, the same as in the last call or later.
            own_position: p_a now [m].
            looks: What has arrived since the last call, in any order.

        Returns:
            The estimate, or None where nothing was ever detected.

        Raises:
            ValueError: If the tick is before that of the last call.
        """
        now = self._advance(tick, own_position)
        first: PastTick | None = None  # the earliest at which something is new
        for look in looks:
            moment = now if look.taken == tick else self._past(tick, look.taken)
            if (
                moment is not None
                and self._is_new(now, moment, look)
                and (first is None or moment.tick < first.tick)
            ):
                first = moment
        if first is now:
            self._look(now)
        elif first is not None:
            self._run_again(first)
        return self._estimate()

    def _advance(self, tick: int, own_position: tuple[float, float]) -> PastTick:
        """Predict over the ticks since the last call."""
        last = self._now
        elapsed = 0 if last is None else tick - last.tick
        if elapsed < 0:
            raise ValueError(f"tick = {tick}: is before the last one, {tick - elapsed}")
        if last is not None and not elapsed:
            last.own_position = own_position
            return last
        self._coast(elapsed)
        now = self._now = PastTick(
            tick=tick,
            own_position=own_position,
            x=self._filter.x,
            P=self._filter.P,
            age=self._age,
            refused=self._refused,
            refused_in_a_row=self._refused_in_a_row,
        )
        self._history.add(now)
        return now

    def _coast(self, ticks: int) -> None:
        """Grow older by so many ticks without a detection."""
        if self._age is not None:
            self._age += ticks
            if ticks and self._parameters.enabled:
                self._predict(ticks, self._age)

    def _past(self, tick: int, taken: int) -> PastTick | None:
        """The moment at which a detection was taken; None, and counted, where there is none to be had."""
        if taken != NO_TICK and tick - taken > self._history.ticks:
            self._too_old += 1
            return None
        moment = self._history.find(taken)
        if moment is None:
            self._misdated += 1
        return moment

    def _is_new(self, now: PastTick, moment: PastTick, look: Look) -> bool:
        """Put a detection into its moment, unless there is one."""
        p_x, p_y = moment.own_position
        seen = (p_x - look.x, p_y - look.y)
        if moment.seen is None:
            moment.seen = seen
            return True
        if moment is now or moment.seen == seen:
            self._duplicates += 1
        else:
            self._misdated += 1  # it was not taken then: another one was
        return False

    def _run_again(self, first: PastTick) -> None:
        """Go back to before `first` and run again through all that was detected since.

        `innovation_squared` needs no way back: whatever has met the gate meets it again.
        """
        self._ahead = self._weighed = None
        self._filter.x, self._filter.P, self._age = first.x, first.P, first.age
        self._refused, self._refused_in_a_row = first.refused, first.refused_in_a_row
        self._look(first)
        tick = first.tick
        for moment in self._history.after(first):
            self._coast(moment.tick - tick)
            tick = moment.tick
            moment.x, moment.P, moment.age = self._filter.x, self._filter.P, self._age
            moment.refused, moment.refused_in_a_row = self._refused, self._refused_in_a_row
            self._look(moment)

    def _look(self, moment: PastTick) -> None:
        """Take up what was detected at this moment, if anything was."""
        if moment.seen is not None:
            self._take(*moment.seen)

    def prepare(self) -> None:
        """Work ahead to the next tick, while nobody waits; it changes no estimate, only when it is there.

        Neither the prediction nor the gain depends on what will be detected.
        """
        if self._age is None or not self._parameters.enabled or self._ahead is not None:
            return
        posterior = (self._filter.x, self._filter.P)
        self._predict(1, self._age + 1)
        self._ahead = (self._filter.x, self._filter.P, self._filter.weigh())
        self._filter.x, self._filter.P = posterior

    def _predict(self, ticks: int, age: int) -> None:
        """Go on by so many ticks; then the newest believed detection is `age` ticks old."""
        ahead, self._ahead, self._weighed = self._ahead, None, None
        if ahead is not None and ticks == 1:
            self._filter.x, self._filter.P, self._weighed = ahead
            return
        c, matrices = self._parameters, self._motions.get(ticks)
        if matrices is None:
            matrices = self._motions[ticks] = motion(ticks=ticks, dt=c.dt, deviation=c.deviation)
        before = self._filter.P.item(0)
        self._filter.predict(*matrices)
        if c.speed < math.inf:
            strayed = strayed_distance(age * c.dt, c.speed, c.acceleration)
            self._bound(least=SURE * strayed, most=math.sqrt(before) + c.speed * ticks * c.dt)

    def _bound(self, *, least: float, most: float) -> None:
        """Keep the standard deviations per axis within bounds: the position's [m], and the velocity's up to v_g,max."""
        position = math.sqrt(self._filter.P.item(0))
        velocity, speed = math.sqrt(self._filter.P.item(10)), self._parameters.speed
        if not least <= position <= most or velocity > speed:
            p, v = min(max(least, position), most) / position, min(1.0, speed / velocity)
            scale = np.array([p, p, v, v])
            self._filter.P = self._filter.P * np.outer(scale, scale)

    def _take(self, x: float, y: float) -> None:
        """Believe or refuse a detection of the UGV at (x, y) [m]."""
        if not self._parameters.enabled or self._age is None:
            self._start(x, y)
        elif self._is_believable(x, y):
            self._correct(x, y)
        else:
            self._refused += 1
            self._refused_in_a_row += 1
            if self._refused_in_a_row >= self._parameters.patience:
                self._start(x, y)

    def _start(self, x: float, y: float) -> None:
        self._ahead = self._weighed = None
        self._filter.x = np.array([x, y, 0.0, 0.0])
        self._filter.P = self._first_covariance.copy()
        self._age = 0
        self._refused_in_a_row = 0

    def _is_believable(self, x: float, y: float) -> bool:
        r"""True if $\nu^T S^{-1} \nu$ is within the gate, $\nu = z - H\hat x$, $S = H P H^T + R$."""
        state, P, c = self._filter.x, self._filter.P, self._parameters
        nu_x, nu_y = x - state.item(0), y - state.item(1)
        s_xx, s_xy, s_yy = P.item(0) + c.variance, P.item(1), P.item(5) + c.variance
        determinant = s_xx * s_yy - s_xy * s_xy
        squared: float = (
            s_yy * nu_x * nu_x - 2.0 * s_xy * nu_x * nu_y + s_xx * nu_y * nu_y
        ) / determinant
        self._innovation_squared = squared
        return squared <= c.gate

    def _correct(self, x: float, y: float) -> None:
        K, covariance = self._weighed or self._filter.weigh()
        p_x, p_y, v_x, v_y = self._filter.x.tolist()
        nu_x, nu_y = x - p_x, y - p_y
        v_x, v_y = clip_norm(
            v_x + K[4] * nu_x + K[5] * nu_y,
            v_y + K[6] * nu_x + K[7] * nu_y,
            self._parameters.speed,
        )
        self._filter.x = np.array(
            [p_x + K[0] * nu_x + K[1] * nu_y, p_y + K[2] * nu_x + K[3] * nu_y, v_x, v_y]
        )
        self._filter.P = covariance
        self._ahead = None
        self._age = 0
        self._refused_in_a_row = 0

    def _estimate(self) -> Estimate | None:
        if self._age is None:
            return None
        x, y, v_x, v_y = self._filter.x.tolist()
        P = self._filter.P
        return Estimate(
            position=(x, y),
            velocity=(v_x, v_y),
            covariance=(P.item(0), P.item(1), P.item(5)),
            age=self._age * self._parameters.dt,
            refused=self._refused + self._misdated,
        )


def estimator_of(briefing: UavBriefing) -> RelativeEstimator:
    """The filter of one UAV on what it is told."""
    return RelativeEstimator(
        detector=briefing.detector,
        target=briefing.target_limits,
        dt=briefing.dt,
        settings=briefing.estimator,
    )
