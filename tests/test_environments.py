"""All environments, of one world or of many, check and return the same way."""

import copy
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import (
    FlattenObservation,
    FrameStackObservation,
    NormalizeObservation,
    RescaleAction,
    RescaleObservation,
)

import outrider
from bus.errors import ScenarioError
from bus.messages.control import Control
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.envs.parallel import parallel_env
from outrider.envs.single import single_env
from outrider.envs.vector import parallel_vector_env, vector_env
from outrider_learning.suite.evaluation import evaluate
from outrider_learning.suite.tasks import suite
from refusals import refused
from sim.scenario.loading import load_scenario
from sim.scenario.types import Certificate
from sim.server.flight import Flight
from sim.world import World
from worlds import FREE, SCENARIO, equal, random_actions

MAKERS: dict[str, Callable[..., Any]] = {
    "parallel": parallel_env,
    "single": single_env,
    "vector": partial(vector_env, num_envs=2, agent="uav_0"),
    "parallel vector": partial(parallel_vector_env, num_envs=2),
}
EVERY, ALL, OF_ONE_AGENT = tuple(MAKERS), ("parallel", "single", "vector"), ("single", "vector")
OF_MANY = ("vector", "parallel vector")
GOOD = np.array([0.1, 0.05])
TASK = suite()[0]


def step(env: Any, action: Any = GOOD) -> Any:
    """Step every world with this action of the UAV."""
    if isinstance(env, VectorEnv):
        return env.step([action] * env.num_envs)
    if isinstance(env, gymnasium.Env):
        return env.step(action)
    actions = {"uav_0": action, "ugv_0": GOOD}
    if hasattr(env, "num_envs"):
        actions = {name: np.tile(one, (env.num_envs, 1)) for name, one in actions.items()}
    return env.step(actions)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("kind", [list, tuple, np.float32, np.float16, np.int64])
def test_actions_may_be_lists_or_arrays_of_any_number_type(name: str, kind: Any) -> None:
    env, expected = MAKERS[name](SCENARIO), MAKERS[name](SCENARIO)
    for one in (env, expected):
        one.reset(seed=1)
    action = [0.0, 1.0]  # exact in every type
    given = kind(action) if kind in {list, tuple} else np.array(action, dtype=kind)
    assert equal(step(env, given), step(expected, np.array(action)))


NO_PAIR, NOT_FINITE = (
    r"allowed: (two|\(2, 2\)) numbers",
    "allowed: two finite numbers of at most 1e.06",
)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    ("action", "words"),
    [
        *((bad, NO_PAIR) for bad in (np.zeros(3), np.zeros((1, 2)), 0.1, [0.1, [0.2]], ["a", "b"])),
        *((bad, NO_PAIR) for bad in ("a", None, True, {"uav_0": [0, 0]}, [True, False])),
        *((bad, NOT_FINITE) for bad in ([math.nan, 0.0], [0.0, math.inf], [0.0, -1e7])),
    ],
    ids=str,
)
def test_bad_action_is_refused_and_changes_nothing(name, action, words):
    env, expected = MAKERS[name](SCENARIO), MAKERS[name](SCENARIO)
    for one in (env, expected):
        one.reset(seed=5)
        for _ in range(5):
            step(one)
    with refused(ValueError, f"^actions? of uav_0.*{words}"):
        step(env, action)
    assert equal(step(env), step(expected))


@pytest.mark.parametrize(
    ("actions", "words"),
    [
        (np.zeros((3, 2)), r"shape \(3, 2\) and type float64; allowed: \(2, 2\) numbers"),
        (np.zeros(2), r"shape \(2,\)"),
        ([GOOD, [0.0, math.nan]], r"world 1 = \[0.0, nan\]"),
        ([[math.inf, 0.0], GOOD], "world 0"),
    ],
)
def test_of_many_worlds_the_one_whose_action_is_bad_is_named(actions, words):
    env = MAKERS["vector"](SCENARIO)
    env.reset(seed=1)
    with refused(ValueError, words):
        env.step(actions)


