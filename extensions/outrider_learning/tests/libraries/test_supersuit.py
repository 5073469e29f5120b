"""SuperSuit's conversions of the environment: values, episode ends, seeds, the example. Run by `make learn-test`."""

import runpy

import numpy as np
import pytest
import supersuit
from episodes import DURATIONS, EXAMPLES, flown, run_example
from stable_baselines3 import PPO

import outrider

EXAMPLE = EXAMPLES / "supersuit_sb3.py"


def normalized(*, duration):
    """Return the bare environment, rescaled like in the example."""
    env = outrider.parallel_env("escort", duration=duration, dtype=np.float32)
    return supersuit.normalize_obs_v0(env, env_min=-1, env_max=1)


@pytest.fixture(scope="module")
def make_env():
    return runpy.run_path(str(EXAMPLE))["make_env"]


@pytest.mark.parametrize("end", DURATIONS)
def test_an_episode_is_the_bare_environments_to_its_end(make_env, end):
    bare = normalized(duration=DURATIONS[end])
    env = make_env(1, duration=DURATIONS[end], seed=5)
    seen, _ = env.venv.reset(seed=5)  # reset() of SB3 starts the next episode
    for expected, actions, answers in flown(bare, end):
        np.testing.assert_array_equal(seen[0], expected["uav_0"])
        np.testing.assert_array_equal(seen[1], np.append(expected["ugv_0"], np.float32(0.0)))
        assert all(env.observation_space.contains(row) for row in seen)
        last, rewards, terminations, truncations, _ = answers
        seen, paid, dones, infos = env.step(np.array([actions["uav_0"], actions["ugv_0"]]))
        assert paid.tolist() == [np.float32(rewards["uav_0"]), np.float32(rewards["ugv_0"])]
        assert list(dones) == [not bare.agents] * 2
        assert [info["TimeLimit.truncated"] for info in infos] == [
            truncations["uav_0"] and not terminations["uav_0"]
        ] * 2
    assert all(dones)
    assert infos[0]["TimeLimit.truncated"] is (end == "truncated")
    np.testing.assert_array_equal(infos[0]["terminal_observation"], last["uav_0"])
    np.testing.assert_array_equal(
        seen[0], bare.reset()[0]["uav_0"]
    )  # the first step of the next episode
    env.close()


def test_each_world_flies_episodes_of_its_own(make_env):
    def fly():
        env = make_env(4, duration=1.0, seed=1)
        return np.array([env.reset(), *(env.step(np.zeros((8, 2)))[0] for _ in range(39))])

    rows = fly()[:, ::2]  # the UAVs'
    episodes = [
        rows[begin : begin + 20, world].tobytes() for begin in (0, 20) for world in range(4)
    ]
    assert len(set(episodes)) == 8
    np.testing.assert_array_equal(fly()[:, ::2], rows)


def test_the_example_learns_and_saves(tmp_path):
    run_example(EXAMPLE, "--steps 2000 --duration 5 --out out", tmp_path)
    model = PPO.load(tmp_path / "out" / "policy.zip", device="cpu")
    assert model.num_timesteps >= 2000
    assert model.observation_space.shape == (9,)


def test_frame_skip_goes_past_the_first_episode_of_one_learner():
    env = supersuit.frame_skip_v0(outrider.single_env("escort", duration=0.5), (2, 4))
    lengths = []
    for _ in range(3):
        env.reset(seed=1)
        steps, over = 0, False
        while not over:
            *_, terminated, truncated, _ = env.step(np.zeros(2))
            steps, over = steps + 1, terminated or truncated
        lengths.append(steps)
    assert lengths == lengths[:1] * 3
    assert 3 <= lengths[0] <= 5


def test_frame_skip_goes_past_the_first_episode_of_all_vehicles():
    env, bare = (normalized(duration=0.5) for _ in range(2))
    env = supersuit.frame_skip_v0(env, 4)
    for _ in range(2):
        env.reset(seed=1)
        bare.reset(seed=1)
        for ticks in (4, 4, 2):
            still = dict.fromkeys(env.agents, np.zeros(2))
            seen, paid, *_ = env.step(still)
            plain = [bare.step(still) for _ in range(ticks)]
            np.testing.assert_array_equal(seen["uav_0"], plain[-1][0]["uav_0"])
            assert paid["uav_0"] == pytest.approx(sum(one[1]["uav_0"] for one in plain))
        assert not env.agents


def test_black_death_never_ends_an_episode():
    """Show a fault of SuperSuit, see docs/how-to/learning.md; once it is fixed, delete it there."""
    env = supersuit.black_death_v3(outrider.parallel_env("escort", duration=0.1))
    env.reset(seed=1)
    for _ in range(2):
        *_, truncations, _ = env.step(dict.fromkeys(env.agents, np.zeros(2)))
    assert not any(truncations.values())
    assert env.agents
