r"""Estimator of a pilot: position and velocity of the UGV from relative detections, by filterpy's `KalmanFilter`.

The state is $(x, y, v_x, v_y)$ of the UGV in the world frame, at constant velocity except for random accelerations.
A detection $\tilde p_\Delta$ of $p_\Delta = p_a - p_g$ measures the position, $z = p_a - \tilde p_\Delta$, since the
UAV knows $p_a$ at every tick for which the filter was called.

For a late measurement the estimator restores the state saved before it, and repeats predict and update for all later
ticks. So the estimate depends on which detections have arrived, but not on when.

Deviation: the paper's laws use the true $p_\Delta$. Ours use this estimate.
"""

from collections.abc import Iterable
from typing import NamedTuple

import msgspec
import numpy as np
from filterpy.kalman import KalmanFilter

from agents.estimation.motion_model import (
    SPAN,
    KalmanParameters,
    bounded_scales,
    history_depth,
    kalman_parameters,
)
from agents.uav_parameters import Target
from bus.messages.scenario import Detector, Estimator, Limits
from bus.messages.team import TeamMessage
from bus.messages.vehicle import UavBriefing
from bus.ticks import NO_TICK, DetectionRow
from sim.compiling.compile import FloatArray
from sim.models.vehicles import clip_norm


class Estimate(msgspec.Struct, frozen=True, kw_only=True):
    """Estimate of the UGV in the world frame."""

    position: tuple[float, float]  # [m]
    velocity: tuple[float, float]  # [m/s], at most v_g,max
    covariance: tuple[float, float, float]  # xx, xy, yy of the position [m²]
    age: float  # since the newest accepted measurement [s]
    rejected: int  # detections rejected by the gate (as if all had arrived in order) or with an invalid time


class EstimatorState(NamedTuple):
    """State before the measurement of a tick, restored for a late measurement."""

    x: FloatArray  # position [m] and velocity [m/s]. Shape (4,)
    P: FloatArray  # Shape (4, 4)
    known: bool = False
    age: int = 0  # since the newest accepted measurement [ticks]
    rejected: int = 0
    rejected_in_a_row: int = 0


class _Row(NamedTuple):
    own_position: tuple[float, float]  # p_a [m]
    prior: EstimatorState
    z: tuple[float, float] | None = None  # measured position of the UGV [m]
    received: bool = False  # True if a team-mate measured it


def bound_covariance(
    P: FloatArray, before: EstimatorState, parameters: KalmanParameters
) -> FloatArray:
    """Return a predicted covariance with bounded standard deviations and unchanged correlations.

    Args:
        P: Predicted covariance. Shape (4, 4).
        before: State before the prediction.
        parameters: Parameters of the filter.
    """
    p = parameters
    position, velocity = bounded_scales(
        float(P[0, 0]),
        float(P[2, 2]),
        float(before.P[0, 0]),
        (before.age + 1) * p.dt,
        p.dt,
        p.speed,
        p.acceleration,
    )
    if position == velocity == 1.0:
        return P
    scales = np.array([position, position, velocity, velocity])
    return P * np.outer(scales, scales)


def bound_velocity(x: FloatArray, max_speed: float) -> FloatArray:
    """Return a state with its velocity shortened to the UGV's maximum speed [m/s]."""
    return np.array([x[0], x[1], *clip_norm(float(x[2]), float(x[3]), max_speed)])


