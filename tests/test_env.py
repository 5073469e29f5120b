"""The environment with PettingZoo and a learner: API, spaces, actions, errors, determinism."""

import copy
import math
import pickle
import warnings

import msgspec
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.spaces.utils import flatten_space

from bus.errors import ScenarioError
from outrider.envs.parallel import parallel_env
from outrider.envs.single import single_env
from outrider.envs.vector import parallel_vector_env, vector_env
from refusals import refused
from sim.engine.briefing import briefing
from sim.env.spaces import FREE_ACCELERATION, extent_of
from sim.models.vehicles import clip_norm
from sim.scenario.loading import load_scenario
from sim.scenario.types import Detections
from sim.scenario.vehicle_types import Uav
from sim.world import World
from worlds import BLURRED, FAST, FREE, ONE, POOR, SEVERAL, equal

with warnings.catch_warnings():
    # PettingZoo 1.27 creates an old environment of its own
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import parallel_api_test

OPTIONS = [
    pytest.param(ONE, {}, id="one"),
    pytest.param(ONE, {"coverage_patch": (16, 0.5)}, id="patch"),
    pytest.param(
        msgspec.structs.replace(ONE, detections=Detections(dropout=0.95)), {}, id="dropouts"
    ),
    pytest.param(BLURRED, {}, id="blurred"),
    pytest.param(FAST, {"dtype": np.float32}, id="fast"),
    pytest.param(
        SEVERAL,
        {"end_on_sight_lost": False, "dtype": np.float32, "coverage_patch": (7, 1.3)},
        id="many",
    ),
    pytest.param(msgspec.structs.replace(ONE, uav=()), {}, id="without a UAV"),
]


def random_actions(env, rng):
    highest = {name: env.action_space(name).high for name in env.agents}
    return {name: rng.uniform(-1.0, 1.0, high.shape) * high for name, high in highest.items()}


def fly(env, rng, ticks):
    for _ in range(ticks):
        if not env.agents:
            return
        yield env.step(random_actions(env, rng))


@pytest.mark.parametrize(("scenario", "options"), OPTIONS)
def test_passes_pettingzoos_parallel_test(scenario, options):
    parallel_api_test(parallel_env(scenario, **options), num_cycles=100)


def test_the_environment_is_the_world_under_the_same_commands():
    """Over links that delay, lose and duplicate: the same bits of all states and link counters."""
    scenario = msgspec.structs.replace(SEVERAL, links=POOR, duration=20.0)
    env, world = parallel_env(scenario, end_on_sight_lost=False), World(scenario, 3)
    rng = np.random.default_rng(3)
    env.reset(seed=3)
    for _ in range(400):
        actions = random_actions(env, rng)
        for k, name in enumerate(world.names):
            world.send(k, world.tick, tuple(actions[name].tolist()))
        world.advance()
        env.step(actions)
        assert env.world.tick == world.tick
        for name in ("position", "velocity", "acceleration", "command", "detection"):
            assert env.world.vehicles[name].tobytes() == world.vehicles[name].tobytes()
        assert [env.world.received(u) for u in range(3)] == [world.received(u) for u in range(3)]
    assert env.world.coverage.tobytes() == world.coverage.tobytes()
    ours, theirs = env.links(), world.links.status()
    driven = [key for key in theirs if key.endswith(("detections", "commands"))]
    assert sum(sum(theirs[key].lost.values()) for key in driven) > 10
    assert {key: ours[key] for key in driven} == {key: theirs[key] for key in driven}


@pytest.mark.parametrize("scenario", [ONE, SEVERAL], ids=["one", "many"])
@pytest.mark.parametrize(
    ("options", "same"),
    [({"gradient": True, "coverage_patch": (3, 1.0)}, 9), ({"estimate": True}, 5)],
    ids=["gradient and patch", "estimate"],
)
def test_further_observations_change_no_bit_of_the_rest(scenario, options, same):
    """They are computed on a second path through the closed loop."""
    plain, full = (
        parallel_env(scenario, end_on_sight_lost=False, duration=20.0, **more)
        for more in ({}, options)
    )
    ours, theirs = plain.reset(seed=5)[0], full.reset(seed=5)[0]
    rng = np.random.default_rng(5)
    while plain.agents:
        for name in plain.agents:
            row = theirs[name]["row"] if isinstance(theirs[name], dict) else theirs[name]
            entries = same if name.startswith("uav") else len(row)
            assert equal(ours[name][:entries], row[:entries])
        actions = random_actions(plain, rng)
        ours, *end = plain.step(actions)
        theirs, *other_end = full.step(actions)
        assert equal(tuple(end), tuple(other_end))
        assert equal(plain.state(), full.state())
        assert equal(plain.metrics(), full.metrics())


