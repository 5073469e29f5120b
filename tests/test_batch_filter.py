"""The compiled filter of batches equals the pilots' filter step by step, to 1e-9."""

import math
from collections import defaultdict
from typing import NamedTuple

import numpy as np
import pytest

from agents.estimation.batch_filter import estimate, estimator_rows, update
from agents.estimation.estimator import RelativeEstimator
from agents.estimation.motion_model import (
    KalmanParameters,
    kalman_parameters,
    strayed_distance,
    truncated_variance,
)
from bus.messages.scenario import Detector, Estimator, Limits
from bus.ticks import DetectionRow
from filters import FREE, UGV
from sim.compiling.compile import released
from sim.compiling.records import records
from sim.models.vehicles import State

AGILE = Limits(max_speed=2.0, max_acceleration=None)
UNKNOWN = Limits(max_speed=None, max_acceleration=None)


class Case(NamedTuple):
    """A filter and the faults of its detections."""

    ticks: int
    dt: float = 0.05
    target: Limits = UGV
    settings: Estimator = Estimator()
    noise: float = 0.1
    late: float = 0.0  # largest delay [s]
    every: int = 1  # ticks between two detections
    wild: float = (
        0.0  # share of detections that arrive twice, contradict another one or have an invalid time
    )

    @property
    def depth(self):
        return 1 + round(self.late / self.dt)

    @property
    def arguments(self):
        detector = Detector(noise=self.noise, period=self.dt)
        settings, target = self.settings, self.target
        return {"detector": detector, "target": target, "settings": settings, "dt": self.dt}


OFF, RESTLESS = Estimator(enabled=False), Estimator(acceleration_share=2.5)
HASTY = Estimator(max_rejections=2, gate=5.0)
CASES = {
    "in time": Case(13000),
    "tick of 0.1 s": Case(8000, dt=0.1),
    "tick of 0.02 s": Case(8000, dt=0.02, settings=Estimator(acceleration_share=0.3)),
    "unknown speed": Case(5000, target=FREE),
    "unknown acceleration": Case(7000, dt=0.1, target=AGILE, settings=Estimator(max_rejections=2)),
    "nothing known": Case(4000, target=UNKNOWN),
    "no patience": Case(7000, settings=Estimator(max_rejections=1, gate=6.0)),
    "no noise": Case(4000, noise=0.0),
    "restless": Case(4000, target=AGILE, noise=0.01, settings=RESTLESS),
    "switched off": Case(4000, settings=OFF),
    "twice": Case(4000, wild=0.3),
    "late": Case(12000, late=2.0, every=4, wild=0.1),
    "late at 0.1 s": Case(8000, dt=0.1, late=2.0, every=2, wild=0.1),
    "late at unknown speed": Case(4000, target=FREE, late=2.0, every=4, wild=0.1),
    "late, no patience": Case(4000, late=1.0, every=2, wild=0.3, settings=HASTY),
    "late, restless": Case(4000, dt=0.1, target=AGILE, late=1.5, noise=0.01, settings=RESTLESS),
    "late, switched off": Case(4000, late=2.0, every=2, wild=0.2, settings=OFF),
}


def _places(case, rng):
    """Return positions of UAV and UGV at each tick; the UGV drives legs, turns and sometimes jumps."""
    v = 0.2 if case.target.max_speed is None else case.target.max_speed
    p, angle, own, ugv = np.array([20.0, 20.0]), 0.0, [], []
    for k in range(case.ticks):
        if rng.random() < case.dt / 10.0:
            angle = rng.uniform(0.0, 2.0 * math.pi)
        if rng.random() < case.dt / 60.0:
            p = p + rng.normal(size=2) * 4.0
        p = p + v * case.dt * np.array([math.cos(angle), math.sin(angle)])
        ugv.append(p)
        own.append(p + 2.0 * np.array([math.cos(0.3 * k * case.dt), math.sin(0.2 * k * case.dt)]))
    return np.array(own), np.array(ugv)


