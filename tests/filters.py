"""Filters, their equations and simulated measurements, for the tests of the estimator."""

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from agents.estimation.batch_filter import estimator_rows, update
from agents.estimation.estimator import Estimate, RelativeEstimator
from agents.estimation.motion_model import (
    SPAN,
    KalmanParameters,
    acceleration_deviation,
    history_depth,
    kalman_parameters,
    truncated_variance,
)
from bus.messages.scenario import Detector, Estimator, Limits
from bus.messages.vehicle import Detection
from bus.ticks import detection_rows
from seeded import a_key
from sim.compiling.compile import released
from sim.compiling.records import records
from sim.models.randomness import DETECTION_NOISE, cut_normal_vector
from sim.models.vehicles import State

DT = 0.05


SIGMA = 0.1


UGV = Limits(max_speed=0.2, max_acceleration=0.1)


FREE = Limits(max_speed=None, max_acceleration=0.1)  # no bounds: the plain Kalman filter


VARIANCE = truncated_variance(sigma=SIGMA, truncation=3.0)  # variance of a detection, per axis


# maps the acceleration of a tick to the state
PUSH = np.array([[DT * DT / 2, 0], [0, DT * DT / 2], [DT, 0], [0, DT]])


def make(noise=SIGMA, cut=3.0, target=UGV, dt=DT, **chosen):
    detector = Detector(noise=noise, truncation=cut, period=dt)
    return RelativeEstimator(detector=detector, target=target, dt=dt, settings=Estimator(**chosen))


class Filtered(NamedTuple):
    """The state of a filter at each tick of a run."""

    states: np.ndarray
    """(x, y, v_x, v_y). Shape (ticks, 4); NaN before the first detection."""
    covariances: np.ndarray
    """Shape (ticks, 4, 4)."""
    innovations: np.ndarray
    """NIS of the measurement that arrived at its own tick; NaN where there is none. Shape (ticks,)."""
    rejected: int


@released
def _filter(parameters, rows, positions, arrived, detections, states, axes, innovations):
    p, depth = parameters[0], rows.shape[2] - 1
    for k in range(positions.shape[0]):
        first, last = arrived[k], arrived[k + 1]
        own = State(positions[k, 0], positions[k, 1], 0.0, 0.0)
        update(p, rows, (0, 0), k, own, detections[first:last], last - first)
        now, prior = rows[0, 0, 0], rows[0, 0, 1 + k % depth]
        if now.known:
            states[k, 0], states[k, 1], states[k, 2], states[k, 3] = now.x, now.y, now.v_x, now.v_y
            axes[k, 0, 0], axes[k, 0, 1] = now.p_pp, now.p_pv
            axes[k, 1, 0], axes[k, 1, 1] = now.p_pv, now.p_vv
        if prior.known and prior.measured and p.enabled:
            nu_x, nu_y = prior.z_x - prior.x, prior.z_y - prior.y
            innovations[k] = (nu_x * nu_x + nu_y * nu_y) / (prior.p_pp + p.variance)


def filtered(own, at, noise=SIGMA, cut=3.0, target=UGV, dt=DT, **chosen) -> Filtered:
    """Fly a whole run with the filter of the batches, which takes thousands of runs in little time.

    test_batch_filter compares it with the pilots' filter.

    Args:
        own: Position of the UAV at each tick. Shape (ticks, 2).
        at: Detections that arrive at each tick, by tick: rows of the tick of detection and p_delta.
        noise, cut, target, dt, chosen: Arguments of `make`.
    """
    detector, settings = Detector(noise=noise, truncation=cut, period=dt), Estimator(**chosen)
    filter_settings = kalman_parameters(detector=detector, target=target, dt=dt, settings=settings)
    parameters = records(KalmanParameters, [filter_settings])
    rows = estimator_rows(history_depth(SPAN, dt))[None, None].copy()
    given = [at.get(k, ()) for k in range(len(own))]
    arrived = np.cumsum([0, *map(len, given)])
    detections = np.array([row for some in given for row in some], dtype=float).reshape(-1, 3)
    states, axes = np.full((len(own), 4), math.nan), np.full((len(own), 2, 2), math.nan)
    innovations = np.full(len(own), math.nan)
    own = np.ascontiguousarray(own, dtype=float)
    _filter(parameters, rows, own, arrived, detections, states, axes, innovations)
    return Filtered(states, np.kron(axes, np.eye(2)), innovations, rows["rejected"][0, 0, 0])


