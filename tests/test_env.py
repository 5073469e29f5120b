"""The environment with PettingZoo and a learner: API, spaces, actions, errors, determinism."""

import copy
import math
import pickle
import warnings

import msgspec
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from pettingzoo.utils.conversions import aec_to_parallel, parallel_to_aec

from bus.errors import ScenarioError
from bus.messages.scenario import Area
from bus.messages.vehicle import UavBriefing, UgvBriefing
from outrider.envs.parallel import OutriderEnv, parallel_env
from sim.engine.briefing import briefing
from sim.env.spaces import FREE_ACCELERATION, extent_of
from sim.models.vehicles import clip_norm
from sim.scenario.loading import load_scenario
from sim.scenario.types import Detections, Scenario, Uav, Ugv
from sim.world import World
from worlds import FREE, ONE, POOR, equal

with warnings.catch_warnings():
    # PettingZoo 1.27 creates an old environment of its own
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, state_test

MANY = Scenario(
    name="many",
    duration=60.0,
    area=Area(width=30.0, height=20.0, cell=0.25),
    detections=Detections(noise=0.1),
    uav=(
        Uav(name="uav_0", escorts="ugv_1", position=(20.0, 10.0)),
        Uav(name="uav_1", escorts="ugv_0", position=(10.0, 10.0)),
        Uav(name="uav_2", escorts="ugv_0", position=(11.0, 10.0)),
    ),
    ugv=(
        Ugv(name="ugv_0", position=(10.0, 9.0), goals=((12.0, 9.0),)),
        Ugv(name="ugv_1", position=(21.0, 10.0), max_speed=0.3),
    ),
)
HIGH = load_scenario(
    "escort", overrides=["duration=25", "uav.0.initial_altitude=8", "uav.0.max_altitude=12"]
)
OPTIONS = [
    pytest.param(ONE, {}, id="one"),
    pytest.param(ONE, {"dtype": np.float32}, id="float32"),
    pytest.param(ONE, {"coverage_patch": (16, 0.5)}, id="patch"),
    pytest.param(FREE, {}, id="free"),
    pytest.param(
        MANY,
        {"end_on_sight_lost": False, "dtype": np.float32, "coverage_patch": (7, 1.3)},
        id="many",
    ),
    pytest.param(msgspec.structs.replace(ONE, uav=()), {}, id="without a UAV"),
    pytest.param(HIGH, {}, id="altitude"),
]


def random_actions(env, rng, *, length=1.0):
    return {
        name: rng.uniform(-length, length, env.action_space(name).shape)
        * env.action_space(name).high
        for name in env.agents
    }


def fly(env, rng, ticks):
    for _ in range(ticks):
        if not env.agents:
            return
        yield env.step(random_actions(env, rng))


def test_the_third_action_climbs():
    env = parallel_env(HIGH)
    env.reset(seed=1)
    for _ in range(10):
        seen, *_ = env.step({"uav_0": [0.0, 0.0, 0.5], "ugv_0": [0.0, 0.0]})
    assert seen["uav_0"][9:].tolist() == pytest.approx([8.0 + 0.5 * 0.5 * 0.5**2, 0.25])
    names = dict(zip(env.state_names, env.state(), strict=True))
    assert [names["uav_0.altitude"], names["uav_0.climb_rate"]] == seen["uav_0"][9:].tolist()


@pytest.mark.parametrize(("scenario", "options"), OPTIONS)
def test_passes_pettingzoos_parallel_test(scenario, options):
    parallel_api_test(parallel_env(scenario, **options), num_cycles=400)


def test_passes_pettingzoos_seed_test():
    parallel_seed_test(lambda: parallel_env(ONE), num_cycles=200)


def test_passes_pettingzoos_tests_as_a_turn_based_environment():
    with warnings.catch_warnings():
        # Observations of UAV and UGV differ.
        warnings.filterwarnings(
            "ignore",
            "Agents have different observation space sizes|Observations are different shapes",
        )
        api_test(parallel_to_aec(parallel_env(ONE)), num_cycles=200)
    state_test(parallel_to_aec(parallel_env(ONE)), parallel_env(ONE))


