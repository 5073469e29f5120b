"""The filter on a bad network: detections that are late, out of order, duplicated, in bursts or missing."""

import math
from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.estimation.estimator import RelativeEstimator
from agents.estimation.motion_model import history_depth, strayed_distance
from bus.messages.scenario import Detector, Estimator, Limits
from bus.messages.vehicle import Detection
from bus.ticks import detection_rows
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
    squared,
    updated,
)
from properties import PROPERTY

EVERY = 4  # ticks between two detections: 0.2 s
AGILE = Limits(max_speed=0.2, max_acceleration=None)


def own(tick):
    """Return the position of a UAV on a circle, which differs from that a second ago."""
    return (20.0 + 3.0 * math.cos(0.01 * tick), 20.0 + 3.0 * math.sin(0.01 * tick))


def detection(tick, seen):
    """Return a detection at this tick of a UGV at `seen` in the world frame."""
    p_x, p_y = own(tick)
    return Detection(time=tick * DT, relative_position=(p_x - seen[0], p_y - seen[1]))


def call(estimator, tick, *detections):
    return estimator.update(
        tick=tick, own_position=own(tick), detections=detection_rows(detections, DT)
    )


def bits(estimator):
    return estimator.state.tobytes(), estimator.covariance.tobytes(), estimator.innovation_squared


def followed(ticks=200, missing=(), **chosen):
    """Return a filter that has detected a UGV along x at each tick but the missing ones."""
    estimator = make(**chosen)
    for k in range(ticks):
        call(estimator, k, *(() if k in missing else (detection(k, along(k)),)))
    return estimator


def along(tick):
    noise = cut_noise(9, 1000)[tick % 1000]
    return (20.0 + 0.1 * tick * DT + noise[0], 20.0 + noise[1])


# Arrival order

flights = st.lists(
    st.tuples(
        st.sampled_from([1, 1, 1, 2, 5, 30]),  # ticks since the previous update
        st.sampled_from(["seen", "seen", "gross", "missed"]),
        st.sampled_from(
            [[0], [1], [2], [3], [5], [9], [12], [2, 2], [0, 6], [4, 1, 7], []]
        ),  # delay of each copy in updates; none: lost
        st.booleans(),  # whether the queue is delivered
    ),
    min_size=10,
    max_size=18,
)


@given(
    flight=flights,
    target=st.sampled_from([UGV, FREE, AGILE]),
    max_rejections=st.integers(1, 4),
    enabled=st.sampled_from([True, True, True, False]),
    order=st.randoms(use_true_random=False),
)
@settings(PROPERTY, max_examples=80)
def test_arrival_order_changes_no_bit_of_the_estimate(
    flight, target, max_rejections, enabled, order
):
    ticks = np.cumsum([step for step, *_ in flight] + [1] * 12).tolist()
    post = defaultdict(list)  # by the update at which it arrives
    taken = {}
    for k, (_, what, copies, _) in enumerate(flight):
        seen = (30.0, 12.0) if what == "gross" else (20.0 + 0.01 * k, 20.0 + 0.05 * (k % 3))
        if what != "missed" and copies:
            taken[k] = detection(ticks[k], seen)
            for late in copies:
                post[k + late].append(k)
    late = make(target=target, max_rejections=max_rejections, enabled=enabled)
    arrived: set[int] = set()
    copies = 0
    for k, tick in enumerate(ticks):
        order.shuffle(post[k])
        arrived.update(post[k])
        copies += len(post[k])
        ours = call(late, tick, *(taken[i] for i in post[k]))
        in_order = make(target=target, max_rejections=max_rejections, enabled=enabled)
        for i, before in enumerate(ticks[: k + 1]):
            theirs = call(in_order, before, *([taken[i]] if i in arrived else []))
        assert ours == theirs
        assert bits(late) == bits(in_order)
    assert arrived == set(taken)
    assert late.duplicates == copies - len(taken)
    assert late.too_old == 0


