"""Filters, their equations by hand and what they see, for the tests of the estimator."""

import functools
import math

import numpy as np
from scipy.stats import chi2
from seeded import a_key

from agents.estimation.estimator import Estimate, RelativeEstimator
from agents.estimation.motion_model import (
    acceleration_deviation,
    cut_variance,
    strayed_distance,
    supposed_acceleration,
)
from bus.messages import Detection, Detector, Estimator, Limits
from bus.ticks import looks_of
from sim.models.randomness import DETECTION_NOISE, cut_normal_vector

DT = 0.05


SIGMA = 0.1


UGV = Limits(max_speed=0.2, max_acceleration=0.1)


FREE = Limits(max_speed=None, max_acceleration=0.1)  # no caps: the plain Kalman filter


VARIANCE = cut_variance(sigma=SIGMA, cut=3.0)  # of the detections, per axis


PUSH = np.array(
    [[DT * DT / 2, 0], [0, DT * DT / 2], [DT, 0], [0, DT]]
)  # a tick's acceleration to the state


def straying(*, elapsed: float, target: Limits, manoeuvre: float, dt: float) -> float:
    """The largest way of a UGV of these bounds off its course in `elapsed` [s], [m]; see `strayed_distance`."""
    acceleration = supposed_acceleration(target=target, manoeuvre=manoeuvre, dt=dt)
    return strayed_distance(
        elapsed=float(elapsed), speed=float(target.max_speed), acceleration=float(acceleration)
    )


def make(noise=SIGMA, cut=3.0, target=UGV, dt=DT, **chosen):
    detector = Detector(noise=noise, cut=cut, period=dt)
    return RelativeEstimator(detector=detector, target=target, dt=dt, settings=Estimator(**chosen))


def look(estimator, tick, seen=None, own=(0.0, 0.0), dt=DT) -> Estimate | None:
    """One call; `seen` is the detected position of the UGV in the world, or None."""
    detections = ()
    if seen is not None:
        detections = (
            Detection(time=tick * dt, relative_position=(own[0] - seen[0], own[1] - seen[1])),
        )
    return estimator.update(tick=tick, own_position=own, looks=looks_of(detections, dt))


def kept(flown):
    """Each once, for many tests that fly the same: what it returns can only be read."""

    @functools.cache
    def once(*given, **named):
        states = flown(*given, **named)
        states.setflags(write=False)
        return states

    return once


@kept
def cut_noise(seed, count, sigma=SIGMA, cut=3.0):
    return np.array(
        [cut_normal_vector(sigma, cut, a_key(seed), DETECTION_NOISE, k, 0) for k in range(count)]
    )


def model(target=FREE, ticks=1):
    """F and Q, added up tick by tick."""
    deviation = acceleration_deviation(target=target, manoeuvre=Estimator().manoeuvre, dt=DT)
    F, Q, step = np.eye(4), np.zeros((4, 4)), np.eye(4)
    step[0, 2] = step[1, 3] = DT
    for _ in range(ticks):
        Q = step @ Q @ step.T + deviation**2 * PUSH @ PUSH.T
        F = step @ F
    return F, Q


def squared(errors, covariances):
    """Normalized squares e' P^-1 e of many errors at once."""
    return np.einsum("...i,...i", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])


def within(average, degrees, count):
    """Whether an average of `count` chi-squares lies in its two-sided 99.9 % interval; prints both."""
    lower, upper = chi2.ppf([0.0005, 0.9995], degrees * count) / count
    print(f"average {average:.4f}, interval [{lower:.4f}, {upper:.4f}]")  # noqa: T201
    return lower <= average <= upper


@kept
def drive(seed, count, legs):
    """A real UGV: straight legs at v_g,max, as fast as it may and as it can stop, a stop at each corner."""
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


def settled(target=UGV, ticks=400, speed=0.1, **chosen):
    """A filter that has followed a UGV along x for a while; the next tick is `ticks`."""
    estimator, noise = make(target=target, **chosen), cut_noise(9, ticks)
    for k in range(ticks):
        look(estimator, k, (20.0 + speed * k * DT + noise[k, 0], 20.0 + noise[k, 1]))
    return estimator
