"""The Kalman filter on relative detections: its equations, its consistency, and faulty detections."""

import math

import numpy as np
import pytest
from filterpy.common import Q_discrete_white_noise

from agents.estimation.motion_model import acceleration_deviation as deviation_of
from agents.estimation.motion_model import process_noise, truncated_variance
from bus.messages.scenario import Estimator, Limits
from bus.ticks import DetectionRow
from filters import (
    DT,
    FREE,
    SIGMA,
    UGV,
    VARIANCE,
    check_below,
    check_within,
    converged,
    cut_noise,
    drawn_from_the_model,
    drive,
    filtered,
    make,
    model,
    squared,
    updated,
)

H = np.eye(2, 4)


# The equations


@pytest.mark.parametrize("target", [FREE, UGV])
def test_equals_the_equations_written_out_by_hand(target):
    rng = np.random.default_rng(1)
    estimator = make(target=target, gate=1e12)
    R = VARIANCE * np.eye(2)
    x = P = None
    tick = 0
    for _ in range(300):
        ticks = int(rng.choice([1, 1, 1, 1, 2, 7]))
        tick += ticks
        own = rng.normal(size=2)
        seen = rng.random() < 0.8 or x is None
        z = np.array([20.0, 20.0]) + rng.normal(size=2) * 0.3 if seen else None
        estimate = updated(estimator, tick, z, own=tuple(own))
        if x is None:
            x, P = np.array([*z, 0.0, 0.0]), estimator.covariance
            continue
        F, Q = model(target, ticks=ticks)
        x, P = F @ x, F @ P @ F.T + Q
        if z is not None:
            nu, S = z - H @ x, H @ P @ H.T + R
            K = P @ H.T @ np.linalg.inv(S)
            x, P = x + K @ nu, (np.eye(4) - K @ H) @ P
            squared_nu = nu @ np.linalg.solve(S, nu)
            assert estimator.innovation_squared == pytest.approx(squared_nu, rel=1e-9)
            if target.max_speed is not None:
                x[2:] *= min(1.0, target.max_speed / np.linalg.norm(x[2:]))
        np.testing.assert_allclose(estimator.state, x, rtol=0, atol=1e-10)
        np.testing.assert_allclose(estimator.covariance, P, rtol=1e-9, atol=1e-12)
        assert estimate.position == tuple(estimator.state[:2])
        assert estimate.velocity == tuple(estimator.state[2:])
        assert estimate.covariance == pytest.approx((P[0, 0], 0.0, P[1, 1]), rel=1e-9)


def test_process_noise_is_filterpys_discrete_white_noise():
    reference = Q_discrete_white_noise(2, dt=DT, var=0.3**2)
    np.testing.assert_allclose(process_noise(dt=DT, deviation=0.3), reference, rtol=1e-12)


def test_process_noise_does_not_depend_on_how_finely_time_is_cut():
    def after_a_second(dt):
        F, total = np.array([[1.0, dt], [0.0, 1.0]]), np.zeros((2, 2))
        Q = process_noise(dt=dt, deviation=deviation_of(acceleration_share=0.7, target=UGV, dt=dt))
        for _ in range(round(1.0 / dt)):
            total = F @ total @ F.T + Q
        return total

    np.testing.assert_allclose(after_a_second(0.05), after_a_second(0.005), rtol=2e-3)


def test_unbounded_acceleration_changes_velocity_in_a_tick():
    boundless = Limits(max_speed=0.2, max_acceleration=None)
    assert deviation_of(target=boundless, acceleration_share=1.0, dt=DT) * DT == pytest.approx(0.2)
    unknown = Limits(max_speed=None, max_acceleration=None)
    assert deviation_of(target=unknown, acceleration_share=1.0, dt=DT) > 9.0


@pytest.mark.parametrize("cut", [0.3, 1.0, 2.0, 3.0])
def test_variance_of_cut_noise_against_monte_carlo(cut):
    draws = np.random.default_rng(3).normal(size=(1_500_000, 2))
    kept = draws[np.einsum("ij,ij->i", draws, draws) <= cut * cut]
    error = np.std(kept**2) / math.sqrt(kept.size)
    assert truncated_variance(sigma=1.0, truncation=cut) == pytest.approx(
        np.mean(kept**2), abs=4.5 * error
    )
    shipped = cut_noise(4, 20_000, sigma=0.3, cut=cut)
    assert truncated_variance(sigma=0.3, truncation=cut) == pytest.approx(
        np.mean(shipped**2), rel=0.03
    )