def test_age_is_that_of_the_newest_accepted_detection():
    estimator = make()
    assert [call(estimator, k) for k in range(30)] == [None] * 30
    assert call(estimator, 30, detection(10, (20.0, 20.0))).age == 20 * DT
    assert (
        call(estimator, 31, detection(25, (20.0, 20.0)), detection(5, (20.0, 20.0))).age == 6 * DT
    )
    assert call(estimator, 32, detection(12, (20.0, 20.0))).age == 7 * DT
    assert call(estimator, 33, detection(30, (29.0, 20.0))).age == 8 * DT  # rejected


# Unused detections


def test_duplicates_are_ignored_and_counted_whenever_they_come():
    once, often = followed(), followed()
    copy, old = detection(200, along(200)), detection(150, along(150))
    expected = call(once, 200, copy)
    assert call(often, 200, old, copy, copy, old) == expected
    assert bits(often) == bits(once)
    assert (once.duplicates, often.duplicates, often.too_old) == (0, 3, 0)
    refused = detection(201, (30.0, 30.0))
    first = call(often, 201, refused)
    # a copy of a rejected one is a copy
    assert call(often, 202, refused).rejected == first.rejected == 1
    assert often.duplicates == 4


def test_what_is_older_than_the_span_is_dropped_and_counted():
    def fly(*late):
        arguments = {"detector": Detector(noise=SIGMA, period=DT), "settings": Estimator()}
        estimator = RelativeEstimator(**arguments, target=UGV, dt=DT, span=1.0)
        for k in range(100):
            call(estimator, k, *([detection(k, along(k))] if k not in (79, 80) else []))
        return call(estimator, 100, *(detection(k, along(k)) for k in late)), estimator

    (nothing, plain), (same, dropped), (other, used) = fly(), fly(79), fly(80)
    assert (same, bits(dropped)) == (nothing, bits(plain))
    assert (dropped.too_old, used.too_old) == (1, 0)
    assert bits(used) != bits(plain)
    assert other.rejected == nothing.rejected == same.rejected == 0


def test_detections_of_occupied_or_skipped_ticks_are_rejected():
    estimator, alone = followed(), followed()
    estimate = call(estimator, 200, detection(150, (20.8, 20.1)))
    assert (estimate.rejected, estimator.duplicates) == (1, 0)
    assert estimate.position == call(alone, 200).position
    assert bits(estimator) == bits(alone)
    call(estimator, 210)
    between = Detection(time=198.5 * DT, relative_position=(0.0, 0.0))
    before = Detection(time=209 * DT, relative_position=(0.0, 0.0))
    ahead = Detection(time=211 * DT, relative_position=(0.0, 0.0))
    assert call(estimator, 210, between, before, ahead).rejected == 1 + 3
    started_late = make()
    call(started_late, 50)
    assert call(started_late, 51, detection(20, (20.0, 20.0))) is None


def test_the_past_that_is_kept_is_bounded():
    with pytest.raises(ValueError, match="span"):
        history_depth(-1.0, DT)
    assert history_depth(60.0, 0.05) == 1201
    assert history_depth(math.inf, 5e-324) == 100_001
    estimator = make()
    for k in range(1500):
        call(estimator, k)
    call(estimator, 1500, detection(299, (20.0, 20.0)))
    assert (estimator.too_old, estimator.state.any()) == (1, False)
    call(estimator, 1500, detection(300, (20.0, 20.0)))
    assert (estimator.too_old, estimator.state.any()) == (1, True)


# Consistency

NETWORKS = (
    *("in time", "0.5 s late", "1 s late", "2 s late", "jitter", "half lost", "bursts"),
    *("blackouts", "duplicates", "everything"),
)


