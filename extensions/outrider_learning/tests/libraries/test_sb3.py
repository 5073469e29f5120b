"""Stable-Baselines3 on our vector environments: its inputs, step by step, and its learning.

Run by `make learn-test`.
"""

import importlib
import json
import runpy
import sys
import warnings
from pathlib import Path
from typing import ClassVar

import gymnasium
import msgspec
import numpy as np
import pytest
import torch
from episodes import DURATIONS, EXAMPLES, run_example
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers import RecordEpisodeStatistics, RecordVideo
from gymnasium.wrappers.vector import RecordVideo as RecordVectorVideo
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, StopTrainingOnMaxEpisodes
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    SubprocVecEnv,
    VecCheckNan,
    VecMonitor,
    VecNormalize,
    VecVideoRecorder,
)

import outrider
from bus.errors import ScenarioError
from outrider.running.flying import fly
from outrider.running.own_functions import check_own_functions
from outrider_learning.egocentric import Egocentric
from outrider_learning.learned import LearnedPolicy
from outrider_learning.mlp import Mlp, load_policy, save_policy
from outrider_learning.networks import save_network
from outrider_learning.recipe import observation_recipe
from outrider_learning.repeat import ActionRepeat
from outrider_learning.saved import save_sb3_policy
from outrider_learning.sb3 import VecEnvAdapter
from outrider_learning.stacking import Stack
from outrider_learning.suite.evaluation import evaluate
from outrider_learning.suite.tasks import TASKS
from outrider_learning.transformation import Transformed
from pages import blocks, run_shown
from sim.env.observation import one_of_world
from sim.scenario.loading import load_scenario
from sim.scenario.types import Custom
from worlds import equal

EXAMPLE = EXAMPLES / "train_uav.py"
OUTWARDS = np.array([0.3, 0.1])


def _rows(duration=2.0, **settings):
    return outrider.vector_env("escort", num_envs=3, agent="uav_0", duration=duration, **settings)


ENVS = {
    "rows": _rows,
    "dictionaries": lambda **settings: _rows(coverage_patch=(5, 1.0), **settings),
    "wrapped": lambda **settings: Transformed(
        Transformed(_rows(coverage_patch=(5, 1.0), **settings), Egocentric()), Stack(3)
    ),
    "repeated": lambda **settings: ActionRepeat(_rows(**settings), 5),
}


@pytest.mark.parametrize("end", DURATIONS)
@pytest.mark.parametrize("name", ENVS)
def test_the_adapter_says_what_the_vector_environment_says(name, end):
    duration, steps = DURATIONS[end], 560 if end == "terminated" else 90
    raw, adapter = ENVS[name](duration=duration), VecEnvAdapter(ENVS[name](duration=duration))
    adapter.seed(5)
    assert equal(raw.reset(seed=5)[0], adapter.reset())
    rng, returns, lengths, ends = np.random.default_rng(0), np.zeros(3), np.zeros(3, int), 0
    for _ in range(steps):
        offset = OUTWARDS if end == "terminated" else 0.0
        actions = (offset + rng.uniform(-0.05, 0.05, (3, 2))).astype(np.float32)
        seen, rewards, terminated, truncated, raw_infos = raw.step(actions)
        got, paid, dones, infos = adapter.step(actions)
        assert equal(seen, got)
        assert paid.dtype == np.float32
        assert np.array_equal(paid, rewards.astype(np.float32))
        assert np.array_equal(dones, terminated | truncated)
        assert len(infos) == 3
        returns, lengths = returns + rewards, lengths + 1
        for k in range(3):
            assert infos[k]["TimeLimit.truncated"] is bool(truncated[k] and not terminated[k])
            assert ("terminal_observation" in infos[k]) == ("episode" in infos[k]) == dones[k]
            if dones[k]:
                assert equal(
                    one_of_world(raw_infos["final_obs"], k), infos[k]["terminal_observation"]
                )
                assert infos[k]["episode"]["r"] == pytest.approx(returns[k], rel=1e-12)
                assert infos[k]["episode"]["l"] == lengths[k]
                assert infos[k]["episode"]["t"] > 0.0
                assert not equal(infos[k]["terminal_observation"], one_of_world(got, k))
                returns[k], lengths[k], ends = 0.0, 0, ends + 1
                assert (truncated[k], terminated[k]) == (end == "truncated", end == "terminated")
    assert ends >= 3
    raw.close()
    adapter.close()


