"""A policy as the pilot of a UAV: the observations of the environment, and the same bits in one process or several."""

import copy
import importlib
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium import spaces

import outrider
from agents.uav import UavPilot
from bus.errors import ScenarioError
from flights import distances
from outrider.envs.env_pilots import pilots
from outrider.running.flying import InProcess, fly, make_pilots
from outrider.running.own_functions import check_own_functions
from outrider_learning.egocentric import Egocentric
from outrider_learning.learned import LearnedPolicy
from outrider_learning.recipe import ObservationRecipe, make_layer, observation_recipe
from outrider_learning.repeat import ActionRepeat
from outrider_learning.saved import SavedPolicy
from outrider_learning.stacking import Stack
from outrider_learning.suite.evaluation import evaluate
from outrider_learning.suite.tasks import TASKS
from outrider_learning.transformation import Transformation, Transformed
from processes import python
from refusals import refused
from sim.engine.briefing import uav_briefing
from sim.env.settings import settings_of
from sim.scenario.loading import load_scenario
from sim.scenario.types import Custom, Scenario
from sim.server.flight import Flight
from tabular import words
from worlds import SCENARIOS, SEVERAL, raw

EXAMPLES = Path(__file__).parents[3] / "examples" / "policies"

SHIPPED = Path(__file__).parents[3] / "examples" / "policies" / "uav_ppo.npz"
NAME = f"npz:{SHIPPED}"
ESCORT = load_scenario("escort", overrides={"duration": 20.0})
SETUPS: dict[str, dict[str, Any]] = {
    "row": {},
    "float32": {"dtype": np.float32, "coverage_patch": (7, 0.6)},
    "estimate": {"estimate": True},
    "gradient": {"estimate": True, "gradient": True},
    "short": {"gradient": True, "omit": ("time", "position")},
}


class Recorded:
    """A policy that flies about and records its observations."""

    def __init__(self, setup: dict[str, Any], length: float) -> None:
        self.setup = {**setup, "duration": length}
        self.seen: list[Any] = []
        self.actions: list[np.ndarray] = []
        self._rng = np.random.default_rng(5)

    def __call__(self, seen: Any) -> np.ndarray:
        self.seen.append(copy.deepcopy(seen))
        self.actions.append(self._rng.uniform(-0.1, 0.1, (1, 2)))
        return self.actions[-1]


def with_policy(scenario: Scenario, law: str, name: str = NAME) -> Scenario:
    """Return the scenario with a policy on board."""
    changed = msgspec.structs.replace(scenario.law, name=law)
    return msgspec.structs.replace(scenario, law=changed, custom=Custom(uav_policy=name))


def flown_by(scenario: Scenario, policy: Recorded, seed: int) -> Flight:
    """Fly a run of law `policy` whose UAV is flown by this policy."""
    law = msgspec.structs.replace(scenario.law, name="policy")
    flight = Flight(scenario, seed)
    others = make_pilots(scenario, seed)
    briefing = msgspec.structs.replace(uav_briefing(scenario, "uav_0", seed), law=law)
    flight.fly(InProcess({**others, "uav_0": UavPilot(briefing, policy=policy)}))
    return flight


@pytest.mark.parametrize("network", ["certified", "network", "wind"])
@pytest.mark.parametrize("name", SETUPS)
def test_a_pilots_observation_is_the_environments(name: str, network: str) -> None:
    """Compare to the bit without estimator; with it to 1e-7, as the compiled filter rounds differently."""
    setup, exact = SETUPS[name], not SETUPS[name].get("estimate")
    flown = raw(SCENARIOS[network]) if exact else SCENARIOS[network]
    scenario = msgspec.structs.replace(flown, duration=10.0)
    policy = Recorded(setup, 10.0)
    flown_by(scenario, policy, 3)
    env = outrider.single_env(scenario, end_on_sight_lost=False, **setup)
    expected, _ = env.reset(seed=3)
    for seen, action in zip(policy.seen, policy.actions, strict=True):
        parts = seen if isinstance(seen, dict) else {"row": seen}
        theirs = expected if isinstance(expected, dict) else {"row": expected}
        assert parts.keys() == theirs.keys()
        for key, array in parts.items():
            assert (array.dtype, array.shape) == (theirs[key].dtype, (1, *theirs[key].shape))
            close = {"rtol": 0.0, "atol": 0.0 if exact else 1e-7}
            np.testing.assert_allclose(array[0], theirs[key], **close)
        expected, *_ = env.step(action[0])
    assert len(policy.seen) == 200