def test_metadata_and_agents():
    env = parallel_env(SEVERAL)
    assert env.metadata["name"] == str(env) == "outrider_v0"
    assert env.metadata["render_modes"] == ["human", "rgb_array"]
    assert env.metadata["render_fps"] == 20
    assert env.metadata["is_parallelizable"]
    assert env.possible_agents == ["uav_0", "uav_1", "uav_2", "ugv_0", "ugv_1"]
    places = [name for name in env.state_names if name.endswith(".x")]
    assert places == [f"{vehicle}.x" for vehicle in env.possible_agents]
    assert env.agents == []
    env.reset()
    assert env.agents == env.possible_agents


@pytest.mark.parametrize(("scenario", "options"), OPTIONS)
@pytest.mark.parametrize(
    "push", [None, (-1.0, 0.0, -1.0), (1.0, 1.0, 1.0), (3.7, -50.0, 9.0)], ids=str
)
def test_everything_returned_lies_in_its_bounded_space(scenario, options, push):
    env = parallel_env(scenario, **{**options, "end_on_sight_lost": False})
    rng = np.random.default_rng(1)
    observations, _ = env.reset(seed=1)
    observed = [env.observation_space(name) for name in env.agents]
    assert all(flatten_space(space).is_bounded() for space in (*observed, env.state_space))
    while env.agents:
        for name, observation in observations.items():
            assert env.observation_space(name).contains(observation), (name, observation)
        assert env.state_space.contains(env.state()), env.state()
        actions = random_actions(env, rng)
        if push is not None:
            highest = {name: env.action_space(name).high for name in env.agents}
            actions = {
                name: np.clip(push[: len(high)] * high, -1e6, 1e6) for name, high in highest.items()
            }
        observations, *_ = env.step(actions)


def test_spaces_are_as_tight_as_the_scenario_says():
    env = parallel_env(ONE)
    low, high = env.observation_space("uav_0").low, env.observation_space("uav_0").high
    sensor_range = ONE.sensor.range + 3.0 * 0.1
    np.testing.assert_allclose(
        high, [60.0, 40.0, 40.0, 0.6, 0.6, 1.0, sensor_range, sensor_range, 60.0], rtol=1e-12
    )
    np.testing.assert_allclose(
        low, [0.0, 0.0, 0.0, -0.6, -0.6, 0.0, -sensor_range, -sensor_range, 0.0], rtol=1e-12
    )
    high = env.observation_space("ugv_0").high
    np.testing.assert_allclose(high, [60.0, 40.0, 40.0, 0.2, 0.2, 1.0, 40.0, 40.0], rtol=1e-12)
    np.testing.assert_array_equal(env.action_space("uav_0").high, [0.3, 0.3])
    np.testing.assert_array_equal(env.action_space("ugv_0").low, [-0.1, -0.1])


def test_space_bounds_allow_for_rounding():
    """A vector shortened to its bound may exceed it by a last place or two."""
    rng = np.random.default_rng(0)
    longer = 0
    for limit, x, y in rng.uniform(0.0, 1.0, (20_000, 3)):
        uav = Uav(position=(12.0, 10.0), max_speed=limit)
        clipped, _ = clip_norm(x + limit, y * 1e-9, limit)
        longer += clipped > limit
        assert clipped <= extent_of(ONE, uav)["v_max"]
    assert longer > 100


