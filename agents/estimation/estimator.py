r"""The UAV's Kalman filter: where the UGV is and how fast, from relative detections alone.

How detections are taken up is compiled (`agents.estimation.filtering`); the products of matrices are filterpy's
(`agents.estimation.kalman`).

Deviation: the paper's laws see the true $p_\Delta$. Ours see this estimate, never the truth.
"""

import math
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np

from agents.estimation.filtering import (
    DONE,
    NEVER,
    PREDICT,
    KalmanState,
    kalman_begin,
    kalman_go_on,
    kalman_state,
)
from agents.estimation.kalman import AxisFilter
from agents.estimation.motion_model import KalmanParameters, kalman_parameters, motion
from bus.messages import Detector, Estimator, Limits, UavBriefing
from bus.ticks import Look, ticks_within
from sim.kernels.compile import FloatArray, compiled
from sim.kernels.records import RecordArray, records

SPAN = 60.0
"""The largest delay of a detection that is still used, by default [s]."""

_MOST_TICKS = 100_000  # about 16 MB; where ticks are so short that the span has more, it is cut


_KEPT = ("arrays", "_numbers", "_tick", "_is_ahead", "_motions")
"""The attributes that a copy of a filter takes over; it makes views of its own."""


class Estimate(msgspec.Struct, frozen=True, kw_only=True):
    """The UAV's belief about the UGV, in the world frame."""

    position: tuple[float, float]  # [m]
    velocity: tuple[float, float]  # [m/s], never longer than v_g,max
    covariance: tuple[float, float, float]  # xx, xy, yy of the position [m²]
    age: float  # since the newest believed detection [s]
    refused: int  # detections, by the gate (as if all had come in order) or for the wrong time


def _view(row: RecordArray, first: str, shape: tuple[int, ...]) -> FloatArray:
    """The numbers of a record from this field on, in this shape: a view."""
    fields: Any = row.dtype.fields
    return np.ndarray(shape, np.float64, buffer=row.data, offset=fields[first][1])


@compiled
def _update(
    parameters: RecordArray,
    state: KalmanState,
    tick: int,
    p_ax: float,
    p_ay: float,
    looks: FloatArray,
    count: int,
) -> int:
    kalman_begin(state, tick, p_ax, p_ay, looks, count)
    return kalman_go_on(parameters[0], state)