def test_variance_of_cut_noise_at_its_limits():
    assert truncated_variance(sigma=0.3, truncation=None) == 0.3**2
    assert truncated_variance(sigma=0.3, truncation=math.inf) == 0.3**2
    assert truncated_variance(sigma=0.3, truncation=40.0) == 0.3**2
    assert truncated_variance(sigma=0.3, truncation=1e-3) == pytest.approx(
        (1e-3 * 0.3) ** 2 / 4.0, rel=1e-6
    )
    assert truncated_variance(sigma=0.0, truncation=3.0) == 0.0
    around = [
        truncated_variance(sigma=1.0, truncation=math.sqrt(2e-4) * (1.0 + step))
        for step in (-1e-9, 1e-9)
    ]
    assert around[0] == pytest.approx(around[1], rel=1e-8)


# Consistency


def each_tick(own, seen):
    """Return the detections of a UGV at each tick, in the form of `filtered`."""
    return {k: [(k, *p_delta)] for k, p_delta in enumerate((own - seen).tolist())}


@pytest.mark.parametrize("cut", [None, 3.0, 1.0])
def test_is_consistent_when_the_ugv_moves_as_the_model_says(cut):
    seeds, count = 250, 100
    nees, nis = [], []
    for seed in range(seeds):
        rng, own = np.random.default_rng(seed), np.zeros((count, 2))
        noise = cut_noise(seed, count, cut=cut) if cut else SIGMA * rng.normal(size=(count, 2))
        truth = drawn_from_the_model(rng, count)
        at = each_tick(own, truth[:, :2] + noise)
        found = filtered(own, at, target=FREE, cut=cut, gate=1e12)
        nees.append(squared(truth - found.states, found.covariances))
        nis.append(found.innovations[1:])
    for k in (1, 10, 40, count - 1):
        check_within(np.mean([one[k] for one in nees]), 4, seeds)
    check_within(np.mean(nis), 2, seeds * (count - 1))


@pytest.mark.parametrize("legs", [(1.0, 8.0), (0.2, 0.8)], ids=["waypoints", "restless"])
def test_real_ugv_is_tracked_consistently_and_accurately(legs):
    """100 runs of 50 s with a real UGV, detected with truncated noise by a UAV on a circle."""
    flights, count, angle = 100, 1000, 0.005 * np.arange(1000)
    own = 20.0 + 3.0 * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    nees, nis, errors, noises, refused = [], [], [], [], 0
    for seed in range(flights):
        truth, noise = drive(seed, count, legs), cut_noise(seed, count)
        found = filtered(own, each_tick(own, truth[:, :2] + noise))
        errors.append((found.states - truth)[:, :2])
        noises.append(noise)
        nees.append(squared(found.states - truth, found.covariances))
        nis.append(found.innovations[1:])
        refused += found.rejected
    assert np.mean(np.square(errors)) < 0.8**2 * np.mean(np.square(noises))
    assert refused <= 2  # of 100,000; 1 in 10,000 would be allowed for noise without truncation
    check_below(np.mean(nees), 4, flights)
    check_below(np.mean(nis), 2, flights * (count - 1))


# Faulty detections


def test_no_estimate_before_the_first_detection():
    estimator = make()
    assert all(updated(estimator, k) is None for k in range(5))
    first = updated(estimator, 5, (3.0, 4.0), own=(1.0, 1.0))
    assert first.position == (3.0, 4.0)
    assert first.velocity == (0.0, 0.0)
    assert first.covariance == (VARIANCE, 0.0, VARIANCE)
    assert (first.age, first.rejected) == (0.0, 0)


def test_outlier_is_refused_and_moves_nothing():
    hit, alone = converged(), converged()
    outlier = updated(hit, 400, (25.0, 20.0))
    nothing = updated(alone, 400)
    assert (outlier.rejected, nothing.rejected) == (1, 0)
    assert outlier.position == nothing.position
    assert outlier.age == nothing.age == DT
    np.testing.assert_array_equal(hit.state, alone.state)
    np.testing.assert_array_equal(hit.covariance, alone.covariance)
    assert hit.innovation_squared > Estimator().gate