def test_before_a_detection_the_age_is_the_training_s_episode() -> None:
    blind = msgspec.structs.replace(
        ESCORT, duration=1.0, detections=msgspec.structs.replace(ESCORT.detections, dropout=1.0)
    )
    policy = Recorded({}, 200.0)
    flown_by(blind, policy, 1)
    assert {row[0, -1] for row in policy.seen} == {200.0}
    policy = Recorded({}, 200.0)
    del policy.setup["duration"]
    flown_by(blind, policy, 1)
    assert {row[0, -1] for row in policy.seen} == {np.inf}


@pytest.mark.parametrize("law", ["certified", "policy"])
def test_shipped_policy_flies_a_run_like_the_environment(law: str) -> None:
    flight, summary = fly(with_policy(ESCORT, law), 4)
    policy = LearnedPolicy.load(SHIPPED)
    settings = {"safety_filter": law == "certified", "end_on_sight_lost": False}
    env = outrider.parallel_env(ESCORT, **settings, **policy.setup)
    drive = pilots(env)["ugv_0"]
    seen, _ = env.reset(seed=4)
    for k in range(ESCORT.ticks):
        np.testing.assert_allclose(
            env.world.position, flight.recorder.states[k, :, :2], rtol=0.0, atol=1e-6
        )
        actions = {"uav_0": policy(seen["uav_0"]), "ugv_0": drive(seen["ugv_0"])}
        seen, *_ = env.step(actions)
    assert (summary.certified_share is None) == (law == "policy")


def test_safety_filter_keeps_sight_around_any_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "flees.py").write_text("def act(seen):\n    return [[0.3, 0.0]] * len(seen)\n")
    monkeypatch.syspath_prepend(tmp_path)
    scenario = msgspec.structs.replace(ESCORT, duration=60.0)
    kept, summary = fly(with_policy(scenario, "certified", "flees:act"), 2)
    assert distances(kept).max() < 4.75
    assert summary.certified_share == 1.0
    assert distances(fly(with_policy(scenario, "policy", "flees:act"), 2)[0]).max() > 4.75


def test_processes_and_one_process_fly_the_same_bits(command) -> None:
    options = words("run --no-files --law certified --seed 3 --duration 5 --json --set")
    run = command(*options, f"custom.uav_policy={NAME}")
    assert run.returncode == 0, run.stderr
    flown = fly(with_policy(msgspec.structs.replace(ESCORT, duration=5.0), "certified"), 3)[1]
    assert json.loads(run.stdout)["trajectory_sha256"] == flown.trajectory_sha256


def test_each_of_several_uavs_has_a_memory_of_its_own() -> None:
    several = msgspec.structs.replace(
        SEVERAL,
        duration=3.0,
        uav=tuple(msgspec.structs.replace(u, max_speed=0.6) for u in SEVERAL.uav),
    )
    flight, _ = fly(with_policy(several, "policy"), 1)
    single = fly(with_policy(several, "policy"), 1)[0]
    np.testing.assert_array_equal(flight.recorder.states, single.recorder.states)
    uavs = flight.recorder.states[10:, :3, 4:6]
    assert (uavs[:, 0] != uavs[:, 1]).any()


# -- saved policies of a library


class Linear:
    """Model with the interface of Stable-Baselines3."""

    def __init__(self, space: spaces.Space[Any], axes: int = 2) -> None:
        self.observation_space = space
        rows = space.spaces["row"] if isinstance(space, spaces.Dict) else space
        self.action_space = spaces.Box(-0.3, 0.3, (axes,), np.float64)
        self._weights = np.random.default_rng(2).normal(size=(np.prod(rows.shape), axes))

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: Any = False,
    ) -> tuple[np.ndarray, Any]:
        assert deterministic
        row = observation["row"] if isinstance(observation, dict) else observation
        assert all(self.observation_space.contains(one) for one in row) or isinstance(
            observation, dict
        )
        return 0.3 * np.tanh(0.1 * row.reshape(len(row), -1) @ self._weights), state


