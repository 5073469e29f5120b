"""TorchRL with the environment: specs, values, episode ends, bootstrapping, example. Run by `make learn-test`."""

import json
import runpy

import numpy as np
import pytest
import torch
from episodes import APART, DURATIONS, EXAMPLES, flown, run_example
from torchrl.envs import GymWrapper, PettingZooWrapper
from torchrl.envs.utils import check_env_specs

import outrider
from outrider_learning.stacking import Stack
from outrider_learning.torchrl_env import OutriderTorchEnv
from outrider_learning.transformation import Transformed
from sim.scenario.loading import load_scenario

pytestmark = pytest.mark.filterwarnings(
    "ignore:PettingZoo in TorchRL is tested using:UserWarning",
    "ignore::DeprecationWarning",
    "ignore::FutureWarning",
)

EXAMPLE = EXAMPLES / "train_torchrl.py"
MAKE = {
    "raw": outrider.parallel_env,
    "float32": lambda *args, **options: outrider.parallel_env(*args, **options, dtype=np.float32),
    "coverage": lambda *args, **options: outrider.parallel_env(
        *args, **options, coverage_patch=(8, 1.0)
    ),
}


def put(frame, actions):
    """Write the actions to the entries that TorchRL reads."""
    for name, action in actions.items():
        frame["uav" if name == "uav_0" else "ugv", "action"] = torch.as_tensor(action)[None]
    return frame


@pytest.mark.parametrize("kind", MAKE)
@pytest.mark.parametrize("return_state", [False, True])
def test_torchrls_own_check_passes(kind, return_state):
    check_env_specs(
        PettingZooWrapper(MAKE[kind]("escort", duration=2.0), return_state=return_state)
    )


@pytest.mark.parametrize("kind", ["raw", "float32"])
@pytest.mark.parametrize("end", DURATIONS)
def test_an_episode_is_the_bare_environments_to_its_end(kind, end):
    bare, env = (MAKE[kind]("escort", duration=DURATIONS[end]) for _ in range(2))
    env = PettingZooWrapper(env, return_state=True)
    bare.reset(seed=5)
    frame = env.reset(seed=5)
    np.testing.assert_array_equal(frame["state"].numpy(), bare.state())
    for observations, actions, answers in flown(bare, end):
        for name, group in (("uav_0", "uav"), ("ugv_0", "ugv")):
            seen = frame[group, "observation"][0].numpy()
            np.testing.assert_array_equal(seen, observations[name])
            assert bare.observation_space(name).contains(seen)
        assert env.observation_spec.is_in(frame.select(*env.observation_spec.keys(True, True)))
        last, rewards, terminations, truncations, _ = answers
        frame = env.step(put(frame, actions))["next"]
        np.testing.assert_array_equal(frame["state"].numpy(), bare.state())
        for name, group in (("uav_0", "uav"), ("ugv_0", "ugv")):
            assert frame[group, "reward"].item() == np.float32(rewards[name])
            assert (
                frame[group, "terminated"].item()
                == terminations[name]
                == frame["terminated"].item()
            )
            assert (
                frame[group, "truncated"].item() == truncations[name] == frame["truncated"].item()
            )
            assert frame[group, "done"].item() == (not bare.agents)
    assert frame[end].item()
    assert not frame["truncated" if end == "terminated" else "terminated"].item()
    np.testing.assert_array_equal(frame["uav", "observation"][0].numpy(), last["uav_0"])
    ticks = bare.unwrapped.world.tick
    assert ticks == 40 if end == "truncated" else 100 < ticks < 600


def test_only_a_termination_ends_the_future():
    """The advantages of a batch with both ends, against the recursion written out, on the last observation of each
    episode.
    """
    example = runpy.run_path(str(EXAMPLE))
    torch.manual_seed(0)
    env = example["make_env"](12.0)
    learner = example["Learner"](env, "uav")
    env.set_seed(3)
    frame, episode, flown = env.reset(), 0, []
    for _ in range(100):
        step, frame = env.step_and_maybe_reset(
            put(frame, {name: (episode % 2) * push for name, push in APART.items()})
        )
        flown.append(step)
        episode += step["next", "done"].item()
    frames = torch.stack(flown)
    ended, terminated = frames["next", "done"].flatten(), frames["next", "terminated"].flatten()
    assert terminated.any()
    assert (ended & ~terminated).any()
    with torch.no_grad():
        learner.advantages(frames)
        value = learner.advantages.value_network
        now, after = (
            value(part.clone())["uav", "state_value"].flatten() for part in (frames, frames["next"])
        )
    rewards = frames["next", "uav", "reward"].flatten()
    expected, carried = torch.zeros(len(frames)), 0.0
    for k in reversed(range(len(frames))):
        error = rewards[k] + example["DISCOUNT"] * after[k] * (not terminated[k]) - now[k]
        expected[k] = carried = error + example["DISCOUNT"] * example["TRACE"] * carried * (
            not ended[k]
        )
    torch.testing.assert_close(frames["uav", "advantage"].flatten(), expected, rtol=1e-4, atol=1e-4)
    last = int(ended.nonzero()[0])
    # the last observation of the old episode
    assert frames["next", "uav", "observation"][last, 0, 0] > 1.0  # the time [s]
    assert frames["uav", "observation"][last + 1, 0, 0] == 0.0