def test_ended_episode_has_final_infos_and_the_next_its_own():
    raw = _rows(duration=0.1, safety_filter=True)
    adapter = VecEnvAdapter(_rows(duration=0.1, safety_filter=True))
    raw.reset(seed=1)
    adapter.seed(1)
    adapter.reset()
    facts = {"overridden", "certified", "uncertified", "certified_distance"}
    assert adapter.reset_infos[0].keys() == facts
    adapter.reset_infos = [{}, {}, {}]
    for _ in range(2):
        *_, raw_infos = raw.step(np.tile(OUTWARDS, (3, 1)))
        *_, infos = adapter.step(np.tile(OUTWARDS, (3, 1)))
    for k in range(3):
        assert infos[k]["certified_distance"] == raw_infos["final_info"]["certified_distance"][k]
        assert adapter.reset_infos[k]["certified_distance"] == raw_infos["certified_distance"][k]
        assert infos[k]["certified_distance"] != adapter.reset_infos[k]["certified_distance"]


ROOT = Path(__file__).resolve().parents[4]


class _Scripted(VectorEnv):
    """Two worlds with constant rewards and scripted episode ends."""

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, ends):
        self.num_envs, self._ends = 2, list(ends)
        self.single_observation_space = spaces.Box(-9, 9, (1,))
        self.single_action_space = spaces.Box(-1, 1, (1,))
        self.observation_space = batch_space(self.single_observation_space, 2)
        self.action_space = batch_space(self.single_action_space, 2)

    def reset(self, *, seed=None, options=None):
        self.given = (seed, options)
        return np.zeros((2, 1), np.float32), {}

    def step(self, actions):
        terminated, truncated = self._ends.pop(0)
        ended = np.array([terminated or truncated, False])
        infos = (
            {
                "final_obs": np.array([np.full(1, 7.0, np.float32), None], dtype=object),
                "_final_obs": ended,
            }
            if ended[0]
            else {}
        )
        both = np.array([terminated, False]), np.array([truncated, False])
        return np.ones((2, 1), np.float32), np.ones(2), *both, infos


@pytest.mark.parametrize(
    ("terminated", "truncated", "limit"), [(1, 0, False), (0, 1, True), (1, 1, False)]
)
def test_time_limit_is_flagged_only_without_termination(terminated, truncated, limit):
    adapter = VecEnvAdapter(_Scripted([(bool(terminated), bool(truncated))]))
    adapter.reset()
    _, _, dones, infos = adapter.step(np.zeros((2, 1)))
    assert dones.tolist() == [True, False]
    assert infos[0]["TimeLimit.truncated"] is limit
    assert infos[1] == {"TimeLimit.truncated": False}
    assert infos[0]["terminal_observation"] == 7.0


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_another_autoreset_mode_is_refused(mode):
    env = SyncVectorEnv([lambda: gymnasium.make("CartPole-v1")], autoreset_mode=mode)
    with pytest.raises(
        ValueError, match=r"autoreset_mode = \w+: .*allowed: AutoresetMode.SAME_STEP"
    ):
        VecEnvAdapter(env)


def test_seeds_and_options_count_once():
    env = _Scripted([])
    adapter = VecEnvAdapter(env)
    assert adapter.seed(40) == [40, 41]
    adapter.set_options({"a": 1})
    adapter.reset()
    assert env.given == ([40, 41], {"a": 1})
    adapter.reset()
    assert env.given == (None, None)
    adapter.set_options([{"a": 1}, {"a": 2}])
    with pytest.raises(ValueError, match="the worlds share their options"):
        adapter.reset()


