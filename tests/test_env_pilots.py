"""The paper's pilots in the environment, and the filter's estimate in its rows."""

import copy
import math
import pickle
import runpy
from pathlib import Path

import msgspec
import numpy as np
import pytest

from agents.estimation.estimator import RelativeEstimator
from bus.messages.scenario import Law
from bus.observations import UAV, by_name
from bus.ticks import looks_of
from flights import escort, flown_in_both, pairs, record, sha256
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.running.flying import fly
from row_messages import uav_observation
from sim.scenario.loading import load_scenario
from sim.scenario.types import Custom, Detections, Uav, Ugv

EXAMPLE = Path(__file__).parent.parent / "examples" / "environment.py"
NOISY = pairs(
    ((11.0, 10.0), (30.0, 31.0)),
    (
        {"position": (10.0, 10.0), "goals": ((20.0, 10.0), (20.0, 20.0))},
        {"position": (30.0, 30.0), "goals": ((25.0, 25.0),)},
    ),
    name="noisy",
    duration=100.0,
    detections=Detections(noise=0.1, dropout=0.3, rate=10.0),
)
ABOVE = escort(
    name="above: every direction is as good, and the pilot's own random numbers choose",
    duration=100.0,
    uav=Uav(position=(10.0, 10.0)),
    ugv=Ugv(position=(10.0, 10.0), goals=((20.0, 10.0),)),
)


@pytest.mark.parametrize(
    "scenario", [load_scenario("escort"), NOISY, ABOVE], ids=["escort", "noisy", "above"]
)
def test_pilots_fly_the_same_bits_in_the_environment_as_in_a_run(scenario):
    states, flight, summary = flown_in_both(scenario, 1)
    assert len(states) == summary.ticks >= 2000
    np.testing.assert_array_equal(states, flight.recorder.states[:-1])


def test_pilots_restart_with_each_episode():
    env = parallel_env(NOISY, duration=20.0)
    policies = pilots(env)
    first, other, again = (
        sha256(record(env, policies, env.reset(seed=seed)[0])) for seed in (1, None, 1)
    )
    fresh = parallel_env(NOISY, duration=20.0)
    fresh.reset(seed=1)
    assert first == again
    assert other == sha256(record(fresh, pilots(fresh), fresh.reset()[0])) != first


def test_pilots_also_fly_float32_rows_and_rows_with_a_picture():
    for options in ({"dtype": np.float32}, {"coverage_patch": (8, 1.0)}):
        env = parallel_env(NOISY, duration=50.0, **options)
        observations, _ = env.reset(seed=1)
        record(env, pilots(env), observations)
        assert env.world.tick == 1000  # sight was never lost
        assert env.metrics()["uav_0"]["visibility_violations"] == 0


def test_pilots_accept_a_user_weighting():
    own = msgspec.structs.replace(
        NOISY, law=Law(name="weighted"), custom=Custom(weighting="mine:weighting")
    )
    env = parallel_env(own, duration=20.0)
    observations, _ = env.reset(seed=1)

    def weighting(distance, r_s):
        return min(1.0, distance / r_s), max(0.0, 1.0 - distance / r_s)

    _, summary = fly(env.scenario, 1, weighting=weighting)
    assert (
        sha256(record(env, pilots(env, weighting=weighting), observations))
        == summary.trajectory_sha256
    )


def test_the_example_runs_as_it_stands(capsys):
    runpy.run_path(str(EXAMPLE))
    printed = capsys.readouterr().out
    assert "'visibility_violations': 0" in printed


# -- the estimate instead of the detection


def rows_of(env, ticks, seed=1):
    observations, _ = env.reset(seed=seed)
    yield observations
    rng = np.random.default_rng(0)
    for _ in range(ticks):
        actions = {name: rng.uniform(-0.05, 0.05, 2) for name in env.agents}
        yield env.step(actions)[0]


def test_rows_hold_the_filters_estimate_and_leave_the_rest():
    raw, wrapped = parallel_env(NOISY), parallel_env(NOISY, estimate=True)
    briefed = raw.briefing("uav_0")
    own = RelativeEstimator(
        detector=briefed.detector,
        target=briefed.target_limits,
        dt=briefed.dt,
        settings=briefed.estimator,
    )
    silent = 0
    for plain, estimated in zip(rows_of(raw, 300), rows_of(wrapped, 300), strict=True):
        seen = uav_observation(plain["uav_0"], dt=briefed.dt)
        estimate = own.update(
            tick=seen.tick,
            own_position=seen.position,
            detections=looks_of(seen.detections, briefed.dt),
        )
        before, after = (rows["uav_0"].tolist() for rows in (plain, estimated))
        silent += not before[5]
        assert after[:5] == before[:5]
        if estimate is None:
            assert after == before
        else:
            p_delta = (before[1] - estimate.position[0], before[2] - estimate.position[1])
            assert after[5:] == pytest.approx((1.0, *p_delta, estimate.age), rel=1e-9, abs=1e-9)
        assert estimated["ugv_0"].tobytes() == plain["ugv_0"].tobytes()
    assert silent > 50


def test_estimates_are_nearer_to_the_truth_than_detections():
    raw = parallel_env(NOISY, end_on_sight_lost=False)
    wrapped = parallel_env(NOISY, end_on_sight_lost=False, estimate=True)
    errors = {"raw": [], "filter": []}
    for plain, estimated in zip(rows_of(raw, 1500), rows_of(wrapped, 1500), strict=True):
        truth = raw.world.position[0] - raw.world.position[2]
        for name, row in (
            ("raw", by_name(UAV, plain["uav_0"])),
            ("filter", by_name(UAV, estimated["uav_0"])),
        ):
            if row["detected"]:
                errors[name].append(math.dist((row["relative_x"], row["relative_y"]), truth))
    assert len(errors["filter"]) > len(errors["raw"])
    assert np.mean(errors["filter"]) < 0.8 * np.mean(errors["raw"])


@pytest.mark.parametrize("options", [{}, {"dtype": np.float32}, {"coverage_patch": (8, 1.0)}])
def test_estimates_stay_in_their_spaces_and_repeat_by_seed(options):
    env, second = (parallel_env(NOISY, estimate=True, **options) for _ in range(2))
    list(rows_of(second, 30, seed=9))  # another episode leaves no traces
    kept = []
    for ours, theirs in zip(rows_of(env, 200), rows_of(second, 200), strict=True):
        kept.append((ours, copy.deepcopy(ours)))
        for name, observation in ours.items():
            assert env.observation_space(name).contains(observation)
            assert str(observation) == str(theirs[name])
    assert all(str(now) == str(then) for now, then in kept)
    assert env.observation_space("uav_0") is env.observation_space("uav_0")
    assert env.state().tobytes() == second.state().tobytes()


@pytest.mark.parametrize("name", ["escort", "minefield"])
def test_pilots_and_environment_can_be_pickled_together(name):
    env = parallel_env(load_scenario(name, overrides={"law.name": "certified"}), duration=6.0)
    policies = pilots(env)
    observations, _ = env.reset(seed=3)
    for _ in range(20):
        observations, *_ = env.step({one: policies[one](observations[one]) for one in env.agents})
    other, others = pickle.loads(pickle.dumps((env, policies)))  # noqa: S301 - our own data
    ours, theirs = record(env, policies, observations), record(other, others, observations)
    assert len(ours) == 100
    np.testing.assert_array_equal(ours, theirs)