def test_unbounded_vehicles_have_finite_spaces():
    env = parallel_env(FREE)
    diagonal = math.hypot(40.0, 40.0)
    high = env.observation_space("uav_0").high[[3, 4, 6, 7]]
    np.testing.assert_allclose(high, [diagonal / 0.05] * 2 + [diagonal] * 2, rtol=1e-12)
    np.testing.assert_array_equal(env.action_space("uav_0").high, [FREE_ACCELERATION] * 2)


GOOD = {"uav_0": np.array([0.1, 0.0]), "ugv_0": np.array([0.0, 0.1])}


def test_nothing_works_before_the_first_reset_or_after_the_end():
    env = parallel_env(ONE, duration=0.1)
    for call in (env.state, env.metrics):
        with pytest.raises(ResetNeeded, match="reset"):
            call()
    env.reset()
    env.step(GOOD)
    *_, truncations, _ = env.step(GOOD)
    assert truncations == {"uav_0": True, "ugv_0": True}
    assert env.agents == []
    with pytest.raises(ResetNeeded, match="end of the episode"):
        env.step(GOOD)
    env.reset()
    env.step(GOOD)


@pytest.mark.parametrize(
    ("setting", "phrase"),
    [
        ({"coverage_patch": 32}, r"coverage_patch = 32: not a pair; allowed: \(pixels"),
        ({"omit": "time"}, r"omit = 'time'; allowed: a tuple of time, position"),
        ({"omit": ("age",)}, r"omit = .'age',.; allowed: each of time, position at most once"),
        ({"gradients": True}, "'gradients': unknown setting .did you mean 'gradient'"),
        ({"num_envs": 4}, "'num_envs': unknown setting .for many worlds: outrider.vector_env"),
    ],
)
def test_a_wrong_setting_says_what_was_meant(setting, phrase):
    with pytest.raises((TypeError, ValueError), match=phrase):
        parallel_env(ONE, **setting)


def test_actions_that_are_not_by_agent_are_refused():
    for env in (parallel_env(ONE), parallel_vector_env(ONE, num_envs=1)):
        env.reset(seed=1)
        with pytest.raises(ValueError, match="actions = None: not by agent; allowed: a dictionary"):
            env.step(None)


def test_unknown_options_of_a_reset_are_refused():
    made = (parallel_env(ONE), single_env(ONE), vector_env(ONE, num_envs=1))
    for env in (*made, parallel_vector_env(ONE, num_envs=1)):
        env.reset(options={})
        with refused(ValueError, r"options\['reset_msk'\]: unknown option.*; allowed: "):
            env.reset(options={"reset_msk": [True]})
        with refused(ValueError, r"options = 3: not options; allowed: a dictionary"):
            env.reset(options=3)


def test_a_scenario_error_is_a_value_error():
    with pytest.raises(ValueError, match=r"dt = -1"):
        load_scenario("escort", overrides={"dt": -1.0})


def test_an_unknown_scenario_or_agent_is_refused():
    with pytest.raises(ScenarioError, match="no_such_scenario"):
        parallel_env("no_such_scenario")
    with pytest.raises(ValueError, match=r"uav_7.*uav_0, ugv_0"):
        parallel_env(ONE).briefing("uav_7")


@pytest.mark.parametrize(("scenario", "options"), OPTIONS)
def test_same_seed_same_bits_for_more_than_a_thousand_ticks(scenario, options):
    """PettingZoo's own test checks one step only. The second environment has flown another episode before."""
    options = options | {"duration": 60.0, "end_on_sight_lost": False}
    first, second = (parallel_env(scenario, **options) for _ in range(2))
    second.reset(seed=2)
    list(fly(second, np.random.default_rng(2), 600))
    assert equal(first.reset(seed=7), second.reset(seed=7))
    flights = (fly(env, np.random.default_rng(7), 1200) for env in (first, second))
    steps = 0
    for a, b in zip(*flights, strict=True):
        assert equal(a, b)
        assert equal(first.state(), second.state())
        assert equal(first.metrics(), second.metrics())
        steps += 1
    assert steps == 1200