@pytest.mark.parametrize("wrapped", [False, True])
def test_gym_wrapper_steps_many_worlds_past_their_ends(wrapped):
    bare, inner = (outrider.vector_env("escort", num_envs=2, duration=0.5) for _ in range(2))
    if wrapped:
        bare, inner = (Transformed(env, Stack(3)) for env in (bare, inner))
    env = GymWrapper(inner)
    seen, _ = bare.reset(seed=5)
    frame = env.reset(seed=5)
    ends = 0
    for _ in range(25):
        np.testing.assert_array_equal(frame["observation"].numpy(), seen)
        actions = env.action_spec.rand()
        seen, rewards, terminated, truncated, infos = bare.step(actions.numpy())
        step, frame = env.step_and_maybe_reset(frame.set("action", actions))
        np.testing.assert_allclose(step["next", "reward"][:, 0].numpy(), rewards, rtol=1e-6)
        assert step["next", "done"][:, 0].tolist() == (terminated | truncated).tolist()
        if "final_obs" in infos:
            ends += 1
            last = np.stack(infos["final_obs"])
            np.testing.assert_array_equal(step["next", "observation"].numpy(), last)
            seen, _ = bare.reset()  # TorchRL resets again where all worlds end at once
    assert ends == 2


def test_gym_wrapper_steps_one_world_past_its_end():
    env = GymWrapper(outrider.single_env("escort", duration=0.5))
    check_env_specs(env)
    frames = env.rollout(25, break_when_any_done=False)
    assert int(frames["next", "truncated"].sum()) == 2


def test_policies_see_no_state():
    example = runpy.run_path(str(EXAMPLE))
    env = example["make_env"](1.0)
    for group in env.group_map:
        learner = example["Learner"](env, group)
        assert learner.actor.in_keys == [(group, "observation")]
        assert learner.advantages.value_network.in_keys == ["state"]


@pytest.mark.parametrize(
    ("scenario", "options"),
    [
        pytest.param(load_scenario("escort"), {}, id="escort"),
        pytest.param(load_scenario("escort"), {"safety_filter": True}, id="filter"),
        pytest.param(load_scenario("town"), {"safety_filter": True}, id="town"),
        pytest.param(load_scenario("minefield"), {}, id="minefield"),
        pytest.param(load_scenario("escort", overrides=["links.profile=jammed"]), {}, id="jammed"),
    ],
)
def test_torchrl_flies_into_the_third_episode(scenario, options):
    env = PettingZooWrapper(
        outrider.parallel_env(scenario, duration=0.5, end_on_sight_lost=False, **options),
        return_state=True,
    )
    check_env_specs(env)
    frames = env.rollout(25, break_when_any_done=False)
    assert int(frames["next", "truncated"].sum()) == 2
    if options:
        assert frames["next", "uav", "info", "uncertified"].shape == (25, 1)
    if scenario.has_ground:
        times = frames["next", "ugv", "info", "stationary_time"].flatten()
        assert torch.equal(torch.isfinite(times), frames["next", "truncated"].flatten())


@pytest.mark.parametrize(
    ("scenario", "options"),
    [
        ("escort", {"repeat": 3}),
        ("escort", {"coverage_patch": (8, 1.0), "agents": ["uav_0"], "safety_filter": True}),
        ("town", {"dtype": np.float64}),
        ("minefield", {"gradient": True, "omit": ("time",)}),
    ],
)
def test_torchrls_own_check_of_many_worlds_passes(scenario, options):
    env = OutriderTorchEnv(scenario, num_envs=3, duration=1.5, seed=2, **options)
    assert env.batch_size == (3,)
    check_env_specs(env)
    frames = env.rollout(70, break_when_any_done=False)
    assert int(frames["next", "truncated"].sum()) >= 3
    env.close()