WRAPPED: dict[str, Any] = {
    "plain": lambda env: env,
    "short": lambda env: Transformed(ActionRepeat(env, 5), Egocentric()),
    "egocentric": lambda env: Transformed(Transformed(env, Egocentric()), Stack(3)),
    "repeated": lambda env: Transformed(ActionRepeat(Transformed(env, Egocentric()), 5), Stack(2)),
}


@pytest.mark.parametrize(
    ("scenario", "patch"), [("escort", None), ("escort", (5, 1.0)), ("town", (5, 1.0))]
)
@pytest.mark.parametrize("name", WRAPPED)
def test_a_saved_policy_acts_as_in_its_training(name: str, scenario: str, patch: Any) -> None:
    settings: dict[str, Any] = {"duration": 4.0, "coverage_patch": patch, "estimate": True}
    settings |= {"omit": ("time", "position"), "gradient": True} if name == "short" else {}
    env = WRAPPED[name](outrider.vector_env(scenario, num_envs=2, **settings))
    model = Linear(env.single_observation_space, *env.single_action_space.shape)
    recipe = msgspec.json.decode(
        msgspec.json.encode(observation_recipe(env)), type=type(observation_recipe(env))
    )
    policy = SavedPolicy(model, recipe)
    own = {key: value for key, value in policy.setup.items() if key != "duration"}
    plain = outrider.vector_env(scenario, num_envs=2, duration=4.0, **own)
    shown, _ = env.reset(seed=6)
    seen, _ = plain.reset(seed=6)
    repeat, heights = 5 if name in {"repeated", "short"} else 1, set[float]()
    for _ in range(160 // repeat):  # two episodes
        shown, *_ = env.step(model.predict(shown, deterministic=True)[0])
        for _ in range(repeat):
            seen, *_ = plain.step(policy(seen))
        one, other = (each.unwrapped.worlds.loop.state.batch.vehicles for each in (env, plain))
        np.testing.assert_array_equal(one["position"], other["position"])
        np.testing.assert_array_equal(one["vertical"]["altitude"], other["vertical"]["altitude"])
        heights.add(float(one["vertical"]["altitude"][0, 0]))
    assert (len(heights) > 1) == (scenario == "town")


def test_saved_policy_flies_a_run_and_reports_too_large_an_area() -> None:
    env = outrider.vector_env("escort", num_envs=1, end_on_sight_lost=False)
    env = Transformed(env, Stack(2))
    policy = SavedPolicy(Linear(env.single_observation_space), observation_recipe(env))
    law = msgspec.structs.replace(ESCORT.law, name="policy")
    briefing = msgspec.structs.replace(uav_briefing(ESCORT, "uav_0", 1), law=law)
    flight = Flight(ESCORT, 1)
    flight.fly(InProcess({**make_pilots(ESCORT, 1), "uav_0": UavPilot(briefing, policy=policy)}))
    seen, _ = env.reset(seed=1)
    model = Linear(env.single_observation_space)
    for k in range(200):
        truth = env.unwrapped.worlds.loop.state.batch.vehicles["position"][0]
        np.testing.assert_array_equal(truth, flight.recorder.states[k, :, :2])
        seen, *_ = env.step(model.predict(seen, deterministic=True)[0])
    assert policy.fits(briefing) == ()
    wide = msgspec.structs.replace(briefing.area, width=120.0)
    (line,) = policy.fits(msgspec.structs.replace(briefing, area=wide))
    assert "larger than the 40 m x 40 m" in line


def recipe_of(scenario: Scenario) -> ObservationRecipe:
    """The recipe of an environment's own rows, which need not be built."""
    worlds = SimpleNamespace(scenario=scenario, settings=settings_of({}))
    return observation_recipe(SimpleNamespace(agent="uav_0", worlds=worlds))


def test_saved_policies_need_the_altitudes_of_their_training() -> None:
    """Nothing is flown before the error."""
    town = load_scenario("town")
    plane, high = recipe_of(ESCORT), recipe_of(town)
    saved = SavedPolicy(Linear(plane.space()), plane)
    for policy in (saved, LearnedPolicy.load(EXAMPLES / "uav_ppo.npz")):
        with refused(ValueError, "town: uav_0: initial_altitude = 14 m: the policy was trained"):
            policy.check(town)
    policy = SavedPolicy(Linear(high.space(), 3), high)
    policy.check(town)
    with refused(ValueError, "initial_altitude: missing; the policy was trained with an altitude"):
        policy.check(ESCORT)
    with refused(ValueError, "max_climb_rate = 0.7: the policy was trained with 1"):
        policy.check(load_scenario("town", overrides={"uav.0.max_climb_rate": 0.7}))
    policy.check(load_scenario("courtyard"))
    higher = load_scenario("town", overrides={"uav.0.max_altitude": 17.0})
    (line,) = policy.fits(uav_briefing(higher, "uav_0", 1))
    assert "max_altitude = 17 m: higher than the 16 m" in line
    with refused(ValueError, r"the recipe gives \(11,\) and \(3,\)"):
        SavedPolicy(Linear(high.space(), 2), high)


class Mine(Transformation):
    """A transformation of the user's own, without settings."""

    def space(self, space: Any) -> Any:
        return space

    def apply(self, observation: Any) -> Any:
        return observation


SCALED = """
from outrider_learning.transformation import Transformation


class Scaled(Transformation):
    def __init__(self, factor):
        self.factor = factor

    def settings(self):
        return {"factor": self.factor}

    def space(self, space):
        return space

    def apply(self, observation):
        return observation * self.factor
"""


def test_a_transformation_of_the_users_own_is_saved(tmp_path, monkeypatch) -> None:
    (tmp_path / "my_scaled.py").write_text(SCALED, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    mine = importlib.import_module("my_scaled").Scaled(0.5)
    (layer,) = observation_recipe(
        Transformed(outrider.vector_env("escort", num_envs=1), mine)
    ).layers
    assert layer == {"kind": "my_scaled:Scaled", "factor": 0.5}
    code = f"from outrider_learning.recipe import make_layer; print(make_layer({layer}).apply(8.0))"
    assert python(code, cwd=tmp_path).stdout.strip() == "4.0"
    with refused(ValueError, "layer kind = 'gone:Scaled': .*gone"):
        make_layer({"kind": "gone:Scaled"})
    with refused(ValueError, "layer 'json:dumps': ValueError: not a transformation; allowed: ego"):
        make_layer({"kind": "json:dumps"})


def test_what_cannot_be_saved_with_a_policy_is_refused() -> None:
    env = outrider.vector_env("escort", num_envs=1)
    for wrong, phrase in (
        (Transformed(env, Mine()), "Mine: cannot be saved with a policy without its own settings"),
        (gymnasium.wrappers.vector.RescaleAction(env, -1.0, 1.0), "RescaleAction: cannot be saved"),
        (outrider.vector_env("escort", num_envs=1, agent="ugv_0"), "agent = 'ugv_0': not a UAV"),
    ):
        with refused(ValueError, phrase):
            observation_recipe(wrong)


def test_a_model_of_another_input_is_refused() -> None:
    env = outrider.vector_env("escort", num_envs=1)
    recipe = observation_recipe(env)
    for other in (spaces.Box(-1.0, 1.0, (10,)), spaces.Dict({"row": env.single_observation_space})):
        with refused(ValueError, r"model: observations of shape .* \(9,\)"):
            SavedPolicy(Linear(other), recipe)


# -- refusals


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"uav.0.max_speed": 0.7}, "uav_0: max_speed = 0.7: the policy was trained with 0.6"),
        ({"dt": 0.1, "detections.rate": 10.0}, "uav_0: dt = 0.1: the policy was trained with 0.05"),
        (
            {"custom.uav_policy": "npz:none.npz"},
            r"^custom.uav_policy = 'npz:none.npz': .*no such file",
        ),
        ({"custom.uav_policy": "json:nothing"}, "^custom.uav_policy = 'json:nothing'"),
        ({"custom.uav_policy": "collections:Counter"}, "not a policy"),
        ({"custom.uav_policy": "mine.npz"}, "not a policy; allowed: module:function, npz:FILE"),
        ({"law.name": "policy", "custom.uav_policy": ""}, "required by the law 'policy'"),
    ],
    ids=str,
)
def test_a_policy_that_cannot_fly_here_is_refused_in_one_line(changes: Any, words: str) -> None:
    with refused(ScenarioError, words):
        check_own_functions(
            load_scenario("escort", overrides={"custom.uav_policy": NAME} | changes)
        )


