"""Rewards of the environment, and the end of an episode."""

import dataclasses
import math

import numpy as np
import pytest

from flights import escort, pairs
from outrider.envs.parallel import parallel_env
from sim.env.rewards import RewardWeights, full_error
from sim.scenario.types import Uav, Ugv

STILL = np.zeros(2)


def scenario(*, duration=60.0, goals=((14.0, 20.0),)):
    ugv = Ugv(position=(10.0, 20.0), goals=goals)
    return escort(uav=Uav(position=(12.0, 20.0)), ugv=ugv, duration=duration)


TWO = pairs(
    ((12.0, 20.0), (22.0, 20.0)),
    ({"position": (12.0, 20.0), "goals": ((12.2, 20.0),)}, (22.0, 20.0)),
    duration=60.0,
)
OUTWARD = [0.3, 0.0]


def flown(env, **actions):
    """Return the results of each step of an episode; vehicles without an action rest."""
    env.reset(seed=0)
    steps = []
    while env.agents:
        steps.append(env.step(dict.fromkeys(env.agents, STILL) | actions))
    return steps


def paid(steps, agent="uav_0"):
    return [rewards[agent] for _, rewards, *_ in steps]


def test_full_error_is_the_papers_anchor():
    assert full_error(9.75, 2.0) == pytest.approx(
        8.0 * math.pi * 9.75**2 * (0.5 - 2.0 / math.pi**2), rel=1e-15
    )
    assert full_error(9.75, 2.0) == pytest.approx(710.44, abs=0.005)


def test_full_error_is_the_error_of_uncovered_ground():
    env = parallel_env(scenario())
    env.reset(seed=0)
    assert env.metrics()["uav_0"]["uncovered_share"] == pytest.approx(1.0, abs=1e-5)


def test_uav_pays_for_uncovered_ground_by_the_second():
    env = parallel_env(scenario())
    env.reset(seed=0)
    for _ in range(100):
        _, rewards, *_ = env.step({"uav_0": [0.01, 0.02], "ugv_0": [0.05, 0.0]})
        error = env.world.measure()[0, 1]
        assert rewards["uav_0"] == pytest.approx(-error / full_error(9.75, 2.0) * 0.05, rel=1e-12)
    assert error < 0.9 * full_error(9.75, 2.0)


def test_weights_scale_their_own_terms():
    weights = RewardWeights(
        uncovered=3.0, sight_lost=7.0, out_of_sight=11.0, progress=13.0, goal=17.0, effort=19.0
    )
    plain, scaled = parallel_env(scenario()), parallel_env(scenario(), rewards=weights)
    for env in (plain, scaled):
        env.reset(seed=0)
    while plain.agents:
        actions = {"uav_0": [0.3, 0.0], "ugv_0": [-0.1, 0.0]}
        _, rewards, *_ = plain.step(actions)
        _, _, *_ = scaled.step(actions)
        base, large = plain.metrics(), scaled.metrics()
        assert rewards["uav_0"] == pytest.approx(
            sum(v for k, v in base["uav_0"].items() if k.startswith("reward_"))
        )
        for name, term in (("uncovered", 3.0), ("sight_lost", 0.7), ("out_of_sight", 5.5)):
            assert large["uav_0"][f"reward_{name}"] == pytest.approx(
                term * base["uav_0"][f"reward_{name}"]
            )
        assert large["ugv_0"]["reward_progress"] == pytest.approx(
            13.0 * base["ugv_0"]["reward_progress"]
        )
        assert large["uav_0"]["reward_effort"] == pytest.approx(-19.0 * 0.3**2 * 0.05)
        assert large["ugv_0"]["reward_effort"] == pytest.approx(-19.0 * 0.1**2 * 0.05)
    assert base["uav_0"]["reward_sight_lost"] == -10.0


def test_losing_sight_ends_the_episode_and_is_paid_to_its_end():
    env = parallel_env(scenario())
    _, rewards, terminations, truncations, _ = flown(env, uav_0=OUTWARD)[-1]
    assert terminations == {"uav_0": True, "ugv_0": True}
    assert truncations == {"uav_0": False, "ugv_0": False}
    assert env.metrics()["uav_0"]["distance"] >= 4.75
    assert env.metrics()["uav_0"]["margin"] <= 0.0
    assert env.metrics()["uav_0"]["visibility_violations"] == 1
    left = 60.0 - env.world.time + 0.05
    assert env.metrics()["uav_0"]["reward_out_of_sight"] == pytest.approx(-2.0 * left)
    assert rewards["uav_0"] == pytest.approx(
        -2.0 * left - 10.0 + env.metrics()["uav_0"]["reward_uncovered"]
    )