class RelativeEstimator:
    """Kalman filter of one UAV for the UGV that it escorts.

    A measurement whose normalized innovation squared exceeds the gate is rejected. After `settings.max_rejections`
    consecutive rejections the filter reinitializes from the last of them.

    Deviation from the plain filter, if the UGV's maximum speed is known: see `bound_velocity` and
    `agents.estimation.motion_model.bounded_scales`.
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
        """Set up the filter; the state is unknown before the first detection.

        Args:
            detector: Detector of the UAV; its noise and truncation determine R.
            target: Limits of the UGV.
            dt: Length of a tick [s].
            settings: Gate, maximum rejections, acceleration share, and whether to filter at all.
            span: Greatest delay of a usable detection [s].

        Raises:
            ValueError: If dt is not positive and finite, or the span is negative.
        """
        p = kalman_parameters(detector=detector, target=target, dt=dt, settings=settings)
        kalman = KalmanFilter(dim_x=4, dim_z=2)
        kalman.F, kalman.H = np.eye(4) + p.dt * np.eye(4, k=2), np.eye(2, 4)
        kalman.Q = np.kron([[p.q_pp, p.q_pv], [p.q_pv, p.q_vv]], np.eye(2))
        kalman.R = p.variance * np.eye(2)
        self._parameters, self._kalman = p, kalman
        self._state = EstimatorState(np.zeros(4), np.zeros((4, 4)))
        self._depth, self._tick, self._history = history_depth(span, dt), -1, dict[int, _Row]()
        self.innovation_squared: float | None = None
        """Normalized innovation squared (NIS) of the newest measurement compared with the gate; None before."""
        self.duplicates = 0
        """Detections ignored because the same detection was stored before."""
        self.too_old = 0
        """Detections dropped because they arrived later than the span allows."""
        self.misdated = 0
        """Detections with an invalid time, or in contradiction to an earlier detection of the same tick."""

    @property
    def state(self) -> FloatArray:
        """Position [m] and velocity [m/s] of the UGV, x before y; meaningless before the first detection."""
        return self._state.x.copy()

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the state. Shape (4, 4)."""
        return self._state.P.copy()

    @property
    def age(self) -> int:
        """Ticks since the newest accepted measurement."""
        return self._state.age

    @property
    def target(self) -> Target:
        """Estimate in the form that the laws read."""
        s = self._state
        x, y, v_x, v_y = s.x.tolist()
        return Target(s.known, x, y, v_x, v_y, s.P.item(0, 0), s.P.item(2, 2))

    def update(
        self,
        *,
        tick: int,
        own_position: tuple[float, float],
        detections: Iterable[DetectionRow],
        received: Iterable[TeamMessage] = (),
    ) -> Estimate | None:
        """Advance to a tick and use the detections that have arrived, each at its own tick.

        Args:
            tick: Current tick, not before the last call.
            own_position: Current p_a [m].
            detections: Detections received since the last call, in any order. Of several in one tick, only the first is
                used.
            received: Messages of team-mates, whose measurements are used for ticks without an own detection.

        Returns:
            The estimate, or None before the first detection.

        Raises:
            ValueError: If the tick is before the one of the last call.
        """
        if tick < self._tick:
            raise ValueError(f"tick = {tick}: before the last one; allowed: {self._tick} or later")
        if tick > self._tick:
            self._predict(tick - self._tick if self._history else 0)
            self._tick, self._history[tick] = tick, _Row(own_position, self._state)
            while (oldest := next(iter(self._history))) <= tick - self._depth:
                del self._history[oldest]
        new = [detection.taken for detection in detections if self._insert(detection)]
        new += [taken for one in received if (taken := self._insert_received(one)) is not None]
        if new:
            self._repeat(min(new))
        return self._estimate()

    def _estimate(self) -> Estimate | None:
        s = self._state
        if not s.known:
            return None
        x, y, v_x, v_y = s.x.tolist()
        return Estimate(
            position=(x, y),
            velocity=(v_x, v_y),
            covariance=(s.P.item(0, 0), s.P.item(0, 1), s.P.item(1, 1)),
            age=s.age * self._parameters.dt,
            rejected=s.rejected + self.misdated,
        )

    def _insert(self, detection: DetectionRow) -> bool:
        """Store a measurement at its tick; return False if it is unusable."""
        row = self._history.get(detection.taken)
        if row is None:
            too_old = detection.taken != NO_TICK and detection.taken <= self._tick - self._depth
            self.too_old, self.misdated = self.too_old + too_old, self.misdated + (not too_old)
            return False
        z = row.own_position[0] - detection.x, row.own_position[1] - detection.y
        if row.z is not None and not row.received:
            same = detection.taken == self._tick or row.z == z
            self.duplicates, self.misdated = self.duplicates + same, self.misdated + (not same)
            return False
        self._history[detection.taken] = row._replace(z=z, received=False)
        return True

    def _insert_received(self, message: TeamMessage) -> int | None:
        """Store a team-mate's measurement; return its tick, or None if it is unusable or that tick has one."""
        taken = message.measured
        row = None if taken is None else self._history.get(taken)
        if taken is None or row is None or row.z is not None:
            return None
        self._history[taken] = row._replace(z=message.measurement, received=True)
        return taken

    def _repeat(self, first: int) -> None:
        """Restore the state before a tick, and repeat predict and update for all later ticks."""
        self._state, at = self._history[first].prior, first
        for tick in (tick for tick in range(first, self._tick + 1) if tick in self._history):
            self._predict(tick - at)
            row, at = self._history[tick], tick
            self._history[tick] = row._replace(prior=self._state)
            if row.z is not None:
                self._correct(row.z)

    def _predict(self, ticks: int) -> None:
        for _ in range(ticks):
            s, p, kalman = self._state, self._parameters, self._kalman
            if s.known and p.enabled:
                kalman.x, kalman.P = s.x, s.P
                kalman.predict()
                s = s._replace(x=kalman.x, P=bound_covariance(kalman.P, s, p))
            self._state = s._replace(age=s.age + 1)

    def _correct(self, z: tuple[float, float]) -> None:
        """Update by a measured position [m], reject it by the gate, or reinitialize from it."""
        s, p, kalman = self._state, self._parameters, self._kalman
        if s.known and p.enabled:
            nu = np.array(z) - s.x[:2]
            self.innovation_squared = float(nu @ nu / (s.P[0, 0] + p.variance))
            if self.innovation_squared <= p.gate:
                kalman.x, kalman.P = s.x, s.P
                kalman.update(np.array(z))
                x = bound_velocity(kalman.x, p.speed)
                self._state = s._replace(x=x, P=kalman.P, age=0, rejected_in_a_row=0)
                return
            in_a_row = s.rejected_in_a_row + 1
            s = s._replace(rejected=s.rejected + 1, rejected_in_a_row=in_a_row)
        if not s.known or not p.enabled or s.rejected_in_a_row >= p.max_rejections:
            P = np.diag([p.variance, p.variance, p.first_variance, p.first_variance])
            x = np.array([*z, 0.0, 0.0])
            s = s._replace(x=x, P=P, known=True, age=0, rejected_in_a_row=0)
        self._state = s


def estimator_of(briefing: UavBriefing) -> RelativeEstimator:
    """Return the estimator of a UAV with this briefing."""
    return RelativeEstimator(
        detector=briefing.detector,
        target=briefing.target_limits,
        dt=briefing.dt,
        settings=briefing.estimator,
    )
