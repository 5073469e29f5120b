r"""The UAV's Kalman filter: where the UGV is and how fast, from relative detections alone.

The state is $(x, y, v_x, v_y)$ of the UGV in the world frame, moving at constant velocity but for random accelerations.
The UAV knows its own position exactly, so a detection $\tilde p_\Delta$ of $p_\Delta = p_a - p_g$ measures the UGV's
position: $z = p_a - \tilde p_\Delta$. The equations are filterpy's; here is what feeds them.

Deviation: the paper's laws see the true $p_\Delta$. Ours see this estimate, never the truth.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter

from bus.messages import Detection, Detector, Estimator, Limits
from sim.compile import FloatArray
from sim.vehicles import clip_norm

_SAME_TIME = 1e-9  # [s], two times nearer than this are one
_VARIANCE_FLOOR = 1e-12  # [m²], (1 µm)²: a detector without noise must not make S singular
_TIRE_LIMIT = 9.81  # [m/s²], what tires on the ground can give; where neither of the UGV's bounds is known
_HOLD = 1.0  # [s], how long an acceleration lasts where the largest speed is not known
_FREE_SPEED = 10.0  # [m/s], deviation of the first velocity per axis where the largest speed is not known


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """What the UAV believes of the UGV, in the world frame."""

    position: tuple[float, float]  # [m]
    velocity: tuple[float, float]  # [m/s], never longer than v_g,max
    covariance: tuple[float, float, float]  # xx, xy, yy of the position [m²]
    age: float  # since the newest believed detection [s]
    refused: int  # detections refused so far, by the gate or for the wrong time


def cut_variance(*, sigma: float, cut: float | None) -> float:
    r"""Variance per axis of a Gaussian vector in the plane whose norm is cut at $k$ standard deviations.

    $$ \sigma^2 \left[ 1 - \frac{(k^2/2)\, e^{-k^2/2}}{1 - e^{-k^2/2}} \right]
       = \sigma^2 \left[ 1 - \frac{h}{e^h - 1} \right], \quad h = k^2/2 $$

    Half of $E\|n\|^2$, with the Rayleigh density of the norm cut at $k\sigma$. For small $k$ it is that of a uniform
    disc, $(k\sigma)^2/4$; at $k = 3$ it is 0.949 σ².

    Args:
        sigma: Standard deviation per axis before the cut [m].
        cut: k; None where the noise is not cut.

    Returns:
        The variance per axis [m²].
    """
    h = math.inf if cut is None else 0.5 * cut * cut
    if h > 700.0:  # e^h is beyond floating point, and the cut beyond any draw
        return sigma * sigma
    if h < 1e-4:  # the series, where the difference loses its digits
        return sigma * sigma * h * (0.5 - h / 12.0)
    return sigma * sigma * (1.0 - h / math.expm1(h))


def acceleration_deviation(*, target: Limits, manoeuvre: float, dt: float) -> float:
    r"""Standard deviation per axis of the UGV's random acceleration, drawn anew at each tick and held over it.

    $$ \sigma_u = m\, u_{g,max} \sqrt{T/dt}, \qquad T = \max(dt,\ \tfrac12 v_{g,max}/u_{g,max}) $$

    A real UGV does not draw its acceleration anew at each tick: it brakes and gathers speed for up to
    $v_{g,max}/u_{g,max}$, half of that on average. Noise of deviation $m\,u_{g,max}$ held for T has the same density as
    noise held for one tick and larger by the root, so the filter does not depend on how finely time is cut.

    Deviation: without the root (T = dt) a UGV that stops at its corners gives an average NEES of 9 on legs of 1 to 8 m
    and 37 on legs below 1 m, where 4 is consistent, because the filter is too sure of itself; with it 2.5 and 3.2.

    Where a bound is missing: without $u_{g,max}$ the UGV may change its velocity by $v_{g,max}$ within a tick,
    $u_{g,max} = v_{g,max}/dt$; without either it has what tires give, 9.81 m/s²; without $v_{g,max}$ T is 1 s.

    Args:
        target: The UGV's bounds.
        manoeuvre: m, the share of its bound.
        dt: Length of a tick [s].

    Returns:
        The standard deviation [m/s²].
    """
    speed, acceleration = target.max_speed, target.max_acceleration
    if acceleration is None:
        acceleration = _TIRE_LIMIT if speed is None else speed / dt
    hold = _HOLD if speed is None else 0.5 * speed / acceleration
    return manoeuvre * acceleration * math.sqrt(max(dt, hold) / dt)


def motion(*, ticks: int, dt: float, deviation: float) -> tuple[FloatArray, FloatArray]:
    r"""F and Q of the motion over n ticks, with an acceleration of its own held over each of them.

    $$ Q = \sigma_u^2 \begin{bmatrix} dt^4 (n^3/3 - n/12) & dt^3 n^2/2 \\ dt^3 n^2/2 & dt^2 n \end{bmatrix}
       \otimes I_2 $$

    is what n predictions over one tick each add up to.

    Args:
        ticks: n.
        dt: Length of a tick [s].
        deviation: σ_u of one tick's acceleration per axis [m/s²].

    Returns:
        F and Q, 4 x 4.
    """
    n, q, both = float(ticks), deviation * deviation, np.eye(2)
    F: FloatArray = np.kron(np.array([[1.0, n * dt], [0.0, 1.0]]), both)
    q_pp, q_pv, q_vv = q * dt**4 * (n**3 / 3.0 - n / 12.0), q * dt**3 * n * n / 2.0, q * dt * dt * n
    Q: FloatArray = np.kron(np.array([[q_pp, q_pv], [q_pv, q_vv]]), both)
    return F, Q


def _inverse(S: FloatArray) -> FloatArray:
    """Inverse of a 2 x 2 matrix."""
    a, b, c, d = S.ravel().tolist()
    scale = 1.0 / (a * d - b * c)
    return np.array([[d * scale, -b * scale], [-c * scale, a * scale]])


class RelativeEstimator:
    """The filter of one UAV on the UGV it escorts.

    Detections whose normalized innovation squared is beyond the gate are refused. After `settings.patience` refusals
    in a row the filter starts anew from the last of them.

    Deviation from the plain filter, where the UGV's largest speed is known: the velocity is never believed longer than
    v_g,max; its standard deviation per axis never larger than v_g,max; and that of the position never grows faster
    than at v_g,max. The deviations are shortened, the correlations stay, so the covariance stays one.

    F, Q, R and the first covariance are alike in x and y, and so P stays: one axis stands for both where it is capped.
    """

    def __init__(self, *, detector: Detector, target: Limits, dt: float, settings: Estimator) -> None:
        """Prepare the filter; it believes nothing until the first detection.

        Args:
            detector: The UAV's detector; its noise and cut make R.
            target: The UGV's bounds.
            dt: Length of a tick [s].
            settings: Gate, patience, manoeuvre, and whether to filter at all.

        Raises:
            ValueError: If dt is not positive and finite.
        """
        if not 0.0 < dt < math.inf:
            raise ValueError(f"dt must be positive and finite, not {dt}")
        self._settings = settings
        self._dt = dt
        self._speed = math.inf if target.max_speed is None else target.max_speed
        self._deviation = acceleration_deviation(target=target, manoeuvre=settings.manoeuvre, dt=dt)
        self._motions: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._variance = max(cut_variance(sigma=detector.noise, cut=detector.cut), _VARIANCE_FLOOR)
        # A vehicle at full speed in a direction unknown: v²/2 per axis.
        first = _FREE_SPEED**2 if target.max_speed is None else 0.5 * target.max_speed**2
        self._first_covariance = np.diag([self._variance, self._variance, first, first])
        self._filter: Any = KalmanFilter(dim_x=4, dim_z=2)
        self._filter.x = np.zeros(4)
        self._filter.P = self._first_covariance.copy()
        self._filter.H = np.eye(2, 4)
        self._filter.R = self._variance * np.eye(2)
        self._filter.inv = _inverse  # filterpy's own hook; LAPACK on 2 x 2 costs half of its update
        self._ahead: tuple[FloatArray, FloatArray, tuple[list[float], FloatArray]] | None = None  # x, P and gain at the next tick
        self._weighed: tuple[list[float], FloatArray] | None = None  # gain and covariance for a detection at this one
        self._time: float | None = None
        self._age: int | None = None  # ticks; None: nothing was ever believed
        self._looked = False  # a detection of this very time has been taken up
        self._refused = 0
        self._refused_in_a_row = 0
        self._innovation_squared: float | None = None

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
    def innovation_squared(self) -> float | None:
        """Normalized innovation squared (NIS) of the newest detection that met the gate; None before."""
        return self._innovation_squared

    def update(self, *, time: float, own_position: tuple[float, float], detections: tuple[Detection, ...]) -> Estimate | None:
        """Move on to `time` and take up what was detected then.

        Of several detections of one time only the first is used, also over several calls. A detection of another time
        is not used and counts as refused.

        Args:
            time: Now [s]; a whole number of ticks after the last call, or the same.
            own_position: p_a, where the detections were taken [m].
            detections: What has arrived since the last call.

        Returns:
            The estimate, or None where nothing was ever detected.

        Raises:
            ValueError: If the time goes back or is between two ticks.
        """
        self._advance(time)
        for detection in detections:
            if abs(detection.time - time) > _SAME_TIME:
                self._refused += 1
            elif not self._looked:
                self._looked = True
                p_delta_x, p_delta_y = detection.relative_position
                self._take(own_position[0] - p_delta_x, own_position[1] - p_delta_y)
        return self._estimate()

    def _advance(self, time: float) -> None:
        """Predict over the ticks since the last call."""
        elapsed = 0.0 if self._time is None else time - self._time
        ticks = round(elapsed / self._dt)
        if elapsed < -_SAME_TIME or abs(elapsed - ticks * self._dt) > max(1e-6 * self._dt, _SAME_TIME):
            raise ValueError(f"time {time} s is not a whole number of ticks of {self._dt} s after {self._time} s")
        if self._time is None or ticks:
            self._time = time
            self._looked = False
        if ticks and self._age is not None:
            self._age += ticks
            if self._settings.enabled:
                self._predict(ticks)

    def prepare(self) -> None:
        """Work ahead to the next tick, while nobody waits; it changes no estimate, only when it is there.

        Neither the prediction nor the gain depends on what will be detected.
        """
        if self._age is None or not self._settings.enabled or self._ahead is not None:
            return
        posterior = (self._filter.x, self._filter.P)
        self._predict(1)
        self._ahead = (self._filter.x, self._filter.P, self._weigh())
        self._filter.x, self._filter.P = posterior

    def _weigh(self) -> tuple[list[float], FloatArray]:
        """Gain K, row by row, for a detection at this tick, and the covariance after it: filterpy's update without innovation."""
        prior = (self._filter.x, self._filter.P)
        self._filter.update(prior[0][:2], H=self._filter.H)  # H is passed so that filterpy takes z as it is
        weighed = (self._filter.K.ravel().tolist(), self._filter.P)
        self._filter.x, self._filter.P = prior
        return weighed

    def _predict(self, ticks: int) -> None:
        ahead, self._ahead, self._weighed = self._ahead, None, None
        if ahead is not None and ticks == 1:
            self._filter.x, self._filter.P, self._weighed = ahead
            return
        matrices = self._motions.get(ticks)
        if matrices is None:
            matrices = self._motions[ticks] = motion(ticks=ticks, dt=self._dt, deviation=self._deviation)
        before = self._filter.P.item(0)
        self._filter.predict(F=matrices[0], Q=matrices[1])
        if self._speed < math.inf:
            self._cap(math.sqrt(before) + self._speed * ticks * self._dt)

    def _cap(self, reach: float) -> None:
        """Shorten the standard deviations per axis: the position's to `reach` [m], the velocity's to v_g,max."""
        position = math.sqrt(self._filter.P.item(0))
        velocity = math.sqrt(self._filter.P.item(10))
        if position > reach or velocity > self._speed:
            p, v = min(1.0, reach / position), min(1.0, self._speed / velocity)
            scale = np.array([p, p, v, v])
            self._filter.P = self._filter.P * np.outer(scale, scale)

    def _take(self, x: float, y: float) -> None:
        """Believe or refuse a detection of the UGV at (x, y) [m]."""
        if not self._settings.enabled or self._age is None:
            self._start(x, y)
        elif self._is_believable(x, y):
            self._correct(x, y)
        else:
            self._refused += 1
            self._refused_in_a_row += 1
            if self._refused_in_a_row >= self._settings.patience:
                self._start(x, y)

    def _start(self, x: float, y: float) -> None:
        self._ahead = self._weighed = None
        self._filter.x = np.array([x, y, 0.0, 0.0])
        self._filter.P = self._first_covariance.copy()
        self._age = 0
        self._refused_in_a_row = 0

    def _is_believable(self, x: float, y: float) -> bool:
        r"""Whether $\nu^T S^{-1} \nu$ is within the gate, $\nu = z - H\hat x$, $S = H P H^T + R$."""
        state, P = self._filter.x, self._filter.P
        nu_x, nu_y = x - state.item(0), y - state.item(1)
        s_xx, s_xy, s_yy = P.item(0) + self._variance, P.item(1), P.item(5) + self._variance
        determinant = s_xx * s_yy - s_xy * s_xy
        squared: float = (s_yy * nu_x * nu_x - 2.0 * s_xy * nu_x * nu_y + s_xx * nu_y * nu_y) / determinant
        self._innovation_squared = squared
        return squared <= self._settings.gate

    def _correct(self, x: float, y: float) -> None:
        K, covariance = self._weighed or self._weigh()
        p_x, p_y, v_x, v_y = self._filter.x.tolist()
        nu_x, nu_y = x - p_x, y - p_y
        v_x, v_y = clip_norm(v_x + K[4] * nu_x + K[5] * nu_y, v_y + K[6] * nu_x + K[7] * nu_y, self._speed)
        self._filter.x = np.array([p_x + K[0] * nu_x + K[1] * nu_y, p_y + K[2] * nu_x + K[3] * nu_y, v_x, v_y])
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
            age=self._age * self._dt,
            refused=self._refused,
        )