def test_losing_sight_early_never_pays():
    """Otherwise a learner would flee from the ground for which it is charged."""
    fled = flown(parallel_env(scenario()), uav_0=OUTWARD)
    stayed = flown(parallel_env(scenario(goals=())))
    assert len(fled) < len(stayed) == 1200
    assert sum(paid(fled)) < -60.0 < sum(paid(stayed))


def test_continued_loss_of_sight_is_charged_once_then_by_tick():
    env = parallel_env(scenario(duration=30.0), end_on_sight_lost=False)
    steps = flown(env, uav_0=OUTWARD)
    rewards, (*_, terminations, truncations, _) = paid(steps), steps[-1]
    assert len(rewards) == 600
    assert terminations == {"uav_0": False, "ugv_0": False}
    assert truncations == {"uav_0": True, "ugv_0": True}
    lost = env.metrics()["uav_0"]["visibility_violations"]
    assert 100 < lost < 600
    assert min(rewards) < -10.0
    assert sum(reward < -10.0 for reward in rewards) == 1
    assert all(-10.0 < reward <= -2.0 * 0.05 for reward in rewards[-lost + 1 :])


def test_sight_is_lost_from_the_visibility_radius_on():
    env = parallel_env(scenario(duration=30.0), end_on_sight_lost=False)
    env.reset(seed=1)
    counted = 0
    for _ in range(600):
        env.step({"uav_0": OUTWARD, "ugv_0": np.zeros(2)})
        metrics = env.metrics()["uav_0"]
        counted += metrics["distance"] >= 4.75
        assert metrics["visibility_violations"] == counted
    assert counted > 100


def test_one_lost_ugv_ends_the_episode_and_charges_its_uav():
    _, rewards, terminations, *_ = flown(parallel_env(TWO), uav_1=OUTWARD)[-1]
    assert set(terminations.values()) == {True}
    assert rewards["uav_1"] < -10.0 < -1.0 < rewards["uav_0"]


def test_ugv_gains_by_coming_nearer_and_by_arriving():
    env = parallel_env(scenario(goals=((11.0, 20.0), (11.0, 21.0))), end_on_sight_lost=False)
    env.reset(seed=0)
    gains, reached, turn = [], [], None
    for tick in range(400):
        action = [0.1, 0.0] if turn is None else [-0.1, 0.1]
        _, rewards, _, _, infos = env.step({"uav_0": STILL, "ugv_0": action})
        gains.append(rewards["ugv_0"])
        reached.append(infos["ugv_0"]["goals_reached"])
        if turn is None and reached[-1] == 1:
            turn = tick
            assert sum(gains) == pytest.approx(
                5.0 + 1.0 - math.dist(env.world.position[1], (11.0, 20.0))
            )
    assert turn is not None
    away = parallel_env(scenario())
    away.reset(seed=0)
    assert (
        sum(away.step({"uav_0": STILL, "ugv_0": [-0.1, 0.0]})[1]["ugv_0"] for _ in range(20)) < 0.0
    )


def test_ugv_that_has_arrived_or_has_no_goal_gains_nothing_more():
    for goals, bonus in (((), 0.0), (((10.1, 20.0),), 5.0)):
        env = parallel_env(scenario(goals=goals), end_on_sight_lost=False)
        env.reset(seed=0)
        gains = [env.step({"uav_0": STILL, "ugv_0": [0.1, 0.0]})[1]["ugv_0"] for _ in range(200)]
        assert sum(gain > 1.0 for gain in gains) == (1 if bonus else 0)
        assert gains[-1] == 0.0


def test_reaching_all_goals_ends_the_episode_on_request():
    for wanted in (False, True):
        env = parallel_env(TWO, end_on_goals_reached=wanted, end_on_sight_lost=False, duration=20.0)
        *_, terminations, truncations, infos = flown(env, ugv_0=[0.1, 0.0])[-1]
        assert set(terminations.values()) == {wanted}
        assert set(truncations.values()) == {not wanted}
        assert infos["ugv_0"]["goals_reached"] == 1


def test_episode_without_goals_does_not_end_by_reaching_them():
    env = parallel_env(scenario(goals=()), end_on_goals_reached=True, duration=1.0)
    *_, terminations, truncations, _ = flown(env)[-1]
    assert not any(terminations.values())
    assert all(truncations.values())


@pytest.mark.parametrize(("duration", "ticks"), [(None, 1200), (0.05, 1), (100.0, 2000)])
def test_episode_is_truncated_at_its_duration(duration, ticks):
    steps = flown(parallel_env(scenario(), duration=duration))
    *_, terminations, truncations, _ = steps[-1]
    assert len(steps) == ticks
    assert all(truncations.values())
    assert not any(terminations.values())


@pytest.mark.parametrize("field", [field.name for field in dataclasses.fields(RewardWeights)])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_bad_weights_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        RewardWeights(**{field: value})