def test_attributes_methods_and_layers():
    env = Transformed(_rows(), Stack(2))
    adapter = VecEnvAdapter(env)
    assert adapter.get_attr("agent") == ["uav_0"] * 3
    assert adapter.get_attr("agent", 1) == ["uav_0"]
    assert adapter.get_attr("agent", [0, -1]) == ["uav_0"] * 2
    assert not adapter.has_attr("nonsense")
    adapter.set_attr("agent", "ugv_0")
    assert env.unwrapped.agent == "ugv_0"
    with pytest.raises(ValueError, match="the worlds share"):
        adapter.set_attr("agent", "uav_0", indices=[0])
    adapter.set_attr("agent", "uav_0")
    adapter.reset()
    (metrics,) = adapter.env_method("metrics", indices=2)
    assert metrics["uav_0"]["ticks"].shape == (3,)
    assert adapter.env_is_wrapped(Transformed) == [True] * 3
    assert adapter.env_is_wrapped(ActionRepeat, indices=[0]) == [False]
    assert adapter.env_is_wrapped(Monitor) == [True] * 3
    assert adapter.render_mode is None


def test_truncated_end_is_bootstrapped_from_its_last_observation():
    class Recorded(VecEnvAdapter):
        steps: ClassVar = []

        def step_wait(self):
            seen, rewards, dones, infos = super().step_wait()
            # the library changes the rewards in place
            self.steps.append((rewards.copy(), dones, infos))
            return seen, rewards, dones, infos

    class Compare(BaseCallback):
        ends = 0

        def _on_step(self):
            return True

        def _on_rollout_end(self):
            for t, (rewards, dones, infos) in enumerate(Recorded.steps):
                expected = rewards.copy()
                for k in np.flatnonzero(dones):
                    assert infos[k]["TimeLimit.truncated"]
                    last = torch.as_tensor(infos[k]["terminal_observation"][None])
                    with torch.no_grad():
                        expected[k] += 0.9 * float(self.model.policy.predict_values(last))
                    self.ends += 1
                assert np.allclose(self.model.rollout_buffer.rewards[t], expected, atol=1e-6)

    compare = Compare()
    env = Recorded(_rows(duration=1.0))
    PPO(
        "MlpPolicy", env, n_steps=45, batch_size=45, n_epochs=1, gamma=0.9, seed=0, device="cpu"
    ).learn(135, callback=compare)
    assert compare.ends == 6


def test_the_library_s_own_wrappers_and_its_evaluation():
    env = VecNormalize(
        VecMonitor(VecCheckNan(VecEnvAdapter(_rows(duration=1.0)), raise_exception=True))
    )
    model = PPO("MlpPolicy", env, n_steps=20, batch_size=60, device="cpu", seed=0).learn(120)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mean, _ = evaluate_policy(model, VecEnvAdapter(_rows(duration=1.0)), n_eval_episodes=3)
    assert -5.0 < mean < 0.0


@pytest.mark.parametrize(
    ("name", "policy"), [("rows", "MlpPolicy"), ("dictionaries", "MultiInputPolicy")]
)
def test_ppo_learns_saves_and_loads(name, policy, tmp_path):
    adapter = VecEnvAdapter(ENVS[name](duration=1.0))
    model = PPO(
        policy, adapter, n_steps=100, batch_size=300, n_epochs=2, seed=3, device="cpu"
    ).learn(3000)
    assert model.num_timesteps == 3000
    assert len(model.ep_info_buffer) == 100
    assert all(one["l"] == 20 for one in model.ep_info_buffer)
    adapter.seed(9)
    seen = adapter.reset()
    model.save(tmp_path / "model.zip")
    loaded = PPO.load(tmp_path / "model.zip", env=adapter, device="cpu")
    assert np.array_equal(
        loaded.predict(seen, deterministic=True)[0], model.predict(seen, deterministic=True)[0]
    )
    loaded.learn(300)