def test_worlds_of_a_batch_end_and_restart_one_by_one():
    """Compare with single environments that restart where they end, the last state and observation included."""
    env = OutriderTorchEnv("escort", num_envs=3, duration=20.0, dtype=np.float64)
    singles = [outrider.parallel_env("escort", duration=20.0) for _ in range(3)]
    env.set_seed(7)
    frame, starts = env.reset(), [one.reset(seed=7 + k)[0] for k, one in enumerate(singles)]
    ends = []
    for tick in range(430):
        for k, one in enumerate(singles):
            np.testing.assert_array_equal(frame["state"][k].numpy(), one.state())
            np.testing.assert_array_equal(frame["uav", "observation"][k, 0], starts[k]["uav_0"])
        push = torch.tensor([[0.0, 0.0], [0.2, 0.1], [0.3, -0.2]])
        frame["uav", "action"] = push[:, None]
        frame["ugv", "action"] = torch.zeros(3, 1, 2)
        step, frame = env.step_and_maybe_reset(frame)
        for k, one in enumerate(singles):
            actions = {"uav_0": push[k].double().numpy(), "ugv_0": [0.0, 0.0]}
            last, rewards, terminations, truncations, _ = one.step(actions)
            after = step["next"][k]
            np.testing.assert_array_equal(after["state"].numpy(), one.state())
            np.testing.assert_array_equal(after["uav", "observation"][0], last["uav_0"])
            assert after["uav", "reward"].item() == np.float32(rewards["uav_0"])
            assert after["terminated"].item() == terminations["uav_0"]
            assert after["ugv", "truncated"].item() == truncations["ugv_0"]
            starts[k] = last
            if not one.agents:
                ends.append((k, tick))
                starts[k] = one.reset()[0]
    assert {k for k, _ in ends} == {0, 1, 2}
    assert len({tick for _, tick in ends}) > 2


def test_batched_groups_are_checked():
    with pytest.raises(ValueError, match="each of uav_0, ugv_0 in one group"):
        OutriderTorchEnv("escort", num_envs=1, group_map={"uav": ["uav_0"]})
    with pytest.raises(ValueError, match="spaces of different shapes"):
        OutriderTorchEnv("escort", num_envs=1, group_map={"all": ["uav_0", "ugv_0"]})


def test_the_example_learns_saves_and_evaluates(tmp_path):
    done = run_example(EXAMPLE, "--steps 2000 --duration 5 --out out", tmp_path)
    assert "Warning" not in done.stderr
    assert "2000 steps" in done.stdout
    returns = json.loads((tmp_path / "out" / "evaluation.json").read_text())["returns"]
    assert returns.keys() == {"learned", "pilots"}
    assert all(np.isfinite(mean) for means in returns.values() for mean in means.values())
    assert torch.load(tmp_path / "out" / "policies.pt", weights_only=True).keys() == {"uav", "ugv"}


def test_mappo_in_many_worlds_learns_and_is_scored(tmp_path):
    options = "--steps 1 --duration 5 --seeds 1 --out out"
    done = run_example(EXAMPLES / "train_torchrl_worlds.py", options, tmp_path)
    assert "1920 steps" in done.stdout
    assert "sight lost in 0 of 1 episodes" in done.stdout
    assert torch.load(tmp_path / "out" / "policies.pt", weights_only=True).keys() == {"uav", "ugv"}


@pytest.mark.parametrize("algorithm", ["mappo", "ippo"])
def test_a_team_learns_and_its_policy_flies(algorithm, tmp_path):
    """The saved network acts as the actor's mean, in the worlds of the training."""
    options = f"--algorithm {algorithm} --steps 1 --seed 3 --out out"
    done = run_example(EXAMPLES / "train_team.py", options, tmp_path)
    file = tmp_path / "out" / f"{algorithm}-scouts-3.npz"
    points = file.with_suffix(".csv").read_text().splitlines()
    assert points[0] == "decisions,minutes,score,mean_error"
    assert [int(line.split(",")[0]) for line in points[1:]] == [0, 1600]
    assert "1600 decisions" in done.stdout
    policy = outrider.load_policy(f"npz:{file}")
    env = outrider.parallel_vector_env("scouts", num_envs=2, agents=["uav_1"], **policy.setup)
    seen, _ = env.reset(seed=1)
    assert np.abs(policy(seen["uav_1"])).max() <= 0.3
    env.close()


def test_the_saved_network_of_a_team_is_the_actors_mean(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    example = runpy.run_path(str(EXAMPLES / "train_team.py"))
    torch.manual_seed(0)
    env = example["make_env"](example["TEAMS"][0], 2)
    team = example["Team"](env, "ippo")
    team.save(tmp_path / "team.npz")
    policy = outrider.load_policy(f"npz:{tmp_path / 'team.npz'}")
    env.set_seed(5)
    frame = env.reset()
    rows = frame["uav", "observation"]
    with torch.no_grad():
        expected = team.learner.actor.get_dist(frame).mean[:, 0].numpy()
    whole = np.zeros((2, rows.shape[-1] + 3), np.float64)  # with time and position
    whole[:, 3:] = rows[:, 0]
    np.testing.assert_allclose(policy(whole), expected, rtol=1e-4, atol=1e-6)
    assert np.abs(expected).max() > 1e-4
    env.close()