@compiled
def _go_on(parameters: RecordArray, state: KalmanState) -> int:
    return kalman_go_on(parameters[0], state)


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
        if not span >= 0.0:
            raise ValueError(f"span must not be negative, but is {span}")
        late = _MOST_TICKS if span / dt > _MOST_TICKS else ticks_within(span, dt)
        self.arrays = records(KalmanParameters, [c]), kalman_state(late + 1)
        """Parameters and state, for compiled functions."""
        self._numbers, self._tick, self._is_ahead = c, NEVER, False
        self._motions = {1: motion(ticks=1, dt=dt, deviation=c.deviation)}
        self._bind()

    def _bind(self) -> None:
        """Name parts of the arrays: views, through which filterpy and the compiled functions write into one memory."""
        _, state = self.arrays
        self._belief, self._counts, self._step = state.belief[0], state.counts[0], state.step[0]
        self._mean = _view(state.belief, "x", (4,))
        self._filter = AxisFilter(
            variance=self._numbers.variance,
            P=_view(state.belief, "p_pp", (2, 2)),
            P_prior=_view(state.step, "prior_pp", (2, 2)),
            P_post=_view(state.step, "post_pp", (2, 2)),
            K=_view(state.step, "k_p", (2, 1)),
        )
        self._known = state.belief["known"]
        flags = (state.step[name] for name in ("ticks", "predicted", "weighed"))
        self._ticks, self._predicted, self._weighed = flags

    def __getstate__(self) -> dict[str, Any]:
        return {name: self.__dict__[name] for name in _KEPT}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__dict__.update(kept)
        self._bind()

    @property
    def state(self) -> FloatArray:
        """Position [m] and velocity [m/s] of the UGV, x before y; meaningless before the first detection."""
        return self._mean.copy()

    @property
    def covariance(self) -> FloatArray:
        """The 4 x 4 covariance of the state."""
        return np.asarray(np.kron(self._filter.P, np.eye(2)), dtype=np.float64)

    @property
    def innovation_squared(self) -> float | None:
        """Normalized innovation squared (NIS) of the newest detection that met the gate; None before."""
        squared = float(self._step.innovation)
        return None if math.isnan(squared) else squared

    @property
    def duplicates(self) -> int:
        """Detections ignored so far because that of their tick was there."""
        return int(self._counts.duplicates)

    @property
    def too_old(self) -> int:
        """Detections dropped so far because they came later than the span allows."""
        return int(self._counts.too_old)

    def update(
        self, *, tick: int, own_position: tuple[float, float], looks: Iterable[Look]
    ) -> Estimate | None:
        """Move on to a tick and take up what has arrived, each detection at its own tick.

        Args:
            tick: Now, the same as in the last call or later.
            own_position: p_a now [m].
            looks: What has arrived since the last call, in any order; see `agents.estimation.filtering.kalman_begin`.

        Returns:
            The estimate, or None where nothing was ever detected.

        Raises:
            ValueError: If the tick is before that of the last call.
        """
        self.get_ready(tick)
        rows = np.array([*looks], dtype=np.float64).reshape(-1, len(Look._fields))
        needs = _update(*self.arrays, tick, *own_position, rows, len(rows))
        while needs != DONE:
            self.work_out(needs)
            needs = _go_on(*self.arrays)
        if not self._known.item(0):
            return None
        x, y, v_x, v_y = self._mean.tolist()
        variance, belief = self._filter.P.item(0), self._belief
        return Estimate(
            position=(x, y),
            velocity=(v_x, v_y),
            covariance=(variance, 0.0, variance),
            age=int(belief.age) * self._numbers.dt,
            refused=int(belief.by_gate + self._counts.misdated),
        )

    def get_ready(self, tick: int) -> None:
        """A compiled function is about to step the filter to a tick: what that is likely to need is worked out.

        Raises:
            ValueError: If the tick is before that of the last step.
        """
        if tick < self._tick:
            raise ValueError(f"tick = {tick}: is before the last one, {self._tick}")
        if tick > self._tick:
            self.prepare()
        self._tick, self._is_ahead = tick, False

    def prepare(self) -> None:
        """Work ahead to the next tick, while nobody waits; it changes no estimate, only when it is there.

        Neither the prediction nor the gain depends on what will be detected.
        """
        if self._is_ahead or not self._numbers.enabled or not self._known.item(0):
            return
        self._is_ahead = True
        kalman, (F, Q) = self._filter, self._motions[1]
        kalman.predict(F, Q)
        kalman.weigh(kalman.P_prior)
        self._ticks[0], self._predicted[0], self._weighed[0] = 1, True, True

    def work_out(self, needs: int) -> None:
        """Put what a step needs (`agents.estimation.filtering.kalman_go_on`) into `arrays`."""
        if needs == PREDICT:
            ticks = self._ticks.item(0)
            matrices = self._motions.get(ticks)
            if matrices is None:
                numbers = self._numbers
                matrices = motion(ticks=ticks, dt=numbers.dt, deviation=numbers.deviation)
                self._motions[ticks] = matrices
            self._filter.predict(*matrices)
            self._predicted[0] = True
        else:
            self._filter.weigh(self._filter.P)
            self._weighed[0] = True


def estimator_of(briefing: UavBriefing) -> RelativeEstimator:
    """The filter of one UAV on what it is told."""
    return RelativeEstimator(
        detector=briefing.detector,
        target=briefing.target_limits,
        dt=briefing.dt,
        settings=briefing.estimator,
    )