@pytest.mark.parametrize("name", ["parallel", "parallel vector"])
@pytest.mark.parametrize(
    ("acting", "phrase"),
    [
        (["uav_0"], "uav_0"),
        ([], "none"),
        (["uav_0", "ugv_0", "uav_7"], "uav_0, ugv_0, uav_7"),
    ],
)
def test_there_must_be_an_action_for_each_agent_and_for_no_other(name, acting, phrase):
    env, shape = MAKERS[name](SCENARIO), (2,) if name == "parallel" else (2, 2)
    env.reset(seed=1)
    with refused(ValueError, f"^actions for: {phrase}; .*one for each of uav_0, ugv_0$"):
        env.step(dict.fromkeys(acting, np.zeros(shape)))
    env.step(dict.fromkeys(env.agents, np.zeros(shape)))


@pytest.mark.parametrize("name", MAKERS)
def test_it_must_be_reset_first(name: str) -> None:
    with pytest.raises(ResetNeeded, match="reset"):
        step(MAKERS[name](SCENARIO))


@pytest.mark.parametrize("name", MAKERS)
def test_a_seed_may_be_a_number_of_numpys(name: str) -> None:
    env, expected = MAKERS[name](SCENARIO), MAKERS[name](SCENARIO)
    assert equal(env.reset(seed=np.int64(3)), expected.reset(seed=3))


@pytest.mark.parametrize(
    ("names", "seed"),
    [
        *((ALL, seed) for seed in (-1, 2**53, 1.5, "1")),
        *((("vector",), seeds) for seeds in ([1], [1, 2, 3], [1, -1])),
    ],
    ids=str,
)
def test_a_bad_seed_is_refused_and_the_episode_goes_on(names: tuple[str, ...], seed: Any) -> None:
    for name in names:
        env, expected = MAKERS[name](SCENARIO), MAKERS[name](SCENARIO)
        for one in (env, expected):
            one.reset(seed=1)
        with refused(ValueError, "seed"):
            env.reset(seed=seed)
        assert equal(step(env), step(expected))


def _begin_loop(seed: Any) -> None:
    ClosedLoop(SCENARIO, 2).begin([1, seed])


SEEDED: dict[str, Callable[[Any], Any]] = {
    "run": lambda seed: outrider.run(SCENARIO, seed=seed),
    "flight": lambda seed: Flight(SCENARIO, seed),
    "world": lambda seed: World(SCENARIO, seed),
    "loop": _begin_loop,
    "suite": lambda seed: evaluate(TASK, "tracking", seeds=[seed]),
    "control": lambda seed: msgspec.convert({"action": "reset", "seed": seed}, Control),
    "scenario": lambda seed: load_scenario("escort", overrides={"seed": seed}),
    "field": lambda seed: outrider.run(msgspec.structs.replace(SCENARIO, seed=seed)),
}


@pytest.mark.parametrize("name", SEEDED)
@pytest.mark.parametrize("seed", [-1, 3.5, 2**53, 2**64, "1"])
def test_every_entry_point_refuses_a_bad_seed(name: str, seed: Any) -> None:
    with refused((ValueError, ScenarioError), "seed"):
        SEEDED[name](seed)


@pytest.mark.parametrize("seed", [np.int64(3), np.uint8(3)])
def test_a_run_accepts_whole_numbers_of_numpy(seed: Any) -> None:
    summary = outrider.run(SCENARIO, seed=seed)
    assert summary.trajectory_sha256 == outrider.run(SCENARIO, seed=3).trajectory_sha256
    assert msgspec.json.decode(msgspec.json.encode(summary))["seed"] == 3


