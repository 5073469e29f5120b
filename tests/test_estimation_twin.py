"""The compiled filter of many worlds gives the same bits as the pilots' filter, whatever happens to the detections."""

import math
from collections import defaultdict
from typing import NamedTuple

import numpy as np
import pytest
from blas import blas_fuses, fused
from filters import FREE, UGV, straying

from agents.estimation.estimator import RelativeEstimator
from agents.estimation.filtering import kalman_estimate, kalman_refused, kalman_state
from agents.estimation.motion_model import cut_variance, kalman_parameters
from agents.estimation.twin import kalman_step
from bus.messages import Detector, Estimator, Limits
from bus.ticks import Look

AGILE = Limits(max_speed=2.0, max_acceleration=None)
UNKNOWN = Limits(max_speed=None, max_acceleration=None)


def test_fma_rounds_once():
    a = 1.0 + 2.0**-30
    assert a * a - 1.0 - 2.0**-29 == 0.0
    assert fused(a, a, -1.0 - 2.0**-29) == 2.0**-60


def _compare(ours, theirs, where):
    if blas_fuses():
        assert np.asarray(ours).tobytes() == np.asarray(theirs).tobytes(), (where, ours, theirs)
    else:
        message = f"{where}: to 1e-9 only, since numpy's BLAS does not fuse here as OpenBLAS does on x86-64"
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12, err_msg=message)


# Flights


class Case(NamedTuple):
    """One filter, and what happens to its detections."""

    ticks: int
    dt: float = 0.05
    target: Limits = UGV
    settings: Estimator = Estimator()
    noise: float = 0.1
    late: float = 0.0  # largest delay [s]
    every: int = 1  # ticks between two looks
    wild: float = 0.0  # share of looks that come twice, contradict or have an impossible time

    @property
    def depth(self):
        return 1 + round(self.late / self.dt)

    @property
    def detector(self):
        return Detector(noise=self.noise, period=self.dt)


OFF, RESTLESS = Estimator(enabled=False), Estimator(manoeuvre=2.5)
HASTY = Estimator(patience=2, gate=5.0)
CASES = {
    "in time": Case(12000),
    "tick of 0.1 s": Case(8000, dt=0.1),
    "tick of 0.02 s": Case(8000, dt=0.02, settings=Estimator(manoeuvre=0.3)),
    "unknown speed": Case(4000, target=FREE),
    "unknown acceleration": Case(6000, dt=0.1, target=AGILE, settings=Estimator(patience=2)),
    "nothing known": Case(4000, target=UNKNOWN),
    "no patience": Case(6000, settings=Estimator(patience=1, gate=6.0)),
    "no noise": Case(4000, noise=0.0),
    "restless": Case(4000, target=AGILE, noise=0.01, settings=RESTLESS),
    "switched off": Case(4000, settings=OFF),
    "twice": Case(4000, wild=0.3),
    "late": Case(5000, late=2.0, every=4, wild=0.1),
    "late at 0.1 s": Case(5000, dt=0.1, late=2.0, every=2, wild=0.1),
    "late at unknown speed": Case(2400, target=FREE, late=2.0, every=4, wild=0.1),
    "late, no patience": Case(2400, late=1.0, every=2, wild=0.3, settings=HASTY),
    "late, restless": Case(2000, dt=0.1, target=AGILE, late=1.5, noise=0.01, settings=RESTLESS),
    "late, switched off": Case(4000, late=2.0, every=2, wild=0.2, settings=OFF),
}


def _places(case, rng):
    """Where the UAV and the UGV are at each tick: the UGV drives legs, turns and now and then is put elsewhere."""
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
    """For each tick the looks that arrive then: rows of the tick taken and p_delta."""
    at, blind_until = defaultdict(list), 0
    for k in range(3, case.ticks, case.every):
        if rng.random() < case.every * case.dt / 60.0:  # blind for 1 s to 2 minutes
            blind_until = k + round(math.exp(rng.uniform(0.0, math.log(120.0))) / case.dt)
        if k < blind_until:
            continue
        gross = 5.0 * (rng.random() < 0.02)
        look = (k, *(own[k] - ugv[k] + (case.noise + gross) * rng.normal(size=2)))
        delay = rng.integers(case.depth) if case.late and rng.random() < 0.9 else 0
        at[k + delay].append(look)
        if rng.random() < case.wild:
            other = (k + rng.choice([-3 * case.depth, 0, 0, 1]), *(own[k] - ugv[k]))
            for again in (look, look, other)[: rng.integers(1, 4)]:
                at[k + rng.integers(case.depth + 2)].append(again)
    for arrived in at.values():
        rng.shuffle(arrived)
    return at


def _table(arrived):
    """The array that the twin reads: longer than what has arrived, the rest filled with what must not be read."""
    looks = np.full((len(arrived) + 2, 3), math.nan)
    for row, look in zip(looks, arrived, strict=False):
        row[:] = look
    return looks


def _pair(case):
    told = {"detector": case.detector, "target": case.target, "settings": case.settings}
    parameters = kalman_parameters(**told, dt=case.dt)
    pilots = RelativeEstimator(**told, dt=case.dt, span=(case.depth - 1) * case.dt)
    return parameters, kalman_state(case.depth), pilots