def arrivals(network, seed, count):
    """Return, for each tick of a run, the detections that arrive then, independent of their content."""
    rng = np.random.default_rng(seed)
    at = defaultdict(list)
    bad = False
    for k in range(0, count, EVERY):
        t = k * DT
        bad ^= rng.random() < EVERY * DT / 1.5  # good and bad times of 1.5 s on average
        lost = {
            "half lost": rng.random() < 0.5,
            "bursts": bad,
            "blackouts": t % 15.0 >= 5.0,
            "everything": bad or rng.random() < 0.2 or t % 20.0 >= 10.0,
        }.get(network, False)
        copies = {"duplicates": 3, "everything": 1 + rng.integers(2)}.get(network, 1)
        for _ in range(0 if lost else copies):
            delay = {
                "0.5 s late": 0.5,
                "1 s late": 1.0,
                "2 s late": 2.0,
                "jitter": rng.uniform(0.0, 2.0),
                "duplicates": rng.uniform(0.0, 1.0),
                "everything": rng.uniform(0.5, 2.0),
            }.get(network, 0.0)
            at[k + round(delay / DT)].append(k)
    return at


def fly_through(network, seed, truth, noise, **chosen):
    """Return errors and covariances at each tick from 5 s on, NaN before the first detection, and the rejections."""
    places = np.array([own(k) for k in range(len(truth))])
    detected = (places - truth[:, :2] - noise).tolist()
    arrived = arrivals(network, seed, len(truth))
    at = {k: [(i, *detected[i]) for i in taken] for k, taken in arrived.items()}
    found = filtered(places, at, **chosen)
    return (found.states - truth)[100:], found.covariances[100:], found.rejected


def nees_of_the_model(network, seeds, count):
    """Return the NEES of UGVs that move by the model of the filter, at each tick from 5 s on."""
    chosen, nees = {"target": FREE, "cut": None, "gate": 1e12}, []
    for seed in seeds:
        noise = SIGMA * np.random.default_rng([seed, 1]).normal(size=(count, 2))
        truth = drawn_from_the_model(np.random.default_rng(seed), count)
        errors, covariances, _ = fly_through(network, seed, truth, noise, **chosen)
        nees.append(squared(errors, covariances))
    return np.array(nees)


@pytest.mark.parametrize("network", NETWORKS)
def test_bad_network_leaves_the_filter_consistent(network):
    flights = 60
    nees = nees_of_the_model(network, range(flights), 400)
    for k in (0, 99, 198, 201, 299):  # 5 s, 10 s, 14.9 s: the last tick of a blackout, 15.1 s, 20 s
        known = nees[:, k][~np.isnan(nees[:, k])]
        assert len(known) > 0.8 * flights
        check_within(known.mean(), 4, len(known))


def test_nees_is_within_its_95_percent_interval_on_a_bad_network():
    """Late, missing and duplicate measurements; one average, 20 s after the start."""
    flights = 300
    last = nees_of_the_model("everything", range(1000, 1000 + flights), 401)[:, -1]
    check_within(last.mean(), 4, flights, sure=0.95)


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("legs", [(1.0, 8.0), (0.2, 0.8)])
def test_is_not_too_sure_of_a_real_ugv_on_a_bad_network(network, legs):
    flights, count = 40, 700
    nees, seen, refused = [], [], 0
    for seed in range(flights):
        truth, noise = drive(seed, count, legs), cut_noise(seed, count)
        errors, covariances, rejections = fly_through(network, seed, truth, noise)
        nees.append(squared(errors, covariances))
        seen.append(squared(errors[:, :2], covariances[:, :2, :2]))
        refused += rejections
    check_below(np.nanmean(nees), 4, flights)
    check_below(np.nanmean(seen), 2, flights)
    assert refused == 0


def test_late_detections_improve_on_the_newest_alone():
    ours, theirs = [], []
    for seed in range(20):
        truth, noise = drive(seed, 700, (1.0, 8.0)), cut_noise(seed, 700)
        errors, _, _ = fly_through("1 s late", seed, truth, noise)
        newest_alone, _, _ = fly_through("1 s late", seed, truth, noise, enabled=False)
        ours.append(errors[:, :2])
        theirs.append(newest_alone[:, :2])
    assert np.mean(np.square(ours)) < 0.6**2 * np.mean(np.square(theirs))


# Long gaps