REFUSALS: dict[type[Exception], list[tuple[Any, dict[str, Any], str]]] = {
    ValueError: [
        *((ALL, {"dtype": dtype}, "dtype") for dtype in (np.int32, 3)),
        *((ALL, {"coverage_patch": (n, 1.0)}, "pixels") for n in (0, 1.5, math.nan)),
        *((ALL, {"coverage_patch": (8, m)}, "meters_per_pixel") for m in (0.0, math.inf)),
        (("parallel",), {"render_mode": "ansi"}, "render_mode = 'ansi'; allowed: None, 'human'"),
        (("single", *OF_MANY), {"render_mode": "human"}, "'human'; allowed: None, 'rgb_array'"),
        (OF_ONE_AGENT, {"agent": "uav_7"}, "agent = 'uav_7'; allowed: uav_0, ugv_0"),
        (OF_ONE_AGENT, {"others": {"uav_0": "linear"}}, "external"),
        (OF_ONE_AGENT, {"others": {"ugv_0": "nobody"}}, "allowed: waypoints, .* or a policy"),
        (OF_ONE_AGENT, {"others": {"ugv_9": "wander"}}, "no such vehicle"),
        (OF_ONE_AGENT, {"others": {"ugv_0": 3}}, "neither a name nor a policy"),
        *((OF_ONE_AGENT, {"threads": n}, "threads") for n in (0, 1.5, math.nan)),
        (ALL, {"secret": "1234"}, "secret: 4 characters: not a secret"),
        *(
            (OF_MANY, {"autoreset_mode": mode}, "autoreset_mode = .*: 'SameStep', 'NextStep'")
            for mode in ("Disabled", AutoresetMode.DISABLED, "sometimes", 3)
        ),
        *((OF_MANY, {"num_envs": n}, "num_envs") for n in (0, -3, 1.5, "2")),
    ],
    TypeError: [
        (ALL, {"rewards": {"seen": 1.0}}, r"rewards = .*; allowed: RewardWeights\(...\)"),
        (ALL, {"end_on_sight_lost": None}, "end_on_sight_lost = None; allowed: True, False"),
        (ALL, {"estimate": "no"}, "estimate = 'no'; allowed: True, False"),
        (ALL, {"others": "evade"}, "others = 'evade'; allowed: pilots by vehicle, or None"),
        (
            EVERY,
            {"durations": 2.0},
            r"'durations': unknown setting .did you mean 'duration'.*allowed: .*duration, ",
        ),
    ],
    ScenarioError: [
        *((EVERY, {"duration": t}, "duration") for t in (0.0, -1.0, 0.12, math.nan, math.inf)),
    ],
}


@pytest.mark.parametrize(
    ("kind", "names", "options", "words"),
    [(kind, *row) for kind, rows in REFUSALS.items() for row in rows],
    ids=str,
)
def test_a_bad_argument_is_refused_in_one_line(kind, names, options, words):
    for name in names:
        with refused(kind, words):
            MAKERS[name](SCENARIO, **options)


@pytest.mark.parametrize("name", MAKERS)
def test_what_was_returned_is_never_changed_later(name: str) -> None:
    env = MAKERS[name](SCENARIO, coverage_patch=(np.float32(8.0), 1.0))
    now = [env.reset(seed=1)]
    then = copy.deepcopy(now)
    for action in random_actions(1, 20)[:, 0]:
        if name == "parallel vector":
            returned = env.step(dict.fromkeys(env.possible_agents, np.tile(action, (2, 1))))
        else:
            returned = step(env, action)
        now.append((returned, env.state() if name == "parallel" else None))
        then.append(copy.deepcopy(now[-1]))
    assert all(map(equal, now, then))


@pytest.mark.parametrize(
    ("scenario", "options"),
    [
        *(
            (SCENARIO, options)
            for options in ({}, {"agent": "ugv_0"}, {"coverage_patch": (6, 1.0)})
        ),
        (FREE, {"estimate": True, "gradient": True, "dtype": np.float32}),
        ("minefield", {"agent": "ugv_0", "tile_patch": 5}),
    ],
    ids=["row", "ugv", "coverage", "estimate", "tiles"],
)
def test_gymnasiums_wrappers_can_be_put_around_each_other(scenario, options) -> None:
    plain, env = (
        FlattenObservation(single_env(scenario, duration=2.0, end_on_sight_lost=False, **options))
        for _ in range(2)
    )
    box = plain.observation_space
    one = box.dtype.type(1.0)
    rescaled = RescaleObservation(RescaleAction(env, np.float64(-1.0), np.float64(1.0)), -one, one)
    stacked = FrameStackObservation(rescaled, 2)
    normalized = NormalizeObservation(stacked)
    raw, seen = plain.reset(seed=1)[0], stacked.reset(seed=1)[0]
    for _ in range(40):
        wanted = 2.0 * (raw.astype(np.float64) - box.low) / (box.high - box.low) - 1.0
        np.testing.assert_allclose(seen[-1], wanted, atol=1e-6)
        assert plain.observation_space.contains(raw)
        last = seen[-1]
        raw, *_ = plain.step(0.2 * plain.action_space.high)
        seen, *_ = stacked.step(np.full(2, 0.2))
        assert equal(seen[0], last)
    normalized.reset(seed=1)
    assert np.isfinite(normalized.step(np.full(2, 0.2))[0]).all()