def _state(belief):
    return np.array([belief.x, belief.y, belief.v_x, belief.v_y])


def _covariance(belief):
    return np.array([belief.p_pp, belief.p_pv, belief.p_vp, belief.p_vv])


def _compare_filters(state, pilots, estimate, case, where):
    b, n = state.belief[0], state.counts[0]
    assert (n.duplicates, n.too_old) == (pilots.duplicates, pilots.too_old), where
    assert b.known == (estimate is not None), where
    if estimate is None:
        return
    assert (b.age * case.dt, kalman_refused(state)) == (estimate.age, estimate.refused), where
    assert kalman_estimate(state) == (True, b.x, b.y, b.v_x, b.v_y, b.p_pp, b.p_vv)
    _compare(_state(b), pilots.state, where)
    _compare(_covariance(b), pilots.covariance[::2, ::2].ravel(), where)


@pytest.mark.parametrize("name", CASES)
def test_at_every_tick_it_is_the_pilots_filter(name):
    """The pilot has worked ahead to it, or has not, at random."""
    case = CASES[name]
    _fly_beside(name, case._replace(ticks=min(case.ticks, 3200)))


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name, case in CASES.items() if case.ticks > 3200])
def test_at_every_tick_of_a_long_flight_it_is_the_pilots_filter(name):
    _fly_beside(name, CASES[name])


def _fly_beside(name, case):
    rng = np.random.default_rng(len(name))
    own, ugv = _places(case, rng)
    at = _arrivals(case, own, ugv, rng)
    parameters, state, pilots = _pair(case)
    for k, (p_x, p_y) in enumerate(own.tolist()):
        arrived = at[k]
        kalman_step(parameters, state, k, p_x, p_y, _table(arrived), len(arrived))
        estimate = pilots.update(
            tick=k, own_position=(p_x, p_y), looks=[Look(*one) for one in arrived]
        )
        _compare_filters(state, pilots, estimate, case, f"{name}, tick {k}")
        if rng.random() < 0.5:
            pilots.prepare()
    counts = state.counts[0]
    if case.settings.enabled and case.noise:
        assert kalman_refused(state) > counts.misdated  # or the flight has shown little
    if case.wild:
        assert min(counts.duplicates, counts.misdated, counts.too_old) > 0


def test_a_ugv_that_was_not_seen_for_long_may_have_turned_round():
    parameters = kalman_parameters(
        detector=Detector(noise=0.1, period=0.05), target=UGV, dt=0.05, settings=Estimator()
    )
    state = kalman_state(1)
    for k in range(4801):
        kalman_step(parameters, state, k, 0.0, 0.0, np.array([[0.0, 1.0, 1.0]]), int(k == 0))
    strayed = straying(elapsed=240.0, target=UGV, manoeuvre=0.7, dt=0.05)
    assert math.sqrt(state.belief[0].p_pp) == pytest.approx(strayed / math.sqrt(8.0))


def test_the_gate_closes_at_the_same_bit():
    fuses = blas_fuses()
    rng = np.random.default_rng(8)
    own, ugv = (2.0, -1.0), rng.normal(size=(30, 2)) * 0.1
    wide = CASES["in time"]._replace(settings=Estimator(gate=1e12))
    for last in range(1, len(ugv)):
        _, _, pilots = _pair(wide)
        for k in range(last + 1):
            look = Look(k, own[0] - ugv[k, 0], own[1] - ugv[k, 1])
            pilots.update(tick=k, own_position=own, looks=(look,))
        squared = pilots.innovation_squared
        below = np.nextafter(squared, 0.0) if fuses else squared * (1.0 - 1e-9)
        for gate, refused in ((squared if fuses else squared * (1.0 + 1e-9), 0), (below, 1)):
            parameters, state, _ = _pair(wide)
            for k in range(last + 1):
                judged = parameters._replace(gate=float(gate)) if k == last else parameters
                look = np.array([[k, own[0] - ugv[k, 0], own[1] - ugv[k, 1]]])
                kalman_step(judged, state, k, *own, look, 1)
            assert kalman_refused(state) == refused


# The frame


def test_parameters_follow_from_detector_and_bounds():
    parameters, _, _ = _pair(CASES["in time"])
    assert parameters.variance == cut_variance(sigma=0.1, cut=3.0)
    assert (parameters.first_variance, parameters.speed) == (0.5 * 0.2**2, 0.2)
    unknown, _, _ = _pair(CASES["unknown speed"])
    assert (unknown.first_variance, unknown.speed) == (100.0, math.inf)


@pytest.mark.parametrize("dt", [0.0, -0.1, math.inf, math.nan])
def test_a_tick_without_length_is_refused(dt):
    with pytest.raises(ValueError, match="dt"):
        kalman_parameters(detector=Detector(period=1.0), target=UGV, dt=dt, settings=Estimator())


def test_a_filter_without_a_tick_to_remember_is_refused():
    with pytest.raises(ValueError, match="depth"):
        kalman_state(0)
