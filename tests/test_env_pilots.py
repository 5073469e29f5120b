"""The paper's pilots in the environment, and the filter's estimate in its rows."""

import pickle
import runpy
from pathlib import Path

import msgspec
import numpy as np
import pytest

from bus.messages.scenario import Law
from flights import escort, flown_in_both, pairs, record, sha256
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.running.flying import fly
from sim.scenario.loading import load_scenario
from sim.scenario.types import Custom, Detections
from sim.scenario.vehicle_types import Uav, Ugv

EXAMPLE = Path(__file__).parent.parent / "examples" / "environment.py"
NOISY = pairs(
    ((11.0, 10.0), (30.0, 31.0)),
    (
        {"position": (10.0, 10.0), "goals": ((20.0, 10.0), (20.0, 20.0))},
        {"position": (30.0, 30.0), "goals": ((25.0, 25.0),)},
    ),
    duration=100.0,
    detections=Detections(noise=0.1, dropout=0.3, rate=10.0),
)
ABOVE = escort(
    duration=100.0,
    uav=Uav(position=(10.0, 10.0)),
    ugv=Ugv(position=(10.0, 10.0), goals=((20.0, 10.0),)),
)
"""Every direction is as good, and the pilot's own random numbers choose."""


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


@pytest.mark.parametrize("options", [{"dtype": np.float32}, {"coverage_patch": (8, 1.0)}], ids=str)
def test_pilots_also_fly_float32_rows_and_rows_with_a_picture(options):
    env = parallel_env(NOISY, duration=50.0, **options)
    record(env, pilots(env), env.reset(seed=1)[0])
    assert env.world.tick == 1000  # sight was never lost
    assert env.metrics()["uav_0"]["visibility_violations"] == 0


def test_pilots_accept_a_user_weighting():
    own = msgspec.structs.replace(
        NOISY, law=Law(name="weighted"), custom=Custom(weighting="mine:weighting")
    )
    env = parallel_env(own, duration=20.0)

    def weighting(distance, r_s):
        return min(1.0, distance / r_s), max(0.0, 1.0 - distance / r_s)

    states = record(env, pilots(env, weighting=weighting), env.reset(seed=1)[0])
    _, summary = fly(env.scenario, 1, weighting=weighting)
    assert sha256(states) == summary.trajectory_sha256


def test_the_example_runs_as_it_stands(capsys):
    runpy.run_path(str(EXAMPLE))
    printed = capsys.readouterr().out
    assert "'visibility_violations': 0" in printed


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
