"""The learned UAV: its file, single and batched flights, its table; all without a learning library."""

import importlib
import json
import os
import random
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv
from gymnasium.vector.utils import batch_space

import outrider
from bus.errors import ScenarioError
from bus.messages.ground import Hazard
from outrider.envs.env_pilots import pilots
from outrider.envs.worlds import Worlds
from outrider_learning.learned import LearnedPolicy, make_view
from outrider_learning.mlp import Mlp, load_policy, save_policy
from outrider_learning.networks import load_npz_policy
from outrider_learning.repeat import ActionRepeat
from outrider_learning.transformation import Transformed
from refusals import refused
from sim.models.ground import CLEAR
from sim.scenario.loading import load_scenario
from tabular import words
from worlds import raw

EXAMPLES = Path(__file__).parents[3] / "examples"
POLICY = EXAMPLES / "policies" / "uav_ppo.npz"
SEEDS = [41, 42, 43]
NOISY = msgspec.structs.replace(load_scenario("escort"), duration=30.0)


@pytest.fixture
def evaluation(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return importlib.import_module("evaluation")


def test_the_shipped_file_is_small_and_says_how_it_was_made(evaluation: ModuleType) -> None:
    network, recipe = load_policy(POLICY)
    assert POLICY.stat().st_size < 300_000
    assert recipe["algorithm"] == "PPO"
    assert recipe["trained"]["ticks"] == recipe["repeat"] * recipe["trained"]["decisions"] > 1e6
    fields = "seed num_envs rewards versions scenario driver curve"
    assert set(words(fields)) <= recipe.keys()
    assert recipe["seed"] * 100 + recipe["num_envs"] < evaluation.VALIDATION_SEEDS[0]
    assert network.weights[-1].shape[0] == 2


def test_it_flies_a_single_environment_as_it_flies_a_batch() -> None:
    policies = {name: LearnedPolicy.load(POLICY) for name in ("batch", "single")}
    noisy = raw(NOISY)
    worlds = Worlds(noisy, len(SEEDS), ["uav_0"], safety_filter=True, **policies["batch"].setup)
    worlds.reset(SEEDS, None)
    k = 1
    env = outrider.parallel_env(noisy, safety_filter=True, **policies["single"].setup)
    drive = pilots(env)["ugv_0"]
    seen, _ = env.reset(seed=SEEDS[k])
    for _ in range(500):
        observed = worlds.observe("uav_0")
        assert all(
            np.array_equal(observed[key][k], seen["uav_0"][key]) for key in ("row", "coverage")
        )
        actions = policies["batch"](observed)
        action = policies["single"](seen["uav_0"])
        assert action.shape == (2,)
        assert np.array_equal(action, actions[k])
        worlds.step({"uav_0": actions})
        seen, *_ = env.step({"uav_0": action, "ugv_0": drive(seen["ugv_0"])})
    assert env.unwrapped.metrics()["uav_0"]["distance"] == worlds.metrics()["uav_0"]["distance"][k]


def test_ugv_receives_tiles_by_radio_in_one_world_as_in_a_batch() -> None:
    wall = Hazard(kind="block", center=(9.0, 11.0), radius=0.5)
    grounded, policy = msgspec.structs.replace(NOISY, hazard=(wall,)), LearnedPolicy.load(POLICY)
    worlds = Worlds(grounded, 1, ["uav_0", "ugv_0"], **policy.setup)
    env = outrider.parallel_env(grounded, **policy.setup)
    worlds.reset([SEEDS[0]], None)
    env.reset(seed=SEEDS[0])
    still = np.zeros(2)
    for _ in range(100):
        worlds.step(dict.fromkeys(worlds.learners, still[None]))
        seen, *_ = env.step(dict.fromkeys(env.agents, still))
    observed, tiles = worlds.observe("ugv_0"), seen["ugv_0"]["tiles"]
    assert np.array_equal(observed["tiles"][0], tiles)
    assert np.count_nonzero(tiles == CLEAR) > 50  # more than the bumper senses


def test_it_sees_what_it_was_trained_on() -> None:
    """The transformation around a repeated environment, as in training, and the policy alone fly the same, also over
    ends.
    """
    network, recipe = load_policy(POLICY)
    policy = LearnedPolicy.load(POLICY)

    def make() -> Any:
        return outrider.vector_env(
            NOISY, num_envs=3, duration=6.0, safety_filter=True, **policy.setup
        )

    training = Transformed(ActionRepeat(make(), recipe["repeat"]), make_view(recipe))
    plain = make()
    assert (
        training.action_space == batch_space(training.single_action_space, 3) != plain.action_space
    )
    shown, _ = training.reset(seed=5)
    seen, _ = plain.reset(seed=5)
    for _ in range(30):
        assert training.single_observation_space.contains(shown[0])
        shown, paid, *_ = training.step(np.clip(network(shown), -1.0, 1.0))
        total = np.zeros(3)
        for _ in range(recipe["repeat"]):
            seen, rewards, *_ = plain.step(policy(seen))
            total += rewards
        assert np.array_equal(paid, total)


def test_it_restarts_with_each_episode_of_each_world() -> None:
    policy, other = LearnedPolicy.load(POLICY), LearnedPolicy.load(POLICY)
    env = outrider.vector_env(NOISY, num_envs=2, duration=20.0, **policy.setup)
    seen, _ = env.reset(seed=[3, 4])
    for _ in range(37):
        seen, *_ = env.step(policy(seen))
    seen, _ = env.reset(seed=[3, None], options={"reset_mask": np.array([True, False])})
    again = outrider.vector_env(NOISY, num_envs=1, duration=20.0, **policy.setup)
    first, _ = again.reset(seed=3)
    for _ in range(60):
        actions, action = policy(seen), other(first)
        assert np.array_equal(actions[:1], action)
        seen, *_ = env.step(actions)
        first, *_ = again.step(action)


def test_first_call_within_an_episode_returns_actions_at_once() -> None:
    policy = LearnedPolicy.load(POLICY)
    env = outrider.vector_env(NOISY, num_envs=2, **policy.setup)
    env.reset(seed=3)
    for _ in range(3):
        seen, *_ = env.step(np.zeros((2, 2)))
    assert policy(seen).any(axis=1).all()


def test_it_sees_more_than_the_circle_and_keeps_sight(evaluation: ModuleType) -> None:
    cases = evaluation.CASES
    for case, seeds in ((cases["escort"], [7]), (cases["wander"], [900_031, 900_032])):
        circle = evaluation.fly_law(case, "circle", seeds)
        learned = evaluation.fly_policy(case, LearnedPolicy.load(POLICY), seeds, shielded=True)
        assert (learned["mean_error"] < 0.6 * circle["mean_error"]).all()
        assert not learned["visibility_violations"].any()
        assert (learned["ticks"] == circle["ticks"]).all()


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.long)])
def test_table_is_reproducible_and_marks_unfiltered_pilots(
    whole: bool, evaluation: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not whole:  # batches with `lookahead` take a minute to compile
        quick = tuple(law for law in evaluation.BASELINES if law != "lookahead")
        monkeypatch.setattr(evaluation, "BASELINES", quick)
        monkeypatch.setattr(evaluation, "VARIANTS", {})
    results = evaluation.evaluate(POLICY, flights=2, cases=["covered"], duration=10.0)
    assert results == evaluation.evaluate(POLICY, flights=2, cases=["covered"], duration=10.0)
    assert [result.pilot for result in results][: len(evaluation.BASELINES)] == list(
        evaluation.BASELINES
    )
    assert all(
        result.lost == result.violations == 0 and 0.0 < result.max_distance < 4.75
        for result in results
    )
    assert {result.pilot for result in results if result.overridden is not None} == {
        "certified",
        *(["lookahead"] if whole else []),
        *evaluation.VARIANTS,
        evaluation.LEARNED,
    }
    lines = evaluation.markdown(results).splitlines()
    assert len(lines) == 4 + len(results)
    assert len({line.count("|") for line in lines[2:]}) == 1
    assert json.loads(json.dumps(evaluation.as_dicts(results)))[0]["pilot"] == results[0].pilot


@pytest.mark.usefixtures("evaluation")
def test_a_curve_is_drawn(tmp_path: Path) -> None:
    draw_curve = importlib.import_module("curve").draw_curve
    network, recipe = load_policy(POLICY)
    draw_curve(POLICY, tmp_path / "curve.png", laws=())
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
    save_policy(tmp_path / "none.npz", network, recipe | {"curve": []})
    with pytest.raises(ValueError, match="has no learning curve"):
        draw_curve(tmp_path / "none.npz", tmp_path / "curve.png", laws=())


_UNREADABLE = ("text", "empty", "half", "other", "objects", "complex")


def _bad_files(folder: Path) -> dict[str, str]:
    """Return invalid files and their error messages."""
    network, recipe = load_policy(POLICY)
    (folder / "text.npz").write_text("no policy")
    (folder / "empty.npz").write_bytes(b"")
    (folder / "half.npz").write_bytes(POLICY.read_bytes()[:5000])
    np.savez(folder / "other.npz", weight_0=np.eye(2))
    np.savez(folder / "objects.npz", recipe=np.array([{}], dtype=object))
    save_policy(
        folder / "gap.npz",
        network._replace(weights=network.weights[::-1], biases=network.biases[::-1]),
        recipe,
    )
    save_policy(
        folder / "nan.npz",
        network._replace(biases=tuple(bias * np.nan for bias in network.biases)),
        recipe,
    )
    save_policy(folder / "recipe.npz", network, {"dt": 0.05})
    save_policy(folder / "view.npz", network, recipe | {"view": recipe["view"] | {"sectors": 3}})
    for name, change in {
        "repeat": {"repeat": 2.5},
        "tick": {"dt": 0.0},
        "patch": {"coverage_patch": [0, 1.5]},
        "word": {"coverage_patch": ["a", 1.5]},
        "lag": {"view": recipe["view"] | {"lag": 0}},
        "memory": {"view": recipe["view"] | {"lag": 10**9}},
        "sectors": {"view": recipe["view"] | {"sectors": 30_000_000}},
        "rings": {"view": recipe["view"] | {"rings": [1.0] * 10_000}},
        "scale": {"view": recipe["view"] | {"scale": float("nan")}},
        "speed": {"view": recipe["view"] | {"v_max": "fast"}},
        "large": {"coverage_patch": [10**9, 0.1]},
        "patches": {"coverage_patch": [20, 1.5, 3]},
        "late": {"dt": 10**400},
    }.items():
        save_policy(folder / f"{name}.npz", network, recipe | change)
    with np.load(POLICY) as archive:
        np.savez(folder / "complex.npz", **{**archive, "bias_0": archive["bias_0"] * 1j})
    save_policy(folder / "list.npz", network, [])  # type: ignore[arg-type]
    cannot = "cannot be read"
    return dict.fromkeys(_UNREADABLE, cannot) | {
        "missing": "no such file",
        "gap": "do not fit together",
        "nan": "not finite",
        "recipe": "recipe: KeyError",
        "view": "the recipe needs 21 inputs, 2 outputs",
        "list": "its recipe is not a table",
        "repeat": "recipe: repeat = 2.5; allowed: a whole number from 1",
        "tick": "recipe: dt = 0.0; allowed: a number from 1e-09",
        "patch": "recipe: coverage_patch = .*; allowed: 2 numbers from 1e-09",
        "word": "recipe: coverage_patch = .*; allowed: 2 numbers from 1e-09",
        "memory": "recipe: lag = 1000000000; allowed",
        "sectors": "recipe: sectors = 30000000; allowed: a whole number from 1 to 1024",
        "rings": "recipe: rings = .*; allowed: 1 to 64 numbers",
        "scale": "recipe: scale = nan; allowed: a number",
        "speed": "recipe: v_max = 'fast'; allowed: a number",
        "large": "recipe: coverage_patch = 1000000000; allowed: a whole number from 1 to 1024",
        "patches": "recipe: coverage_patch",
        "late": "recipe: dt",
        "lag": "recipe: lag = 0; allowed: a whole number from 1",
    }


def test_a_bad_file_is_refused_in_one_line(tmp_path: Path) -> None:
    for name, reason in _bad_files(tmp_path).items():
        with refused(ValueError, reason) as caught:
            LearnedPolicy.load(tmp_path / f"{name}.npz")
        assert f"{name}.npz" in str(caught.value)


def test_any_damaged_file_loads_or_is_refused_in_one_line(tmp_path: Path) -> None:
    whole, file, rng = POLICY.read_bytes(), tmp_path / "damaged.npz", random.Random(1)
    ends = 1500  # the headers and the directory of the archive matter most
    refusals: list[str] = []
    for k in range(1000):
        damaged = bytearray(whole)
        if k % 4 == 0:
            del damaged[rng.randrange(len(whole)) :]
        for _ in range(rng.choice((1, 4, 16)) if k % 4 else 0):
            offset = rng.choice(
                (rng.randrange(len(whole)), rng.randrange(ends), -1 - rng.randrange(ends))
            )
            damaged[offset] ^= 1 << rng.randrange(8)
        file.write_bytes(damaged)
        try:
            load_npz_policy(str(file), "custom.uav_policy")
        except ScenarioError as error:
            refusals.append(str(error))
    assert 900 < len(refusals) < 1000
    assert all(len(line.splitlines()) == 1 for line in refusals)


def test_a_policy_asks_for_the_observations_that_it_needs(evaluation: ModuleType) -> None:
    policy = LearnedPolicy.load(POLICY)
    env = outrider.vector_env(NOISY, num_envs=2)
    with pytest.raises(ValueError, match="create the environment with its setup"):
        policy(env.reset(seed=1)[0])
    with pytest.raises(ValueError, match="a UAV's row and a coverage patch"):
        Transformed(env, make_view(policy.recipe))
    fast = load_scenario("escort", overrides={"uav.0.max_speed": 0.7})
    with pytest.raises(
        ValueError, match=r"uav_0: max_speed = 0.7: the policy was trained with 0.6"
    ):
        policy.check(fast)
    with pytest.raises(ValueError, match=r"v_max = 0.7 m/s: EscortView was created with 0.6 m/s"):
        Transformed(outrider.vector_env(fast, num_envs=2, **policy.setup), make_view(policy.recipe))
    with pytest.raises(
        ValueError, match=r"uav_0: max_speed = 0.7: the policy was trained with 0.6"
    ):
        outrider.vector_env(fast, num_envs=2, agent="ugv_0", others={"uav_0": policy})
    for change in ({"coverage_patch": (8, 0.5)}, {"gradient": True}):
        other = outrider.vector_env(NOISY, num_envs=2, **policy.setup | change)
        with pytest.raises(ValueError, match=r"observations of shapes .*: the policy needs"):
            policy(other.reset(seed=1)[0])
    with pytest.raises(ValueError, match="flights = 0"):
        evaluation.evaluate(POLICY, flights=0)
    with pytest.raises(ValueError, match="allowed: escort, wander, evade, covered"):
        evaluation.evaluate(POLICY, flights=1, cases=["moon"])


def test_network_output_has_the_same_bits_alone_and_in_a_batch() -> None:
    rng = np.random.default_rng(0)
    network = Mlp(
        (rng.normal(size=(64, 86)), rng.normal(size=(64, 64)), rng.normal(size=(2, 64))),
        (rng.normal(size=64), rng.normal(size=64), rng.normal(size=2)),
    )
    inputs = rng.normal(size=(50, 86))
    together = network(inputs)
    assert all(
        np.array_equal(network(one), answer) for one, answer in zip(inputs, together, strict=True)
    )
    x = inputs[0]
    for k, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        x = weight @ x + bias if k == 2 else np.tanh(weight @ x + bias)
    assert np.allclose(together[0], x, rtol=1e-12)


@pytest.mark.parametrize("duration", [1.0, 0.5])
def test_action_repeat_sums_the_rewards_of_its_ticks(duration: float) -> None:
    """Compare five steps of four ticks with ten ticks, which end within the third step; then the UAV rests."""
    plain, repeated = (
        outrider.vector_env("escort", num_envs=2, duration=duration) for _ in range(2)
    )
    env = ActionRepeat(repeated, 4)
    plain.reset(seed=2)
    env.reset(seed=2)
    action, ends = np.array([[0.2, 0.1], [-0.3, 0.0]]), 0
    for _ in range(10):
        applied, total, ended = action, np.zeros(2), dict[str, Any]()
        for _ in range(4):
            seen, rewards, terminated, truncated, infos = plain.step(applied)
            total += 0.0 if ended else rewards
            assert not terminated.any()
            if truncated.all():
                applied, ended = np.zeros((2, 2)), infos
        got, paid, lost, over, infos = env.step(action)
        assert np.array_equal(got, seen)
        assert np.array_equal(paid, total)
        assert not lost.any()
        assert over.tolist() == [bool(ended)] * 2
        if ended:
            ends += 1
            assert infos["_final_obs"].all()
            assert np.array_equal(np.stack(infos["final_obs"]), np.stack(ended["final_obs"]))
            returns, theirs = (one["final_info"]["episode"]["r"] for one in (infos, ended))
            assert np.array_equal(returns, theirs)
    assert ends == round(2.0 / duration)


@pytest.mark.parametrize("ticks", [0, -1, 1.5, None])
def test_a_repeat_of_no_whole_number_is_refused(ticks: Any) -> None:
    with pytest.raises(ValueError, match="allowed: a whole number from 1"):
        ActionRepeat(outrider.vector_env("escort", num_envs=1, duration=1.0), ticks)


def test_a_repeat_needs_the_mode_same_step() -> None:
    with pytest.raises(ValueError, match="SAME_STEP"):
        ActionRepeat(SyncVectorEnv([lambda: gymnasium.make("CartPole-v1")]), 2)


def test_files_of_policies_are_bounded(tmp_path: Path) -> None:
    fifo, large, packed = tmp_path / "fifo", tmp_path / "large", tmp_path / "packed.npz"
    os.mkfifo(fifo)
    with large.open("wb") as file:
        file.truncate(1 << 31)
    np.savez_compressed(packed, recipe=np.zeros(20 << 20))
    for path, wrong in (
        (fifo, "not a regular file"),
        (large, "larger than"),
        (packed, "unpacks to more than 64 MiB"),
    ):
        with pytest.raises(ValueError, match=wrong):
            load_policy(path)
