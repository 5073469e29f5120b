"""The environment as PettingZoo and a learner meet it: API, spaces, actions, errors, determinism."""

import copy
import itertools
import math
import pickle
import warnings

import msgspec
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from pettingzoo.utils.conversions import aec_to_parallel, parallel_to_aec
from refusals import refused

from bus.errors import ScenarioError
from bus.messages import Area, Law, UavBriefing, UgvBriefing
from outrider.envs.single import single_env
from outrider.envs.vector import parallel_vector_env, vector_env
from sim.engine.briefing import briefing
from sim.env.parallel import OutriderEnv, parallel_env
from sim.env.spaces import FREE_ACCELERATION, extent_of
from sim.models.vehicles import clip_norm
from sim.scenario.types import Detections, Scenario, Uav, Ugv

with warnings.catch_warnings():
    warnings.simplefilter(
        "ignore", DeprecationWarning
    )  # PettingZoo 1.27 makes an old environment of its own
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, state_test

ONE = Scenario(
    name="one",
    duration=60.0,
    detections=Detections(noise=0.1, dropout=0.2, rate=10.0),
    uav=(Uav(position=(12.0, 10.0)),),
    ugv=(Ugv(position=(10.0, 10.0), goals=((14.0, 10.0), (14.0, 16.0))),),
)
FREE = Scenario(
    name="free",
    duration=60.0,
    detections=Detections(noise=0.1, cut=0.0),
    law=Law(reference_speed=1.0),
    uav=(Uav(position=(12.0, 10.0), max_speed=math.inf, max_acceleration=math.inf),),
    ugv=(Ugv(position=(10.0, 10.0), max_acceleration=10.0),),
)
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
OPTIONS = [
    pytest.param(ONE, {}, id="one"),
    pytest.param(ONE, {"dtype": np.float32}, id="float32"),
    pytest.param(ONE, {"coverage_patch": (16, 0.5), "coverage_in_state": True}, id="patch"),
    pytest.param(FREE, {}, id="free"),
    pytest.param(
        MANY,
        {"end_on_sight_lost": False, "dtype": np.float32, "coverage_patch": (7, 1.3)},
        id="many",
    ),
    pytest.param(msgspec.structs.replace(ONE, uav=()), {}, id="without a UAV"),
]


def random_actions(env, rng, *, length=1.0):
    return {
        name: rng.uniform(-length, length, 2) * env.action_space(name).high for name in env.agents
    }


def fly(env, rng, ticks):
    for _ in range(ticks):
        if not env.agents:
            return
        yield env.step(random_actions(env, rng))