@pytest.mark.parametrize(
    "answer", ["[0.1, 0.2]", "[[0.1, 0.2, 0.3]]", "[[float('nan'), 0.0]]", "None", "[[1e9, 0.0]]"]
)
def test_an_answer_that_cannot_be_flown_is_named(
    answer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / f"bad_{abs(hash(answer))}.py").write_text(f"def act(seen):\n    return {answer}\n")
    monkeypatch.syspath_prepend(tmp_path)
    name = f"bad_{abs(hash(answer))}:act"
    with refused(ScenarioError, f"^uav_policy = '{name}': tick 0: returned .*allowed: two finite"):
        fly(with_policy(ESCORT, "policy", name), 1)


def test_an_unknown_setup_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "odd.py").write_text("def act(seen):\n    return seen\nact.setup = {'patch': 3}\n")
    monkeypatch.syspath_prepend(tmp_path)
    with refused(ScenarioError, "setup: 'patch': unknown; allowed: estimate, gradient"):
        check_own_functions(with_policy(ESCORT, "policy", "odd:act"))


@pytest.mark.parametrize("law", ["certified", "policy"])
def test_many_worlds_do_not_fly_the_law_instead_of_the_policy(law: str) -> None:
    named = with_policy(ESCORT, law)
    with refused(ScenarioError, "uav_0: .*polic"):
        outrider.vector_env(named, num_envs=1, agent="ugv_0")
    env = outrider.vector_env(named, num_envs=1, agent="ugv_0", others={"uav_0": NAME})
    env.reset()
    env.step(np.zeros((1, 2)))  # the policy has its own observation
    outrider.vector_env(named, num_envs=1).reset()