def test_the_example_trains_briefly_and_what_it_writes_flies(tmp_path):
    out = tmp_path / "uav.npz"
    done = run_example(EXAMPLE, f"--minutes 0.2 --num-envs 16 --seed 2 --out {out}", tmp_path)
    assert "mean e(t)" in done.stdout
    network, recipe = load_policy(out)
    assert recipe["trained"]["decisions"] > 0
    assert recipe["trained"]["ticks"] == 10 * recipe["trained"]["decisions"]
    assert json.loads(json.dumps(recipe)) == recipe
    model = PPO.load(out.with_suffix(".zip"), device="cpu")
    shown = (
        np.random.default_rng(0)
        .uniform(-1.0, 1.0, (50, network.weights[0].shape[1]))
        .astype(np.float32)
    )
    by_torch, _ = model.predict(shown, deterministic=True)
    assert np.allclose(np.clip(network(shown), -1.0, 1.0), by_torch, atol=1e-5)
    assert LearnedPolicy.load(out).setup["estimate"]


def test_the_example_refuses_what_it_cannot_do(capsys, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLE.parent)  # as `python examples/train_uav.py` does
    monkeypatch.setattr(sys, "argv", ["train_uav.py", "--minutes", "0"])
    with pytest.raises(SystemExit):
        runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert "--minutes must be positive" in capsys.readouterr().err


def test_team_trains_briefly_in_a_minefield_and_is_listed(tmp_path):
    options = "--minutes 0.01 --worlds 2 --flights 1 --laws none"
    output_text = run_example(EXAMPLES / "train_mission.py", options, tmp_path).stdout
    (head,) = [line for line in output_text.splitlines() if line.startswith("| task | ")]
    assert set(head.strip("| ").split(" | ")) == {"task", "none", "untrained", "learned"}
    assert output_text.count(" of 1 arrived in ") == 3


ESCORT = "outrider/Escort-v0"


def test_ppo_takes_the_environment_by_its_name_past_two_episodes():
    model = PPO("MlpPolicy", ESCORT, n_steps=512, n_epochs=1, seed=1, device="cpu")
    model.learn(40_000, callback=StopTrainingOnMaxEpisodes(3))
    assert model.get_env().render_mode == "rgb_array"
    assert len(model.ep_info_buffer) >= 2
    assert all(one["l"] > 10 for one in model.ep_info_buffer)


@pytest.mark.parametrize("kind", ["here", "processes"])
def test_vec_envs_as_rl_zoo_makes_them(kind, tmp_path):
    """Make them from the environment's spec, with the zoo's arguments, and record videos of more than an episode."""
    spec = gymnasium.spec(ESCORT)
    # A spawned process has not imported outrider: the name says where it is.
    many = {"vec_env_cls": SubprocVecEnv, "vec_env_kwargs": {"start_method": "spawn"}}
    env = make_vec_env(
        f"outrider.registration:{ESCORT}" if kind == "processes" else spec.make,
        n_envs=2,
        seed=3,
        env_kwargs={"duration": 0.5}
        | ({} if kind == "processes" else {"render_mode": "rgb_array"}),
        monitor_dir=str(tmp_path / "monitor"),
        monitor_kwargs={"info_keywords": ()},
        wrapper_class=None,
        **(many if kind == "processes" else {}),
    )
    film = VecVideoRecorder(
        env, str(tmp_path / "videos"), record_video_trigger=lambda step: step == 0, video_length=15
    )
    film.reset()
    ends = 0
    for _ in range(25):
        _, _, dones, infos = film.step(np.zeros((2, 2)))
        ends += sum(dones)
        assert all(("episode" in info) == done for info, done in zip(infos, dones, strict=True))
    film.close()
    assert ends == 4
    assert len(list((tmp_path / "videos").glob("*.mp4"))) == 1
    assert len(list((tmp_path / "monitor").glob("*.csv"))) == 2