def test_turn_based_environment_flies_the_same_bits():
    direct, turns = parallel_env(ONE), parallel_to_aec(parallel_env(ONE))
    assert isinstance(aec_to_parallel(turns), OutriderEnv)
    rng = np.random.default_rng(0)
    direct.reset(seed=3)
    turns.reset(seed=3)
    for _ in range(50):
        actions = random_actions(direct, rng)
        observations, rewards, *_ = direct.step(actions)
        for name in direct.agents:
            assert turns.agent_selection == name
            turns.step(actions[name])
        assert equal(observations, {name: turns.observe(name) for name in direct.agents})
        assert equal(rewards, turns.rewards)


@pytest.mark.parametrize("seed", [3, 4])
def test_the_environment_is_the_world_under_the_same_commands(seed):
    """Over links that delay, lose and duplicate: the same bits of all states and link counters."""
    scenario = msgspec.structs.replace(MANY, links=POOR, duration=20.0)
    env, world = parallel_env(scenario, end_on_sight_lost=False), World(scenario, seed)
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
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


@pytest.mark.parametrize("scenario", [ONE, MANY], ids=["one", "many"])
def test_what_is_asked_for_besides_changes_no_bit_of_the_rest(scenario):
    """Estimates, gradients and pictures are computed on a second path through the closed loop."""
    plain = parallel_env(scenario, end_on_sight_lost=False, duration=20.0)
    full = parallel_env(
        scenario, end_on_sight_lost=False, duration=20.0, gradient=True, coverage_patch=(3, 1.0)
    )
    assert plain.worlds.loop.parameters is None
    assert full.worlds.loop.parameters is not None
    ours, theirs = plain.reset(seed=5)[0], full.reset(seed=5)[0]
    rng = np.random.default_rng(5)
    while plain.agents:
        for name in plain.agents:
            row = theirs[name]["row"][:9] if name.startswith("uav") else theirs[name]
            assert equal(ours[name], row)
        actions = random_actions(plain, rng)
        ours, *end = plain.step(actions)
        theirs, *other_end = full.step(actions)
        assert equal(tuple(end), tuple(other_end))
        assert equal(plain.state(), full.state())
        assert equal(plain.metrics(), full.metrics())


def test_metadata_and_agents():
    env = parallel_env(MANY)
    assert env.metadata["name"] == str(env) == "outrider_v0"
    assert env.metadata["render_modes"] == ["human", "rgb_array"]
    assert env.metadata["render_fps"] == 20
    assert env.metadata["is_parallelizable"]
    assert env.possible_agents == ["uav_0", "uav_1", "uav_2", "ugv_0", "ugv_1"]
    assert env.agents == []
    env.reset()
    assert env.agents == env.possible_agents