def _arrivals(case, own, ugv, rng):
    """Return the detections that arrive at each tick: rows of the tick of detection and p_delta."""
    at, blind_until = defaultdict(list), 0
    for k in range(3, case.ticks, case.every):
        if rng.random() < case.every * case.dt / 60.0:  # no detections for 1 s to 2 minutes
            blind_until = k + round(math.exp(rng.uniform(0.0, math.log(120.0))) / case.dt)
        if k < blind_until:
            continue
        gross = 5.0 * (rng.random() < 0.02)
        detection = (k, *(own[k] - ugv[k] + (case.noise + gross) * rng.normal(size=2)))
        delay = rng.integers(case.depth) if case.late and rng.random() < 0.9 else 0
        at[k + delay].append(detection)
        if rng.random() < case.wild:
            other = (k + rng.choice([-3 * case.depth, 0, 0, 1]), *(own[k] - ugv[k]))
            for again in (detection, detection, other)[: rng.integers(1, 4)]:
                at[k + rng.integers(case.depth + 2)].append(again)
    for arrived in at.values():
        rng.shuffle(arrived)
    return at


@released
def _step(parameters, rows, tick, x, y, detections, count):
    update(parameters[0], rows, (0, 0), tick, State(x, y, 0.0, 0.0), detections, count)
    return estimate(rows, 0, 0)


def _difference(target, pilots):
    """Return the largest difference of two estimates, relative to their size and to their covariance."""
    x, v, P = pilots.state[:2], pilots.state[2:], pilots.covariance
    return max(
        math.dist((target.p_x, target.p_y), x) / math.hypot(*x),
        math.dist((target.v_x, target.v_y), v) / max(math.hypot(*v), math.sqrt(P[2, 2])),
        abs(target.p_variance / P[0, 0] - 1.0),
        abs(target.v_variance / P[2, 2] - 1.0),
    )


@pytest.mark.parametrize("name", CASES)
def test_equals_the_pilots_filter_step_by_step(name):
    case, rng = CASES[name], np.random.default_rng(len(name))
    own, ugv = _places(case, rng)
    at = _arrivals(case, own, ugv, rng)
    parameters = records(KalmanParameters, [kalman_parameters(**case.arguments)])
    rows = estimator_rows(case.depth)[None, None].copy()
    pilots = RelativeEstimator(**case.arguments, span=(case.depth - 1) * case.dt)
    for k, (p_x, p_y) in enumerate(own.tolist()):
        arrived = np.array([*at[k], (math.nan, 1.0, 1.0)])  # the last row has not arrived
        target = _step(parameters, rows, k, p_x, p_y, arrived, len(at[k]))
        estimated = pilots.update(
            tick=k, own_position=(p_x, p_y), detections=[DetectionRow(*one) for one in at[k]]
        )
        now = rows[0, 0, 0]
        assert target.known == (estimated is not None), k
        if estimated is not None:
            assert now["age"] == pilots.age, k
            assert now["rejected"] == estimated.rejected - pilots.misdated, k
            assert _difference(target, pilots) < 1e-9, k
    if case.settings.enabled and case.noise:
        assert now["rejected"] > 0  # otherwise the run shows little
    if case.wild:
        assert min(pilots.duplicates, pilots.misdated, pilots.too_old) > 0


def test_a_ugv_not_seen_for_long_may_have_turned_round():
    case = CASES["in time"]
    parameters = records(KalmanParameters, [kalman_parameters(**case.arguments)])
    rows = estimator_rows(1)[None, None].copy()
    for k in range(4801):
        _step(parameters, rows, k, 0.0, 0.0, np.array([[0.0, 1.0, 1.0]]), int(k == 0))
    strayed = strayed_distance(240.0, 0.2, 0.7 * 0.1)
    assert math.sqrt(rows["p_pp"][0, 0, 0]) == pytest.approx(strayed / math.sqrt(8.0))


def test_parameters_follow_from_detector_and_limits():
    parameters = kalman_parameters(**CASES["in time"].arguments)
    assert parameters.variance == truncated_variance(sigma=0.1, truncation=3.0)
    assert (parameters.first_variance, parameters.speed) == (0.5 * 0.2**2, 0.2)
    unknown = kalman_parameters(**CASES["unknown speed"].arguments)
    assert (unknown.first_variance, unknown.speed) == (100.0, math.inf)


@pytest.mark.parametrize("dt", [0.0, -0.1, math.inf, math.nan])
def test_a_tick_without_length_is_refused(dt):
    with pytest.raises(ValueError, match="dt"):
        kalman_parameters(detector=Detector(period=1.0), target=UGV, dt=dt, settings=Estimator())


def test_an_empty_history_is_refused():
    with pytest.raises(ValueError, match="depth"):
        estimator_rows(0)
