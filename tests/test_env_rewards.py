"""Rewards of the environment, and the end of an episode."""

import dataclasses
import importlib
import math
import re
import sys

import numpy as np
import pytest

import outrider
from flights import escort, pairs
from outrider.envs.parallel import parallel_env
from pages import PAGES, ROOT, blocks, run_shown
from sim.env.rewards import RewardWeights, full_error
from sim.scenario.vehicle_types import Uav, Ugv

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


def test_full_error_is_the_error_of_uncovered_ground():
    wanted = 8.0 * math.pi * 9.75**2 * (0.5 - 2.0 / math.pi**2)
    assert full_error(9.75, 2.0) == pytest.approx(wanted, rel=1e-15)
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
    scale = {"uncovered": 3.0, "sight_lost": 0.7, "out_of_sight": 5.5, "progress": 13.0}
    plain, scaled = parallel_env(scenario()), parallel_env(scenario(), rewards=weights)
    for env in (plain, scaled):
        env.reset(seed=0)
    while plain.agents:
        actions = {"uav_0": [0.3, 0.0], "ugv_0": [-0.1, 0.0]}
        _, rewards, *_ = plain.step(actions)
        scaled.step(actions)
        for name, u_max in (("uav_0", 0.3), ("ugv_0", 0.1)):
            base, large = plain.metrics()[name], scaled.metrics()[name]
            paid = sum(value for key, value in base.items() if key.startswith("reward_"))
            assert rewards[name] == pytest.approx(paid)
            for term in scale.keys() & {key.removeprefix("reward_") for key in base}:
                wanted = scale[term] * base[f"reward_{term}"]
                assert large[f"reward_{term}"] == pytest.approx(wanted)
            assert large["reward_effort"] == pytest.approx(-19.0 * u_max**2 * 0.05)
    assert plain.metrics()["uav_0"]["reward_sight_lost"] == -10.0
    assert plain.metrics()["ugv_0"]["reward_progress"] < 0.0


def test_losing_sight_ends_the_episode_and_is_paid_to_its_end():
    env = parallel_env(scenario())
    _, rewards, terminations, truncations, _ = flown(env, uav_0=OUTWARD)[-1]
    assert terminations == {"uav_0": True, "ugv_0": True}
    assert truncations == {"uav_0": False, "ugv_0": False}
    metrics, left = env.metrics()["uav_0"], 60.0 - env.world.time + 0.05
    assert metrics["distance"] >= 4.75
    assert metrics["margin"] <= 0.0
    assert metrics["visibility_violations"] == 1
    assert rewards["uav_0"] == pytest.approx(-2.0 * left - 10.0 + metrics["reward_uncovered"])


def test_losing_sight_early_never_pays():
    """Otherwise a learner would flee from the ground for which it is charged."""
    fled, stayed = (
        [rewards["uav_0"] for _, rewards, *_ in steps]
        for steps in (
            flown(parallel_env(scenario()), uav_0=OUTWARD),
            flown(parallel_env(scenario(goals=()))),
        )
    )
    assert len(fled) < len(stayed) == 1200
    assert sum(fled) < -60.0 < sum(stayed)


def test_continued_loss_of_sight_is_charged_once_then_by_tick():
    env = parallel_env(scenario(duration=30.0), end_on_sight_lost=False)
    env.reset(seed=0)
    rewards, lost = [], 0
    for _ in range(600):
        _, paid, terminations, truncations, _ = env.step({"uav_0": OUTWARD, "ugv_0": STILL})
        rewards.append(paid["uav_0"])
        lost += env.metrics()["uav_0"]["distance"] >= 4.75
        assert env.metrics()["uav_0"]["visibility_violations"] == lost
    assert terminations == {"uav_0": False, "ugv_0": False}
    assert truncations == {"uav_0": True, "ugv_0": True}
    assert 100 < lost < 600
    assert sum(reward < -10.0 for reward in rewards) == 1
    assert all(-10.0 < reward <= -2.0 * 0.05 for reward in rewards[-lost + 1 :])


def test_one_lost_ugv_ends_the_episode_and_charges_its_uav():
    _, rewards, terminations, *_ = flown(parallel_env(TWO), uav_1=OUTWARD)[-1]
    assert set(terminations.values()) == {True}
    assert rewards["uav_1"] < -10.0 < -1.0 < rewards["uav_0"]


def test_ugv_gains_by_coming_nearer_and_by_arriving():
    env = parallel_env(scenario(goals=((11.0, 20.0), (11.0, 21.0))), end_on_sight_lost=False)
    env.reset(seed=0)
    gained, reached = 0.0, 0
    while not reached:
        _, rewards, _, _, infos = env.step({"uav_0": STILL, "ugv_0": [0.1, 0.0]})
        gained, reached = gained + rewards["ugv_0"], infos["ugv_0"]["goals_reached"]
    left = math.dist(env.world.position[1], (11.0, 20.0))
    assert gained == pytest.approx(5.0 + 1.0 - left)


def test_ugv_that_has_arrived_or_has_no_goal_gains_nothing_more():
    for goals, bonus in (((), 0.0), (((10.1, 20.0),), 5.0)):
        env = parallel_env(scenario(goals=goals), end_on_sight_lost=False)
        env.reset(seed=0)
        gains = [env.step({"uav_0": STILL, "ugv_0": [0.1, 0.0]})[1]["ugv_0"] for _ in range(200)]
        assert sum(gain > 1.0 for gain in gains) == (1 if bonus else 0)
        assert gains[-1] == 0.0