def test_the_adapter_s_worlds_are_filmed(tmp_path):
    adapter = VecEnvAdapter(_rows(duration=0.5, render_mode="rgb_array"))
    assert adapter.render_mode == "rgb_array"
    film = VecVideoRecorder(adapter, str(tmp_path), lambda step: step == 0, video_length=12)
    film.reset()
    for _ in range(15):
        film.step(np.zeros((3, 2)))
    assert film.render().ndim == 3
    film.close()
    assert len(list(tmp_path.glob("*.mp4"))) == 1


def test_a_loop_as_cleanrl_writes_it_records_every_episode(tmp_path):
    def make(idx):
        def thunk():
            mode = {"render_mode": "rgb_array"} if idx == 0 else {}
            env = gymnasium.make(ESCORT, duration=0.5, **mode)
            env = RecordVideo(env, str(tmp_path), episode_trigger=lambda _: True) if mode else env
            env = RecordEpisodeStatistics(env)
            env.action_space.seed(1)
            return env

        return thunk

    envs = SyncVectorEnv([make(k) for k in range(2)], autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=1)
    lengths = []
    for _ in range(25):
        *_, infos = envs.step(envs.action_space.sample())
        if "final_info" in infos:
            lengths += infos["final_info"]["episode"]["l"].tolist()
    envs.close()
    assert lengths == [10] * 4
    assert len(list(tmp_path.glob("*.mp4"))) == 3


def test_gymnasium_films_the_worlds_of_a_vector_environment(tmp_path):
    env = _rows(duration=0.5, render_mode="rgb_array")
    env = RecordVectorVideo(env, str(tmp_path), episode_trigger=lambda _: True)
    env.reset(seed=1)
    for _ in range(25):
        env.step(np.zeros((3, 2)))
    env.close()
    assert len(list(tmp_path.glob("*.mp4"))) >= 2


SCENARIO = "escort"


def _trained(make, tmp_path, **settings):
    """Train a model briefly in these wrappers, and save it with its observation recipe."""
    env = make(outrider.vector_env(SCENARIO, num_envs=2, duration=5.0, **settings))
    env.reset()
    model = PPO("MlpPolicy", env, n_steps=40, batch_size=40, n_epochs=1, seed=2, device="cpu")
    model.learn(320)
    save_sb3_policy(model, tmp_path / "model.zip")
    return model, f"sb3:ppo:{tmp_path / 'model.zip'}"


SAVED = {
    "rows": VecEnvAdapter,
    "stacked": lambda env: VecMonitor(VecEnvAdapter(Transformed(env, Stack(2)))),
    "running": lambda env: VecNormalize(VecEnvAdapter(ActionRepeat(env, 5))),
}


@pytest.mark.parametrize("kind", SAVED)
@pytest.mark.parametrize("law", ["certified", "policy"])
def test_what_was_learned_flies_a_run_on_what_it_was_trained_on(kind, law, tmp_path):
    model, name = _trained(SAVED[kind], tmp_path, estimate=True, safety_filter=law == "certified")
    changes = {"law.name": law, "custom.uav_policy": name, "duration": 5.0, "links.profile": "wifi"}
    scenario = load_scenario(SCENARIO, overrides=changes)
    assert check_own_functions(scenario) == ()
    flight, _ = fly(scenario, 4)
    # the same model in its own wrappers
    plain = msgspec.structs.replace(scenario, custom=Custom(), law=load_scenario().law)
    env = SAVED[kind](
        outrider.vector_env(
            plain,
            num_envs=1,
            estimate=True,
            safety_filter=law == "certified",
            end_on_sight_lost=False,
        )
    )
    if kind == "running":
        env.obs_rms, env.training = model.get_env().obs_rms, False
    env.seed(4)
    seen = env.reset()
    worlds = env.unwrapped.env.unwrapped.worlds
    for k in range(0, 95, 5 if kind == "running" else 1):
        truth = worlds.loop.state.batch.vehicles["position"][0]
        np.testing.assert_allclose(truth, flight.recorder.states[k, :, :2], atol=1e-6)
        seen, *_ = env.step(model.predict(seen, deterministic=True)[0])


