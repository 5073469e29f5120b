"""SuperSuit's conversions meet the environment: values, ends, seeds, and the example. Run by `make learn-test`."""

import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import PPO

import outrider
from outrider.envs.wrappers import normalized

EXAMPLE = Path(__file__).parents[1] / "examples" / "supersuit_sb3.py"


@pytest.fixture(scope="module")
def make_env():
    return runpy.run_path(str(EXAMPLE))["make_env"]


@pytest.mark.parametrize("end", ["terminated", "truncated"])
def test_an_episode_is_the_bare_environments_to_its_end(make_env, end):
    duration = 30.0 if end == "terminated" else 2.0
    bare = normalized(outrider.parallel_env("escort", duration=duration))
    env = make_env(1, duration=duration, seed=5)
    expected, _ = bare.reset(seed=5)
    seen, _ = env.venv.reset(seed=5)  # SB3's own reset() begins the next episode
    rng = np.random.default_rng(0)
    dones = [False, False]
    while bare.agents:
        np.testing.assert_array_equal(seen[0], expected["uav_0"])
        np.testing.assert_array_equal(seen[1], np.append(expected["ugv_0"], np.float32(0.0)))
        assert all(env.observation_space.contains(row) for row in seen)
        actions = (
            np.array([[0.3, 0.0], [-0.1, 0.0]])
            if end == "terminated"
            else rng.uniform(-0.3, 0.3, (2, 2))
        )
        expected, rewards, terminations, truncations, _ = bare.step(
            {"uav_0": actions[0], "ugv_0": actions[1]}
        )
        seen, paid, dones, infos = env.step(actions)
        assert paid.tolist() == [np.float32(rewards["uav_0"]), np.float32(rewards["ugv_0"])]
        assert list(dones) == [not bare.agents] * 2
        assert [info["TimeLimit.truncated"] for info in infos] == [
            truncations["uav_0"] and not terminations["uav_0"]
        ] * 2
    assert all(dones)
    assert infos[0]["TimeLimit.truncated"] is (end == "truncated")
    np.testing.assert_array_equal(infos[0]["terminal_observation"], expected["uav_0"])
    np.testing.assert_array_equal(seen[0], bare.reset()[0]["uav_0"])  # the next episode's first
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
    command = [
        sys.executable,
        str(EXAMPLE),
        "--steps",
        "2000",
        "--duration",
        "5",
        "--out",
        str(tmp_path / "out"),
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=170, cwd=tmp_path, check=False
    )
    assert done.returncode == 0, done.stderr
    model = PPO.load(tmp_path / "out" / "policy.zip", device="cpu")
    assert model.num_timesteps >= 2000
    assert model.observation_space.shape == (9,)