def updated(estimator, tick, seen=None, own=(0.0, 0.0), dt=DT) -> Estimate | None:
    """Update the estimator; `seen` is the detected position of the UGV in the world frame, or None."""
    detections = ()
    if seen is not None:
        detections = (
            Detection(time=tick * dt, relative_position=(own[0] - seen[0], own[1] - seen[1])),
        )
    return estimator.update(tick=tick, own_position=own, detections=detection_rows(detections, dt))


@functools.cache
def cut_noise(seed, count, sigma=SIGMA, cut=3.0):
    return np.array(
        [cut_normal_vector(sigma, cut, a_key(seed), DETECTION_NOISE, k, 0) for k in range(count)]
    )


def model(target=FREE, ticks=1):
    """Return F and Q, accumulated tick by tick."""
    deviation = acceleration_deviation(
        target=target, acceleration_share=Estimator().acceleration_share, dt=DT
    )
    F, Q, step = np.eye(4), np.zeros((4, 4)), np.eye(4)
    step[0, 2] = step[1, 3] = DT
    for _ in range(ticks):
        Q = step @ Q @ step.T + deviation**2 * PUSH @ PUSH.T
        F = step @ F
    return F, Q


def drawn_from_the_model(rng, count):
    """Return the states of a UGV that moves by the model of the filter. Shape (count, 4)."""
    F, _ = model()
    deviation = acceleration_deviation(
        target=FREE, acceleration_share=Estimator().acceleration_share, dt=DT
    )
    truth = [np.array([20.0, 20.0, *(10.0 * rng.normal(size=2))])]
    for _ in range(count - 1):
        truth.append(F @ truth[-1] + deviation * PUSH @ rng.normal(size=2))
    return np.array(truth)


def squared(errors, covariances):
    """Return the normalized squares e' P^-1 e of many errors."""
    return np.einsum("...i,...i", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])


def check_within(average, degrees, count, sure=0.999):
    """Check that an average of `count` chi-square values lies in its two-sided interval."""
    tail = 0.5 * (1.0 - sure)
    lower, upper = chi2.ppf([tail, 1.0 - tail], degrees * count) / count
    assert lower <= average <= upper


def check_below(average, degrees, count):
    """Check that an average of `count` chi-square values is not significantly too large."""
    assert average <= chi2.ppf(0.9995, degrees * count) / count


@functools.cache
def drive(seed, count, legs):
    """Return the states of a UGV on straight legs at v_g,max, with a stop at each corner."""
    rng = np.random.default_rng(seed)
    v_max, u_max = UGV.max_speed, UGV.max_acceleration
    corner, states = np.array([20.0, 20.0]), []
    while len(states) < count:
        length, angle = rng.uniform(*legs), rng.uniform(0.0, 2.0 * math.pi)
        along = np.array([math.cos(angle), math.sin(angle)])
        s = v = 0.0
        while len(states) < count and (length - s > 0.01 or v > 0.0):
            states.append([*(corner + s * along), *(v * along)])
            can_stop = (
                math.sqrt((u_max * DT) ** 2 + 2.0 * u_max * max(length - s, 0.0)) - u_max * DT
            )
            after = v + min(max(min(v_max, can_stop) - v, -u_max * DT), u_max * DT)
            s, v = s + 0.5 * (v + after) * DT, after if after > 2e-3 else 0.0
        corner = corner + s * along
    return np.array(states)


def converged(target=UGV, ticks=400, speed=0.1, **chosen):
    """Return a filter that has followed a UGV along x for `ticks`; the next tick is `ticks`."""
    estimator, noise = make(target=target, **chosen), cut_noise(9, ticks)
    for k in range(ticks):
        updated(estimator, k, (20.0 + speed * k * DT + noise[k, 0], 20.0 + noise[k, 1]))
    return estimator