def test_straying_is_what_a_ugv_does_that_turns_round_at_once():
    x, v, u = 0.0, 0.2, 0.7 * 0.1
    for k in range(4000):
        t = k * DT
        assert 0.2 * t - x == pytest.approx(strayed_distance(t, 0.2, u), abs=2e-3)
        v_after = max(v - u * DT, -0.2)
        x, v = x + 0.5 * (v + v_after) * DT, v_after
    assert strayed_distance(0.0, 0.2, 2.8) == 0.0
    assert strayed_distance(1e6, 0.2, 2.8) == pytest.approx(4e5)


@pytest.mark.parametrize("gap", [2.0, 5.0, 10.0, 30.0, 60.0, 200.0, 1000.0])
def test_ugv_reversing_in_a_gap_is_accepted_again(gap):
    estimator, ticks = converged(speed=0.2), round(gap / DT)
    x = 20.0 + 0.2 * 399 * DT + 0.2 * gap - strayed_distance(gap, 0.2, 0.1)
    updated(estimator, 399 + ticks - 1)
    P = estimator.covariance[:2, :2]
    back = updated(estimator, 399 + ticks, (x, 20.0))
    assert (back.rejected, back.age) == (0, 0.0)
    assert estimator.innovation_squared < 9.0
    assert math.sqrt(P[0, 0]) < math.sqrt(VARIANCE) + 0.2 * gap


@pytest.mark.parametrize("gap", [10.0, 60.0, 240.0])
def test_is_not_too_sure_of_a_real_ugv_after_a_long_gap(gap):
    flights, ticks = 20, round(gap / DT)
    errors, covariances = [], []
    for seed in range(flights):
        truth, noise = drive(seed, 400 + ticks, (1.0, 80.0)), cut_noise(seed, 400)
        seen = range(0, 400, EVERY)
        at = {k: [(k, *-(truth[k, :2] + noise[k]))] for k in seen}
        found = filtered(np.zeros((400 + ticks, 2)), at)
        errors.append(found.states[-1] - truth[-1])
        covariances.append(found.covariances[-1])
    nees = squared(np.array(errors), np.array(covariances))
    check_below(nees.mean(), 4, flights)
    assert nees.max() < 18.4


@given(
    flight=flights,
    noise=st.sampled_from([0.0, 0.1, 1.0]),
    speed=st.floats(0.01, 30.0),
    acceleration=st.one_of(st.none(), st.floats(0.01, 10.0)),
)
@PROPERTY
def test_estimate_stays_near_the_ugv(flight, noise, speed, acceleration):
    estimator = make(noise, target=Limits(max_speed=speed, max_acceleration=acceleration))
    call(estimator, 0, detection(0, (20.0, 20.0)))
    tick, last, waiting = 0, None, []
    for elapsed, what, copies, arrives in [*flight, (3000, "missed", [], False)]:
        tick += elapsed
        arrived = waiting if arrives else []
        waiting = [] if arrives else waiting
        now = call(estimator, tick, *arrived)
        if what == "seen":
            waiting += [detection(tick, (20.0 + 0.01 * len(copies), 20.0))] * len(copies)
        P = estimator.covariance
        assert math.hypot(*now.velocity) <= speed * (1.0 + 1e-9)
        d = np.sqrt(np.diag(P))
        assert d[2:].max() <= speed * (1.0 + 1e-9)
        np.testing.assert_allclose(P, P.T, rtol=1e-12)
        assert np.linalg.eigvalsh(P / np.outer(d, d))[0] > -1e-9
        if last is not None and now.age > elapsed * DT * (1.0 + 1e-9) and not arrived:
            assert math.dist(now.position, last[0]) <= speed * elapsed * DT * (1.0 + 1e-9) + 1e-9
            assert math.sqrt(P[0, 0]) <= (last[1] + speed * elapsed * DT) * (1.0 + 1e-9)
            assert math.sqrt(P[0, 0]) >= last[1] * (1.0 - 1e-9)
        last = (now.position, math.sqrt(P[0, 0]))