def test_filter_restarts_after_too_many_rejections():
    estimator = converged(max_rejections=5)
    for k in range(400, 404):
        assert updated(estimator, k, (30.0, 25.0)).position != (30.0, 25.0)
    restarted = updated(estimator, 404, (30.0, 25.0))
    assert restarted.position == (30.0, 25.0)
    assert restarted.velocity == (0.0, 0.0)
    assert (restarted.age, restarted.rejected) == (0.0, 5)
    after = updated(estimator, 405, (30.0, 25.05))
    assert after.rejected == 5


def test_accepted_detection_resets_the_rejection_count():
    estimator = converged(max_rejections=3, speed=0.0)
    for k in range(400, 440):
        estimate = updated(estimator, k, (20.0, 20.0) if k % 3 == 0 else (30.0, 20.0))
    assert estimate.position == pytest.approx((20.0, 20.0), abs=0.1)
    assert estimate.rejected == 27


def test_one_long_gap_and_many_ticks_end_in_the_same_place():
    for target in (FREE, UGV):
        leap, walk = converged(target), converged(target)
        at_once = updated(leap, 399 + 50)
        for k in range(400, 400 + 50):
            step_by_step = updated(walk, k)
        assert at_once == step_by_step
        np.testing.assert_array_equal(leap.covariance, walk.covariance)


def test_duplicate_detections_and_predictions_count_once():
    once, twice = converged(), converged()
    first, second = DetectionRow(400, -22.0, -20.0), DetectionRow(400, -22.1, -20.0)

    def position_and_age(estimator, *detections):
        return estimator.update(tick=400, own_position=(0.0, 0.0), detections=detections)

    expected = position_and_age(once, first)
    position_and_age(twice)
    assert position_and_age(twice, first, second) == position_and_age(twice, first) == expected
    np.testing.assert_array_equal(once.covariance, twice.covariance)


def test_time_that_goes_back_is_an_error():
    with pytest.raises(ValueError, match="tick = 398: before the last one; allowed: 399"):
        converged().update(tick=398, own_position=(0.0, 0.0), detections=())


def test_switched_off_it_holds_the_newest_detection_as_it_is():
    estimator = make(enabled=False)
    assert updated(estimator, 0) is None
    updated(estimator, 1, (20.0, 20.0))
    jumped = updated(estimator, 2, (35.0, 11.0), own=(30.0, 10.0))
    assert jumped.position == (35.0, 11.0)
    for k in range(3, 50):
        kept_estimate = updated(estimator, k, own=(5.0, 5.0))
    assert kept_estimate.position == (35.0, 11.0)
    assert kept_estimate.velocity == (0.0, 0.0)
    assert kept_estimate.covariance == (VARIANCE, 0.0, VARIANCE)
    assert kept_estimate.age == pytest.approx(47 * DT)
    assert kept_estimate.rejected == 0


@pytest.mark.parametrize("acceleration", [0.1, None])
def test_without_noise_it_follows_exactly_and_refuses_nothing(acceleration):
    estimator = make(noise=0.0, target=Limits(max_speed=0.2, max_acceleration=acceleration))
    for k, truth in enumerate(drive(5, 1500, (0.2, 2.0)).tolist()):
        estimate = updated(estimator, k, truth[:2])
        assert estimate.position == pytest.approx(tuple(truth[:2]), abs=1e-6)
        assert 0.0 < estimate.covariance[0] < 1e-11
    assert estimate.rejected == 0


def test_unbounded_ugv_turning_in_a_tick_is_followed():
    estimator, noise = make(target=Limits(max_speed=0.2, max_acceleration=None)), cut_noise(6, 2000)
    x, errors = 20.0, []
    for k in range(2000):
        x += (0.2 if k // 100 % 2 else -0.2) * DT
        estimate = updated(estimator, k, (x + noise[k, 0], 20.0 + noise[k, 1]))
        errors.append((estimate.position[0] - x, estimate.position[1] - 20.0))
    assert estimate.rejected == 0
    assert np.std(errors) < 0.6 * SIGMA