# -- the suite


def test_a_policy_sees_its_own_row_where_others_are_short() -> None:
    positions = []
    for omit in ((), ("time", "position")):
        given = {"others": {"uav_0": LearnedPolicy.load(SHIPPED)}, "omit": omit}
        env = outrider.vector_env(ESCORT, num_envs=2, agent="ugv_0", **given)
        env.reset(seed=5)
        for _ in range(40):
            env.step(np.zeros((2, 2)))
        positions.append(env.worlds.loop.state.batch.vehicles["position"].copy())
    np.testing.assert_array_equal(*positions)
    assert (positions[0][:, 0] != ESCORT.uav[0].position).any()


def test_the_suite_flies_a_policy_with_its_own_observation() -> None:
    (task,) = (one for one in TASKS if one.name == "paper")
    policy = outrider.load_policy(NAME)
    result = evaluate(task, policy, seeds=[9000], secret="", safety_filter=True)
    assert result.score > 80.0
    with refused(ValueError, "estimate = False: the policy was trained with True"):
        evaluate(task, policy, seeds=[9000], secret="", estimate=False)


def test_the_environment_s_estimate_is_what_the_pilot_sees() -> None:
    policy = Recorded({"estimate": True}, 20.0)
    flown_by(ESCORT, policy, 8)
    env = outrider.parallel_env(ESCORT, estimate=True, end_on_sight_lost=False)
    drive = pilots(env)["ugv_0"]
    seen, _ = env.reset(seed=8)
    for row, action in zip(policy.seen, policy.actions, strict=True):
        np.testing.assert_allclose(row[0], seen["uav_0"], rtol=1e-9, atol=1e-9)
        seen, *_ = env.step({"uav_0": action[0], "ugv_0": drive(seen["ugv_0"])})