@pytest.mark.parametrize(
    ("scenario", "options"),
    [
        pytest.param(msgspec.structs.replace(ONE, links=POOR), {}, id="links"),
        pytest.param(ONE, {"safety_filter": True}, id="filter"),
        pytest.param(load_scenario("minefield"), {"safety_filter": True}, id="ground"),
        pytest.param(ONE, {"randomize": {"uav.*.max_speed": [0.5, 0.9]}}, id="random"),
    ],
)
def test_infos_are_numbers_under_the_same_keys(scenario, options):
    """From the first reset into the third episode, for learning libraries."""
    env = parallel_env(scenario, duration=0.1, **options)
    singles = {name: single_env(scenario, agent=name, duration=0.1, **options) for name in GOOD}
    many = parallel_vector_env(scenario, num_envs=2, duration=0.1, **options)
    (_, infos), (_, batch) = env.reset(seed=1), many.reset(seed=1)
    first, first_batch = infos, batch
    own = {name: one.reset(seed=1)[1] for name, one in singles.items()}
    for _ in range(6):
        if not env.agents:
            (_, infos), own = env.reset(), {name: one.reset()[1] for name, one in singles.items()}
        for name, info in infos.items():
            assert info.keys() == first[name].keys() == own[name].keys()
            assert [type(value) for value in info.values()] == [
                type(value) for value in first[name].values()
            ]
            assert all(isinstance(value, (bool, int, float)) for value in info.values())
            assert {key for key in batch[name] if key[0] != "_"} - {"final_obs", "final_info"} == (
                info.keys()
            )
            assert all(
                (batch[name][key].dtype, batch[name][key].shape) == (value.dtype, value.shape)
                for key, value in first_batch[name].items()
            )
        *_, infos = env.step(GOOD)
        own = {name: one.step(GOOD[name])[-1] for name, one in singles.items()}
        *_, batch = many.step({name: np.tile(one, (2, 1)) for name, one in GOOD.items()})


def episode_seeds(env, *given):
    return [env.reset(seed=seed) and env.episode_seed for seed in given]


def test_unseeded_environments_are_different_worlds():
    """As in Gymnasium; also copies for worker processes, and the worlds of a batch."""
    made = [parallel_env(ONE), single_env(ONE), vector_env(ONE, num_envs=2)]
    made += [pickle.loads(pickle.dumps(env)) for env in made]  # noqa: S301
    made += [parallel_vector_env(ONE, num_envs=2)]
    for env in made:
        env.reset()
    drawn = [seed for env in made for seed in getattr(env, "unwrapped", env).worlds.episode_seeds]
    assert len(set(drawn)) == len(drawn) == 10
    first, again = parallel_env(ONE), parallel_env(ONE)
    rows, _ = first.reset()
    assert equal(again.reset(seed=first.episode_seed)[0], rows)
    assert equal(again.reset(), first.reset())
    assert not equal(first.reset()[0], rows)


def test_resets_without_a_seed_go_on_deterministically():
    seeds = episode_seeds
    first = seeds(parallel_env(ONE), 4, None, None, None)
    assert first[0] == 4
    assert len(set(first)) == 4
    assert seeds(parallel_env(ONE), None, None, 4, None, None, None)[2:] == first
    unseeded = parallel_env(ONE)
    before = unseeded.episode_seed  # of the pilots that are briefed before the first reset
    assert seeds(unseeded, None, None) == seeds(parallel_env(ONE), before, None)
    assert all(0 <= seed < 2**53 for seed in first)
    env = parallel_env(ONE)
    assert seeds(env, 4, None)[1] == env.world.seed
    assert env.briefing("uav_0") == briefing(ONE, "uav_0", env.episode_seed)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])  # noqa: S301
def test_a_copy_goes_on_like_the_original(duplicate):
    env = parallel_env(
        SEVERAL, coverage_patch=(8, 1.0), end_on_sight_lost=False, render_mode="rgb_array"
    )
    env.reset(seed=2)
    list(fly(env, np.random.default_rng(0), 30))
    env.render()
    other = duplicate(env)
    flights = (fly(one, np.random.default_rng(1), 50) for one in (env, other))
    assert all(equal(a, b) for a, b in zip(*flights, strict=True))
    assert equal(env.state(), other.state())
    assert equal(env.render(), other.render())