def same(a, b):
    """Bit for bit, whatever the nesting."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return type(a) is type(b) and a == b


@pytest.mark.parametrize(("scenario", "options"), OPTIONS)
def test_passes_pettingzoos_parallel_test(scenario, options):
    parallel_api_test(parallel_env(scenario, **options), num_cycles=400)


def test_passes_pettingzoos_seed_test():
    parallel_seed_test(lambda: parallel_env(ONE), num_cycles=200)


def test_passes_pettingzoos_tests_as_a_turn_based_environment():
    with warnings.catch_warnings():
        # A UAV and a UGV see different things.
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
        assert same(observations, {name: turns.observe(name) for name in direct.agents})
        assert same(rewards, turns.rewards)


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
            way = {"axis": (-1.0, 0.0), "diagonal": (1.0, 1.0), "out": (3.7, -50.0)}[push]
            actions = {name: np.array(way) * env.action_space(name).high for name in env.agents}
        observations, *_ = env.step(actions)


def test_spaces_are_as_tight_as_the_scenario_says():
    env = parallel_env(ONE)
    low, high = env.observation_space("uav_0").low, env.observation_space("uav_0").high
    reach = ONE.sensor.range + 3.0 * 0.1
    np.testing.assert_allclose(
        high, [60.0, 40.0, 40.0, 0.6, 0.6, 1.0, reach, reach, 60.0], rtol=1e-12
    )
    np.testing.assert_allclose(
        low, [0.0, 0.0, 0.0, -0.6, -0.6, 0.0, -reach, -reach, 0.0], rtol=1e-12
    )
    high = env.observation_space("ugv_0").high
    np.testing.assert_allclose(high, [60.0, 40.0, 40.0, 0.2, 0.2, 1.0, 40.0, 40.0], rtol=1e-12)
    np.testing.assert_array_equal(env.action_space("uav_0").high, [0.3, 0.3])
    np.testing.assert_array_equal(env.action_space("ugv_0").low, [-0.1, -0.1])


def test_the_bounds_leave_room_for_the_rounding_of_the_worlds_clipping():
    """A vector shortened to its bound may be longer by a last place or two."""
    rng = np.random.default_rng(0)
    longer = 0
    for limit, x, y in rng.uniform(0.0, 1.0, (20_000, 3)):
        uav = Uav(position=(12.0, 10.0), max_speed=limit)
        clipped, _ = clip_norm(x + limit, y * 1e-9, limit)
        longer += clipped > limit
        assert clipped <= extent_of(ONE, uav)["v_max"]
    assert longer > 100


def test_unbounded_vehicles_have_unbounded_observations_and_a_finite_action_space():
    env = parallel_env(FREE)
    assert np.isinf(env.observation_space("uav_0").high[[3, 4, 6, 7]]).all()
    np.testing.assert_array_equal(env.action_space("uav_0").high, [FREE_ACCELERATION] * 2)
    env.reset(seed=0)
    env.step({"uav_0": [40.0, 0.0], "ugv_0": [0.0, 0.0]})
    assert env.world.acceleration[0].tolist() == [40.0, 0.0]


def test_an_action_that_is_too_long_is_shortened_to_the_norm_bound():
    env = parallel_env(ONE)
    env.reset(seed=0)
    env.step({"uav_0": env.action_space("uav_0").high, "ugv_0": np.zeros(2)})
    assert np.hypot(*env.world.acceleration[0]) == pytest.approx(0.3, rel=1e-12)
    np.testing.assert_allclose(env.world.acceleration[0], [0.3 / math.sqrt(2.0)] * 2)


@pytest.mark.parametrize("kind", [list, tuple, np.float32, np.float16, np.int64])
def test_actions_may_be_lists_or_arrays_of_any_number_type(kind):
    env, twin = parallel_env(FREE), parallel_env(FREE)
    env.reset(seed=0)
    twin.reset(seed=0)
    action = [0.0, 1.0]  # exact in every type
    given = kind(action) if kind in {list, tuple} else np.array(action, dtype=kind)
    assert same(
        env.step({"uav_0": given, "ugv_0": given}),
        twin.step({"uav_0": np.array(action), "ugv_0": np.array(action)}),
    )


GOOD = {"uav_0": np.array([0.1, 0.0]), "ugv_0": np.array([0.0, 0.1])}


@pytest.mark.parametrize(
    ("actions", "words"),
    [
        ({**GOOD, "uav_0": np.zeros(3)}, r"uav_0 .* two numbers"),
        ({**GOOD, "uav_0": np.zeros((1, 2))}, r"uav_0 .* two numbers"),
        ({**GOOD, "uav_0": 0.1}, r"uav_0 .* two numbers"),
        ({**GOOD, "uav_0": [0.1, [0.2]]}, r"uav_0 .* two numbers"),
        ({**GOOD, "ugv_0": ["a", "b"]}, r"ugv_0 .* two numbers"),
        ({**GOOD, "ugv_0": None}, r"ugv_0 .* two numbers"),
        ({**GOOD, "ugv_0": np.array([True, False])}, r"ugv_0 .* two numbers"),
        ({**GOOD, "ugv_0": np.array([math.nan, 0.0])}, r"ugv_0 .* finite"),
        ({**GOOD, "ugv_0": [0.0, math.inf]}, r"ugv_0 .* finite"),
        ({**GOOD, "ugv_0": [0.0, -1e7]}, r"ugv_0 .* finite"),
        ({"uav_0": GOOD["uav_0"]}, r"for: uav_0; needed .* uav_0, ugv_0"),
        ({}, r"for: nobody; needed .* uav_0, ugv_0"),
        ({**GOOD, "uav_7": GOOD["uav_0"]}, r"uav_7; needed .* uav_0, ugv_0"),
        ({"uav_0": GOOD["uav_0"], "uav_7": GOOD["uav_0"]}, r"uav_7; needed .* uav_0, ugv_0"),
    ],
)
def test_bad_actions_are_refused_in_one_line_and_nothing_happens(actions, words):
    env, twin = parallel_env(ONE), parallel_env(ONE)
    env.reset(seed=5)
    twin.reset(seed=5)
    assert same(env.step(GOOD), twin.step(GOOD))
    with refused(ValueError, words):
        env.step(actions)
    assert same(env.step(GOOD), twin.step(GOOD))
    assert same(env.state(), twin.state())


def test_nothing_works_before_the_first_reset_or_after_the_end():
    env = parallel_env(ONE, duration=0.1)
    for call in (lambda: env.step(GOOD), env.state, env.metrics):
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
    ("options", "words"),
    [
        ({"render_mode": "ansi"}, "render_mode"),
        ({"dtype": np.int32}, "dtype"),
        ({"coverage_patch": (0, 1.0)}, "pixels"),
        ({"coverage_patch": (1.5, 1.0)}, "pixels"),
        ({"coverage_patch": (8, 0.0)}, "meters_per_pixel"),
        ({"coverage_patch": (8, math.inf)}, "meters_per_pixel"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(options, words):
    with refused(ValueError, words):
        parallel_env(ONE, **options)


@pytest.mark.parametrize("make", [parallel_env, vector_env, parallel_vector_env, single_env])
def test_an_argument_of_another_name_is_refused_and_those_that_there_are_are_named(make):
    count = {"num_envs": 2} if make in (vector_env, parallel_vector_env) else {}
    with refused(TypeError, r"'durations': no such setting; allowed: .*duration, "):
        make(ONE, **count, durations=2.0)


@pytest.mark.parametrize("duration", [0.0, -1.0, 0.12, math.nan, math.inf])
def test_bad_durations_are_refused_in_one_line(duration):
    with refused(ScenarioError, "duration"):
        parallel_env(ONE, duration=duration)


def test_a_scenario_that_cannot_be_flown_is_refused():
    with pytest.raises(ScenarioError, match=r"outside Q"):
        parallel_env(msgspec.structs.replace(ONE, uav=(Uav(position=(50.0, 10.0)),)))


def test_an_unknown_scenario_or_agent_is_refused():
    with pytest.raises(ScenarioError, match="no_such_scenario"):
        parallel_env("no_such_scenario")
    with pytest.raises(ValueError, match=r"uav_7.*uav_0, ugv_0"):
        parallel_env(ONE).briefing("uav_7")


@pytest.mark.parametrize("seed", [-1, 2**53, 1.5, "1"])
def test_bad_seeds_are_refused(seed):
    env = parallel_env(ONE)
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=seed)
    env.reset(seed=np.int64(1))


@pytest.mark.parametrize(("scenario", "options"), OPTIONS)
def test_same_seed_same_bits_for_more_than_a_thousand_ticks(scenario, options):
    """PettingZoo's own test looks at one step only."""
    first, second = (parallel_env(scenario, **options, duration=60.0) for _ in range(2))
    first.end_on_sight_lost = second.end_on_sight_lost = False
    assert same(first.reset(seed=7), second.reset(seed=7))
    steps = 0
    for a, b in zip(
        fly(first, np.random.default_rng(7), 1200),
        fly(second, np.random.default_rng(7), 1200),
        strict=True,
    ):
        assert same(a, b)
        assert same(first.state(), second.state())
        assert same(first.metrics(), second.metrics())
        steps += 1
    assert steps == 1200