@pytest.mark.parametrize("wanted", [False, True])
def test_reaching_all_goals_ends_the_episode_on_request(wanted):
    options = {"end_on_goals_reached": wanted, "end_on_sight_lost": False, "duration": 20.0}
    *_, terminations, truncations, infos = flown(parallel_env(TWO, **options), ugv_0=[0.1, 0.0])[-1]
    assert set(terminations.values()) == {wanted}
    assert set(truncations.values()) == {not wanted}
    assert infos["ugv_0"]["goals_reached"] == 1
    without_goals = parallel_env(scenario(goals=()), **options)
    assert not any(any(terminations.values()) for _, _, terminations, *_ in flown(without_goals))


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


def chase(metrics):
    """Reward an adversarial UGV for the distance; the UAV receives its weighted terms."""
    assert metrics["uav_0"]["reward_uncovered"].shape == metrics["ugv_0"]["way_to_goal"].shape
    return {"ugv_0": 0.1 * metrics["uav_0"]["distance"] + metrics["ugv_0"]["reward_progress"]}


def test_a_reward_function_pays_alike_in_all_environments() -> None:
    worlds = outrider.parallel_vector_env("escort", num_envs=3, reward_function=chase, duration=2.0)
    plain = outrider.parallel_env("escort", duration=2.0)
    env = outrider.parallel_env("escort", reward_function=chase, duration=2.0)
    single = outrider.single_env("escort", agent="ugv_0", reward_function=chase, duration=2.0)
    for one, seed in ((worlds, 1), (plain, 3), (env, 3), (single, 3)):
        one.reset(seed=seed)
    returned = 0.0
    for _ in range(40):
        actions = dict.fromkeys(env.agents, np.array([0.1, 0.2]))
        _, expected, *_ = plain.step(actions)
        before = env.step(actions)[1]
        many = {name: np.tile(action, (3, 1)) for name, action in actions.items()}
        _, paid, *_, infos = worlds.step(many)
        metrics = env.metrics()
        wanted = 0.1 * metrics["uav_0"]["distance"] + metrics["ugv_0"]["reward_progress"]
        assert before == {"uav_0": expected["uav_0"], "ugv_0": wanted}
        assert {name: rewards[2] for name, rewards in paid.items()} == before
        returned += before["ugv_0"]
    assert infos["ugv_0"]["final_info"]["episode"]["r"][2] == returned
    assert single.step([0.1, 0.2])[1] > 0.0


@pytest.mark.parametrize(
    ("reward", "fault"),
    [
        (lambda _: 1.0, "rewards by vehicle"),
        (lambda _: {"uav_9": 1.0}, "no such vehicle; allowed: uav_0, ugv_0"),
        (lambda _: {"uav_0": np.nan}, "finite numbers"),
        (lambda _: {"uav_0": [1.0, 2.0, 3.0]}, r"shape \(1,\)"),
    ],
)
def test_bad_rewards_of_a_function_raise(reward, fault) -> None:
    env = outrider.parallel_env("escort", reward_function=reward)
    env.reset(seed=1)
    with pytest.raises((TypeError, ValueError), match=fault):
        env.step(dict.fromkeys(env.agents, STILL))
    with pytest.raises(TypeError, match="reward_function = 3; allowed"):
        outrider.parallel_env("escort", reward_function=3)


def test_metrics_have_the_same_names_with_one_world_or_many() -> None:
    one, many = outrider.parallel_env("escort"), outrider.parallel_vector_env("escort", num_envs=2)
    for env in (one, many):
        env.reset(seed=1)
    names = {name: set(found) for name, found in one.metrics().items()}
    assert names == {name: set(found) for name, found in many.metrics().items()}
    assert {"reward_progress", "way_to_goal"} <= names["ugv_0"]


def test_the_page_states_the_cost_of_losing_sight() -> None:
    page, costs = PAGES["docs/how-to/rewards.md"], []
    for ends in (True, False):
        env = outrider.parallel_env("escort", end_on_sight_lost=ends)
        env.reset(seed=1)
        lost = False
        while not lost:
            _, paid, *_ = env.step({"uav_0": np.ones(2), "ugv_0": STILL})
            metrics = env.metrics()["uav_0"]
            lost = metrics["margin"] <= 0.0
        costs.append(metrics["reward_sight_lost"] + metrics["reward_out_of_sight"])
        if ends:
            assert f"loses sight after {env.world.time:.2f} s" in page
            assert f"receives −{-paid['uav_0']:.0f}." in page
    assert costs == pytest.approx([-394.8, -10.1])
    assert "costs −10.1" in page


def test_the_example_on_the_page_about_rewards_runs(capsys) -> None:
    (block,) = blocks("python", "docs/how-to/rewards.md")
    run_shown(block, "docs/how-to/rewards.md")
    assert capsys.readouterr().out.startswith("[0.")


def test_the_example_of_self_play_improves_the_uav(monkeypatch, capsys) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    options = "--rounds 1 --generations 4 --duration 20"
    monkeypatch.setattr(sys, "argv", ["self_play.py", *options.split()])
    importlib.import_module("self_play").main()
    head, *rows = capsys.readouterr().out.partition("UAV's return")[2].splitlines()[1:]
    assert head.split() == ["UGV", "0", "UGV", "1"]
    paid = [[float(cell) for cell in re.findall(r"(-?[\d.]+) \(", row)] for row in rows]
    assert paid[1][0] > paid[0][0]  # the UAV has learned
    assert [row[0] for row in paid] != [row[1] for row in paid]  # the UGV has changed, too