@pytest.mark.parametrize(("scenario", "options"), OPTIONS)
@pytest.mark.parametrize("push", ["random", "axis", "diagonal", "out"])
def test_everything_returned_lies_in_its_space(scenario, options, push):
    env = parallel_env(scenario, **{**options, "end_on_sight_lost": False})
    rng = np.random.default_rng(1)
    observations, _ = env.reset(seed=1)
    while env.agents:
        for name, observation in observations.items():
            assert env.observation_space(name).contains(observation), (
                env.world.tick,
                name,
                observation,
            )
        state = env.state()
        assert env.state_space.contains(state), dict(
            zip(env.state_names, state.tolist(), strict=False)
        )
        actions = random_actions(env, rng)
        if push != "random":
            way = {"axis": (-1.0, 0.0, -1.0), "diagonal": (1.0, 1.0, 1.0), "out": (3.7, -50.0, 9.0)}
            actions = {
                name: np.array(way[push])[: len(high)] * high
                for name, high in ((name, env.action_space(name).high) for name in env.agents)
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
    env.reset(seed=0)
    env.step({"uav_0": [40.0, 0.0], "ugv_0": [0.0, 0.0]})
    assert env.world.acceleration[0].tolist() == [40.0, 0.0]


def test_excessive_action_is_clipped_to_the_norm_bound():
    env = parallel_env(ONE)
    env.reset(seed=0)
    env.step({"uav_0": env.action_space("uav_0").high, "ugv_0": np.zeros(2)})
    assert np.hypot(*env.world.acceleration[0]) == pytest.approx(0.3, rel=1e-12)
    np.testing.assert_allclose(env.world.acceleration[0], [0.3 / math.sqrt(2.0)] * 2)


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


def test_an_unknown_scenario_or_agent_is_refused():
    with pytest.raises(ScenarioError, match="no_such_scenario"):
        parallel_env("no_such_scenario")
    with pytest.raises(ValueError, match=r"uav_7.*uav_0, ugv_0"):
        parallel_env(ONE).briefing("uav_7")


@pytest.mark.parametrize(("scenario", "options"), OPTIONS)
def test_same_seed_same_bits_for_more_than_a_thousand_ticks(scenario, options):
    """PettingZoo's own test checks one step only."""
    options = options | {"duration": 60.0, "end_on_sight_lost": False}
    first, second = (parallel_env(scenario, **options) for _ in range(2))
    assert equal(first.reset(seed=7), second.reset(seed=7))
    steps = 0
    for a, b in zip(
        fly(first, np.random.default_rng(7), 1200),
        fly(second, np.random.default_rng(7), 1200),
        strict=True,
    ):
        assert equal(a, b)
        assert equal(first.state(), second.state())
        assert equal(first.metrics(), second.metrics())
        steps += 1
    assert steps == 1200


def test_an_episode_leaves_nothing_behind_for_the_next():
    """Cover late detections, reached goals, and lost sight."""
    rare = msgspec.structs.replace(
        ONE,
        detections=Detections(dropout=0.95),
        ugv=(Ugv(position=(10.0, 10.0), goals=((10.3, 10.0),)),),
    )
    env = parallel_env(rare, end_on_sight_lost=False)

    def episode():
        yield env.reset(seed=2)
        yield env.metrics()
        for _ in range(600):
            yield env.step({"uav_0": [0.3, 0.0], "ugv_0": [0.1, 0.0]})
            yield env.metrics()

    whole = list(episode())
    assert whole[0][0]["uav_0"][8] == 60.0
    assert whole[-1]["ugv_0"]["goals_reached"] == 1
    assert whole[-1]["uav_0"]["visibility_violations"] > 100
    assert all(map(equal, whole, list(episode())))


def test_resets_without_a_seed_go_on_deterministically():
    def seeds(env, *given):
        return [env.reset(seed=seed) and env.episode_seed for seed in given]

    first = seeds(parallel_env(ONE), 4, None, None, None)
    assert first[0] == 4
    assert len(set(first)) == 4
    assert seeds(parallel_env(ONE), None, None, 4, None, None, None)[2:] == first
    unseeded = msgspec.structs.replace(ONE, seed=123)
    assert seeds(parallel_env(unseeded), None, None)[0] == 123
    assert seeds(parallel_env(unseeded), None, None) == seeds(parallel_env(ONE), 123, None)
    assert all(0 <= seed < 2**53 for seed in first)


def test_the_episode_seed_is_the_worlds():
    env = parallel_env(ONE)
    env.reset(seed=np.int64(4))
    env.reset()
    assert env.world.seed == env.episode_seed
    assert env.briefing("uav_0") == briefing(ONE, "uav_0", env.episode_seed)
    assert isinstance(env.briefing("uav_0"), UavBriefing)
    assert isinstance(env.briefing("ugv_0"), UgvBriefing)


def test_the_state_that_was_returned_never_changes_later():
    env = parallel_env(ONE)
    env.reset(seed=1)
    states = [(env.state(), env.state().copy())]
    for observations, *_ in fly(env, np.random.default_rng(0), 20):
        states.append((env.state(), env.state().copy()))
        observations["ugv_0"][:] = 1e9
    assert all(equal(now, then) for now, then in states)
    env.state()[:] = 1e9
    assert env.state_space.contains(env.state())


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])  # noqa: S301
def test_a_copy_goes_on_like_the_original(duplicate):
    env = parallel_env(
        MANY, coverage_patch=(8, 1.0), end_on_sight_lost=False, render_mode="rgb_array"
    )
    env.reset(seed=2)
    list(fly(env, np.random.default_rng(0), 30))
    env.render()
    other = duplicate(env)
    pairs = zip(
        fly(env, np.random.default_rng(1), 50),
        fly(other, np.random.default_rng(1), 50),
        strict=True,
    )
    assert all(equal(a, b) for a, b in pairs)
    assert equal(env.state(), other.state())
    assert equal(env.render(), other.render())