def test_another_seed_gives_other_detections():
    env = parallel_env(ONE)
    observations = [env.reset(seed=seed)[0] for seed in (1, 2)]
    assert not same(observations[0]["uav_0"], observations[1]["uav_0"])
    assert same(observations[0]["ugv_0"], observations[1]["ugv_0"])


def test_reset_in_the_middle_repeats_the_episode():
    env = parallel_env(
        MANY, end_on_sight_lost=False, coverage_patch=(9, 1.0), coverage_in_state=True
    )

    def episode():
        yield env.reset(seed=11)
        for step in fly(env, np.random.default_rng(2), 100):
            yield step
            yield env.state()

    whole = list(episode())
    list(itertools.islice(episode(), 80))
    assert all(map(same, whole, list(episode())))


def test_an_episode_leaves_nothing_behind_for_the_next():
    """Detections that come late, goals that are reached, sight that is lost."""
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
    assert all(map(same, whole, list(episode())))


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
    env.reset(seed=4)
    env.reset()
    assert env.world.seed == env.episode_seed
    assert env.briefing("uav_0") == briefing(ONE, "uav_0", env.episode_seed)
    assert isinstance(env.briefing("uav_0"), UavBriefing)
    assert isinstance(env.briefing("ugv_0"), UgvBriefing)


def test_returned_arrays_never_change_later():
    env = parallel_env(ONE, coverage_patch=(8, 1.0), coverage_in_state=True)
    observations, _ = env.reset(seed=1)
    kept = [(observations, copy.deepcopy(observations))]
    states = [(env.state(), env.state().copy())]
    rng = np.random.default_rng(0)
    for observations, *_ in fly(env, rng, 20):
        kept.append((observations, copy.deepcopy(observations)))
        states.append((env.state(), env.state().copy()))
    assert all(same(now, then) for now, then in kept + states)
    observations["ugv_0"][:] = 1e9
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
    assert all(same(a, b) for a, b in pairs)
    assert same(env.state(), other.state())
    assert same(env.render(), other.render())