def test_a_model_of_plain_rows_flies_and_a_stacked_one_does_not(tmp_path):
    model = PPO("MlpPolicy", ESCORT, n_steps=8, batch_size=8, device="cpu")
    model.save(tmp_path / "plain.zip")
    assert observation_recipe(model.get_env()).layers == ()
    name = f"sb3:ppo:{tmp_path / 'plain.zip'}"
    changes = {"custom.uav_policy": name, "duration": 2.0}
    assert fly(load_scenario(SCENARIO, overrides=changes), 1)[1].ticks == 40
    (task,) = (one for one in TASKS if one.name == "short-sight")
    assert evaluate(task, outrider.load_policy(name), seeds=[9000], safety_filter=True).score > 0.0
    _, name = _trained(SAVED["stacked"], tmp_path)
    (tmp_path / "model.json").unlink()
    with pytest.raises(ScenarioError, match=r"shape \(2, 9\) are not the UAV's row"):
        outrider.load_policy(name)
    _, name = _trained(SAVED["stacked"], tmp_path)
    recipe = json.loads((tmp_path / "model.json").read_text())
    recipe["layers"] = []
    (tmp_path / "model.json").write_text(json.dumps(recipe))
    with pytest.raises(ScenarioError, match=r"observations of shape \(2, 9\)"):
        outrider.load_policy(name)


def test_network_file_acts_like_its_model(tmp_path):
    model, name = _trained(SAVED["running"], tmp_path, omit=("time", "position"), gradient=True)
    save_network(model, tmp_path / "model.npz", trained={"seed": 2})
    alone = outrider.load_policy(f"npz:{tmp_path / 'model.npz'}")
    policy = outrider.load_policy(name)
    assert alone.setup == policy.setup
    env = outrider.vector_env(SCENARIO, num_envs=2, **alone.setup)
    seen, _ = env.reset(seed=3)
    for _ in range(30):
        action = policy(seen)
        np.testing.assert_allclose(alone(seen), action, atol=1e-5)
        seen, *_ = env.step(action)
    save_policy(
        tmp_path / "other.npz",
        Mlp((np.ones((2, 9)),), (np.ones(2),)),
        load_policy(tmp_path / "model.npz")[1],
    )
    with pytest.raises(ScenarioError, match="9 inputs, 2 outputs; the recipe needs 8 inputs"):
        outrider.load_policy(f"npz:{tmp_path / 'other.npz'}")


def test_learning_page_trains_and_evaluates(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = "docs/how-to/learning.md"
    train, evaluate_it = blocks("python", page)[:2]
    assert "learn(60_000)" in train
    run_shown(train.replace("60_000", "4096"), page)
    assert torch.get_num_threads() == 1
    run_shown(evaluate_it, page)
    assert "sight lost in 0 of 3 episodes" in capsys.readouterr().out


def test_published_baseline_curves_have_the_words_of_the_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in (ROOT / "benchmarks", ROOT / "tests"):
        monkeypatch.syspath_prepend(folder)
    baselines, pages = map(importlib.import_module, ("baselines", "pages"))
    monkeypatch.setattr(baselines, "PICTURE", tmp_path / "drawn.png")
    for one in baselines.BASELINES:
        for law in baselines.LAWS:
            (tmp_path / f"{one.scenario}-{law}.json").write_text("[50.0, 0]")
    for _, _, _, file in baselines.jobs(tmp_path):
        file.write_text('{"curve": [[0, 0.0, 10.0], [1, 1.0, 20.0]]}')
    baselines.draw(tmp_path)
    published = ROOT / "docs" / "how-to" / "baselines.png"
    assert pages.words(published) == pages.words(tmp_path / "drawn.png")