RANGES = {
    "uav.*.max_speed": [0.5, 0.9],
    "ugv.0.max_speed": [0.1, 0.2],
    "detections.noise": [0.05, 0.2],
    "detections.dropout": [0.0, 0.2],
}


@pytest.mark.parametrize("name", EVERY)
def test_random_fields_follow_from_the_seed(name: str) -> None:
    env = MAKERS[name](SCENARIO, randomize=RANGES)

    def flight(seed: int) -> list[Any]:
        return [env.reset(seed=seed), *(step(env) for _ in range(10))]

    first, other, again = flight(4), flight(5), flight(4)
    assert equal(tuple(first), tuple(again))
    assert not equal(first[0], other[0])


def test_info_holds_the_fields_that_a_vehicle_may_know() -> None:
    env = parallel_env(SCENARIO, randomize=RANGES, safety_filter=True)
    drawn = list[tuple[float, ...]]()
    for seed in range(8):
        _, infos = env.reset(seed=seed)
        briefing, truth = env.briefing("uav_0"), env.metrics()["uav_0"]
        assert infos["uav_0"]["uav.*.max_speed"] == briefing.limits.max_speed
        assert infos["uav_0"]["ugv.0.max_speed"] == briefing.target_limits.max_speed
        assert infos["uav_0"]["detections.noise"] == briefing.detector.noise
        assert infos["ugv_0"].keys() & RANGES.keys() == {"ugv.0.max_speed"}
        assert "detections.dropout" not in infos["uav_0"]
        assert all(low <= truth[key] <= high for key, (low, high) in RANGES.items())
        drawn.append(tuple(truth[key] for key in RANGES))
    assert len(set(drawn)) == 8


_EVER = "uav.*.max_speed"
BAD_RANGES: list[tuple[type[Exception], Any, str]] = [
    (TypeError, [0.4, 0.8], "randomize = .*; allowed: ranges by field"),
    (ValueError, {"uav.*.max_spede": [0.4, 0.8]}, "unknown field, did you mean 'uav.*.max_speed'"),
    (ValueError, {"area.width": [20.0, 30.0]}, "area.width: cannot differ .*; allowed: uav"),
    (ValueError, {"uav.uav_7.max_speed": [0.4, 0.8]}, "no such vehicle; allowed: .*uav_0"),
    (ValueError, {_EVER: [0.8, 0.4]}, "reversed; allowed: the smaller number first"),
    (ValueError, {_EVER: [0.4, math.inf]}, "not finite; allowed: two finite numbers"),
    (ValueError, {_EVER: [0.4]}, "not a range; allowed: two numbers"),
    (ValueError, {_EVER: 0.4}, "not a range; allowed: two numbers"),
    (ValueError, {_EVER: [0.4, 0.8], "uav.0.max_speed": [0.4, 0.8]}, "one range per field"),
    (ScenarioError, {_EVER: [0.1, 0.8]}, "uav.0.max_speed = 0.1: not above the UGV ugv_0; allowed"),
    (ScenarioError, {"detections.noise": [-0.1, 0.1]}, "detections.noise = -0.1: out of bounds"),
]


@pytest.mark.parametrize(("kind", "ranges", "words"), BAD_RANGES, ids=str)
def test_a_bad_range_is_refused_in_one_line(kind: type[Exception], ranges: Any, words: str) -> None:
    for name in ("single", "parallel vector"):
        with refused(kind, words):
            MAKERS[name](SCENARIO, randomize=ranges)


def test_ranges_that_break_an_assumption_are_refused() -> None:
    declared = msgspec.structs.replace(SCENARIO, certificate=Certificate(max_measurement_error=0.6))
    ranges = {"detections.noise": [0.1, 0.3]}
    with refused(ScenarioError, "noise = 0.3 m: .*max_measurement_error = 0.6 m .A1.; try --set"):
        parallel_env(declared, randomize=ranges, safety_filter=True)
    parallel_env(msgspec.structs.replace(SCENARIO), randomize=ranges, safety_filter=True)
