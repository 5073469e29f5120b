"""Observations for learning: always in their spaces, the same alone and in a batch, composable."""

import copy
import itertools
import math
import warnings
from functools import partial
from types import SimpleNamespace

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array
from gymnasium.wrappers import FrameStackObservation
from hypothesis import given, settings
from hypothesis import strategies as st
from pages import blocks, run_shown
from pettingzoo.utils.conversions import parallel_to_aec
from refusals import refused
from worlds import FREE, ONE, equal

from agents.env_wrappers import EstimateWrapper, SafetyFilterWrapper
from bus.observations import UAV, UGV, by_name
from bus.profiles import PROFILES
from outrider.envs.observations.body import UAV_BODY, UGV_BODY, Egocentric
from outrider.envs.observations.image import CoverageImage
from outrider.envs.observations.normalized import Normalized
from outrider.envs.observations.stacking import History
from outrider.envs.wrappers import coverage_image, egocentric, history, normalized, transformed
from sim.env.observation import one_of_world
from sim.env.parallel import parallel_env
from sim.scenario.types import LinkTable, Uav, Ugv

with warnings.catch_warnings():
    # PettingZoo 1.27 makes an old environment of its own
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import api_test, parallel_api_test

MANY = msgspec.structs.replace(
    ONE,
    uav=(
        Uav(name="uav_0", position=(3.0, 38.0), velocity=(0.0, 0.5)),
        Uav(name="uav_1", position=(0.2, 39.9)),
    ),
    ugv=(Ugv(name="ugv_0", position=(1.0, 39.0)),),
)
SCENARIOS = {"one": ONE, "free": FREE, "many": MANY}
PATCH = (9, 0.7)


def linked(scenario, profile):
    return msgspec.structs.replace(
        scenario, links=LinkTable(detections=PROFILES[profile], commands=PROFILES[profile])
    )


def still(env):
    return {name: np.zeros(2) for name in env.agents}


def arrays(observation):
    """Each array by its key."""
    return observation if isinstance(observation, dict) else {"": observation}


def boxes(space):
    return dict(space.spaces) if isinstance(space, gymnasium.spaces.Dict) else {"": space}


def check_inside(env, observations):
    for name, observation in observations.items():
        space = env.observation_space(name)
        assert space.contains(observation), (name, observation, space)
        for key, box in boxes(space).items():
            assert arrays(observation)[key].dtype == box.dtype


# What is always so, whatever is put together.


@st.composite
def compositions(draw):
    """Wrappers in a sensible order, as functions of the environment and whether it has pictures."""
    layers = []
    first, second, third, twice, late = (draw(st.booleans()) for _ in range(5))
    estimated = draw(st.booleans())
    channels = draw(st.sampled_from(["last", "first"]))
    dtype = draw(st.sampled_from([np.float32, np.float64]))
    scale = draw(st.sampled_from([0.01, 5.0, 1e6]))
    length, stride, new_axis = draw(st.integers(1, 4)), draw(st.integers(1, 3)), draw(st.booleans())
    if estimated:
        layers.append(lambda env, _: EstimateWrapper(env))
    if first:
        layers.append(lambda env, _: egocentric(env, rest=rest))
    rest = draw(st.sampled_from([1e-9, 0.01, 1.0]))
    only = draw(st.booleans())
    middle = []
    if second:
        image = partial(coverage_image, channels=channels, only=only)
        middle.append(lambda env, pictures: image(env) if pictures else env)
    if third:
        middle.append(lambda env, _: normalized(env, scale=scale, dtype=dtype))
    layers += draw(st.permutations(middle))
    if twice:
        stacked = {"stride": stride, "new_axis": new_axis, "channels": channels}
        layers.append(lambda env, _: history(env, length, **stacked))
    if late:
        layers.append(lambda env, _: normalized(env, dtype=dtype, scale=scale))
    return layers


SIZES = st.one_of(st.sampled_from([0.0, 1e-300, 1e-3, 1.0, -1.0, 1e6, -1e6]), st.floats(-1.0, 1.0))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    layers=compositions(),
    scenario=st.sampled_from(sorted(SCENARIOS)),
    profile=st.sampled_from(["perfect", "perfect", "wifi-poor", "satellite", "jammed"]),
    pictures=st.booleans(),
    dtype=st.sampled_from([np.float32, np.float64]),
    seed=st.integers(0, 99),
    sizes=st.lists(st.tuples(SIZES, SIZES), min_size=2, max_size=12),
)
def test_the_spaces_contain_what_is_returned_always(
    layers, scenario, profile, pictures, dtype, seed, sizes
):
    env = parallel_env(
        linked(SCENARIOS[scenario], profile),
        duration=0.8,
        end_on_sight_lost=False,
        coverage_patch=PATCH if pictures else None,
        dtype=dtype,
    )
    for layer in layers:
        env = layer(env, pictures)
    returned = []
    for episode in range(2):
        observations, _ = env.reset(seed=seed if episode == 0 else None)
        check_inside(env, observations)
        turn = itertools.cycle(sizes)
        while env.agents:
            if env.unwrapped.world.tick == 3:
                with pytest.raises(ValueError, match="finite"):
                    env.step(still(env) | {"uav_0": np.array([0.0, math.nan])})
            returned.append((observations, copy.deepcopy(observations)))
            actions = {name: np.array(next(turn)) for name in env.agents}
            observations, *_ = env.step(actions)
            check_inside(env, observations)
    for now, then in returned:
        assert all(equal(now[name], then[name]) for name in now)


def everything(env):
    return history(normalized(coverage_image(egocentric(EstimateWrapper(env)))), 3, stride=2)


def test_what_is_done_to_a_returned_observation_changes_nothing_later():
    touched, twin = (everything(parallel_env(ONE, coverage_patch=PATCH)) for _ in range(2))
    (one, _), (other, _) = touched.reset(seed=1), twin.reset(seed=1)
    for _ in range(10):
        assert all(equal(one[name], other[name]) for name in one)
        for observation in one.values():
            for array in arrays(observation).values():
                array[...] = 77
        push = {name: np.array([0.05, 0.05]) for name in touched.agents}
        one, other = (env.step(push)[0] for env in (touched, twin))


TRANSFORMATIONS = [
    *(Normalized(dtype=np.float64), Egocentric(), History(1)),
    *(CoverageImage(), CoverageImage(only=True)),
]


@pytest.mark.parametrize("one", TRANSFORMATIONS)
def test_nothing_that_is_returned_shares_memory_with_what_was_given(one):
    space = parallel_env(ONE, coverage_patch=PATCH).observation_space("uav_0")
    space = gymnasium.spaces.Dict({**space.spaces, "more": space["coverage"]})
    one.space(space)
    given = space.sample()
    for seen in (one.begin(given, np.array(True)), one.apply(given)):
        for a, b in itertools.product(arrays(seen).values(), given.values()):
            assert not np.shares_memory(a, b)


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize(
    "wrap",
    [normalized, egocentric, partial(history, length=3, new_axis=True), coverage_image, everything],
)
def test_passes_pettingzoos_parallel_test(scenario, wrap):
    env = parallel_env(SCENARIOS[scenario], coverage_patch=PATCH, duration=2.0)
    parallel_api_test(wrap(env), num_cycles=60)


def test_passes_pettingzoos_test_as_a_turn_based_environment():
    with warnings.catch_warnings():
        # A UAV and a UGV see different things, and an image is not in [0, 1].
        warnings.filterwarnings(
            "ignore",
            "Agents have different|Observations are different|Observation is not|The observation",
        )
        api_test(
            parallel_to_aec(history(normalized(egocentric(parallel_env(ONE))), 2)), num_cycles=50
        )


def test_a_copy_goes_on_like_the_original():
    env = everything(parallel_env(ONE, coverage_patch=PATCH))
    env.reset(seed=2)
    env.step(still(env))
    other = copy.deepcopy(env)
    for _ in range(5):
        mine, its = env.step(still(env))[0], other.step(still(env))[0]
        assert all(equal(mine[name], its[name]) for name in mine)


# Normalized.


def test_normalized_entries_are_where_their_bounds_put_them():
    env = normalized(parallel_env(ONE))
    raw, _ = parallel_env(ONE).reset(seed=3)
    seen, _ = env.reset(seed=3)
    space = env.unwrapped.observation_space("uav_0")
    wanted = 2.0 * (raw["uav_0"] - space.low) / (space.high - space.low) - 1.0
    np.testing.assert_allclose(seen["uav_0"], wanted, rtol=0, atol=1e-6)
    one = Normalized()
    one.space(space)
    edges = one.apply(np.stack([space.low, space.high]))
    np.testing.assert_array_equal(edges, [[-1.0] * 9, [1.0] * 9])


def test_normalized_takes_what_has_no_bounds():
    low = np.array([-np.inf, 2.0, -np.inf, 3.0])
    high = np.array([np.inf, np.inf, 2.0, 3.0])
    one = Normalized(scale=4.0, dtype=np.float64)
    box = one.space(gymnasium.spaces.Box(low, high, dtype=np.float64))
    assert box == gymnasium.spaces.Box(-1.0, 1.0, (4,), np.float64)
    for given_, wanted in (
        ([0.0, 2.0, 2.0, 3.0], [0.0, -1.0, 1.0, 0.0]),
        ([4.0, 6.0, -2.0, 3.0], [0.5, 0.0, 0.0, 0.0]),
        ([-4.0, 6.0, -2.0, 3.0], [-0.5, 0.0, 0.0, 0.0]),
        ([-np.inf, np.inf, -np.inf, 3.0], [-1.0, 1.0, -1.0, 0.0]),
        ([1.7e308, 1.7e308, -1.7e308, 3.0], [1.0, 1.0, -1.0, 0.0]),
    ):
        np.testing.assert_array_equal(one.apply(np.array(given_)), wanted)


def test_normalized_brings_what_rounding_has_put_outside_back_into_the_box():
    one = Normalized()
    space = one.space(gymnasium.spaces.Box(-0.3, 0.3, (2,), np.float64))
    assert space.contains(one.apply(np.array([0.3 * (1.0 + 1e-6), -0.3 * (1.0 + 1e-6)])))


# The coverage as an image.


@pytest.mark.parametrize(("channels", "axis"), [("last", -1), ("first", -3)])
@pytest.mark.parametrize("pixels", [1, 8, 13])
def test_the_image_has_the_bytes_of_the_coverage(channels, axis, pixels):
    plain, inner, other = (parallel_env(ONE, coverage_patch=(pixels, 1.1)) for _ in range(3))
    env = coverage_image(inner, channels=channels)
    only = coverage_image(other, channels=channels, only=True)
    space = env.observation_space("uav_0")["coverage"]
    assert space.shape == tuple(np.expand_dims(np.empty((pixels, pixels)), axis).shape)
    assert (space.dtype, space.low.min(), space.high.max()) == (np.uint8, 0, 255)
    assert only.observation_space("uav_0") == space
    assert env.observation_space("ugv_0") == plain.observation_space("ugv_0")
    raw, seen, image = (one.reset(seed=1)[0]["uav_0"] for one in (plain, env, only))
    for _ in range(20):
        expected = np.expand_dims(np.floor(255.0 * raw["coverage"] + 0.5), axis)
        np.testing.assert_array_equal(seen["coverage"], expected)
        np.testing.assert_array_equal(image, expected)
        np.testing.assert_array_equal(seen["row"], raw["row"])
        raw, seen, image = (one.step(still(one))[0]["uav_0"] for one in (plain, env, only))


def test_a_byte_is_the_nearest_and_halves_go_up():
    one = CoverageImage(only=True)
    share = gymnasium.spaces.Box(0.0, 1.0, (2, 2), np.float64)
    row = gymnasium.spaces.Box(0.0, 1.0, (9,), np.float64)
    one.space(gymnasium.spaces.Dict({"row": row, "coverage": share}))
    picture = np.array([[0.0, 0.5], [1.0, 0.49 / 255.0]])
    seen = one.apply({"row": np.zeros(9), "coverage": picture})
    assert seen[..., 0].tolist() == [[0, 128], [255, 0]]


# The vehicle's frame.


def named(table, row):
    return SimpleNamespace(**by_name(table, row))


def turned(heading, x, y):
    """A vector of the vehicle's frame in the world frame."""
    return heading[0] * x - heading[1] * y, heading[1] * x + heading[0] * y


def test_the_rows_of_the_vehicles_frame_say_the_same_as_the_worlds():
    plain, inner = (parallel_env(MANY, end_on_sight_lost=False) for _ in range(2))
    env = egocentric(inner)
    raw, seen = plain.reset(seed=4)[0], env.reset(seed=4)[0]
    rng = np.random.default_rng(4)
    for _ in range(200):
        for name, row in raw.items():
            uav = name.startswith("uav")
            kinds = (UAV, UAV_BODY) if uav else (UGV, UGV_BODY)
            was, now = named(kinds[0], row), named(kinds[1], seen[name])
            heading = now.heading_x, now.heading_y
            assert now.time == was.time
            assert math.hypot(*heading) == pytest.approx(1.0)
            assert now.speed == pytest.approx(math.hypot(was.vx, was.vy))
            if now.speed >= 0.01:
                ahead = turned(heading, now.speed, 0.0)
                np.testing.assert_allclose(ahead, (was.vx, was.vy), atol=1e-12)
            centre = turned(heading, now.centre_x, now.centre_y)
            np.testing.assert_allclose(centre, (20.0 - was.x, 20.0 - was.y), atol=1e-9)
            if uav:
                assert (now.detected, now.age) == (was.detected, was.age)
                relative = turned(heading, now.relative_x, now.relative_y)
                np.testing.assert_allclose(relative, (was.relative_x, was.relative_y), atol=1e-12)
            else:
                assert (now.underway, now.goal_x, now.goal_y) == (0.0, 0.0, 0.0)
        body = {name: rng.uniform(-0.2, 0.2, 2) for name in env.agents}
        world = {name: np.array(turned(seen[name][2:4], *action)) for name, action in body.items()}
        raw, seen = plain.step(world)[0], env.step(body)[0]


def test_the_goal_is_seen_from_the_ugv_and_is_gone_with_the_last_one():
    near = msgspec.structs.replace(
        ONE,
        ugv=(Ugv(position=(10.0, 10.0), velocity=(0.0, 0.1), goals=((10.1, 10.3), (10.0, 10.4))),),
    )
    env = egocentric(parallel_env(near, end_on_sight_lost=False))
    row = named(UGV_BODY, env.reset(seed=0)[0]["ugv_0"])
    assert (row.heading_x, row.heading_y, row.speed) == pytest.approx((0.0, 1.0, 0.1))
    assert (row.underway, row.goal_x, row.goal_y) == pytest.approx(
        (1.0, 0.3, -0.1)
    )  # ahead is north, the left is west
    near = msgspec.structs.replace(
        ONE, ugv=(Ugv(position=(10.0, 10.0), velocity=(0.1, 0.0), goals=((10.1, 10.0),)),)
    )
    env = egocentric(parallel_env(near, end_on_sight_lost=False))
    row = named(UGV_BODY, env.reset(seed=0)[0]["ugv_0"])
    while row.underway:
        assert row.goal_x == pytest.approx(0.1 - 0.1 * row.time)
        row = named(UGV_BODY, env.step(still(env))[0]["ugv_0"])
    assert row.time == pytest.approx(0.5)
    assert (row.underway, row.goal_x, row.goal_y) == (0.0, 0.0, 0.0)


def test_the_heading_stays_while_the_vehicle_rests_and_begins_east():
    one = Egocentric(rest=0.1)
    box = parallel_env(ONE).observation_space("uav_0")
    one.space(box)

    def row(vx, vy):
        return np.array([0.0, 1.0, 1.0, vx, vy, 0.0, 0.0, 0.0, 0.0])

    def heading(seen):
        return seen[2:4].tolist()

    assert heading(one.begin(row(0.0, 0.09), np.array(True))) == [1.0, 0.0]
    assert heading(one.apply(row(0.0, 0.2))) == [0.0, 1.0]
    assert heading(one.apply(row(-0.05, 0.0))) == [0.0, 1.0]
    np.testing.assert_array_equal(one.action(np.array([0.3, 0.1])), [-0.1, 0.3])
    assert heading(one.begin(row(0.0, 0.0), np.array(True))) == [1.0, 0.0]
    np.testing.assert_array_equal(one.action(np.array([0.3, 0.1])), [0.3, 0.1])
    assert heading(one.begin(row(-0.5, 0.0), np.array(True))) == [-1.0, 0.0]


def test_the_gradient_behind_a_row_is_turned_too():
    one = Egocentric()
    row = parallel_env(ONE).observation_space("uav_0")
    low, high = np.append(row.low, [-1.0, -1.0]), np.append(row.high, [1.0, 1.0])
    space = gymnasium.spaces.Box(low, high, dtype=np.float64)
    assert one.space(space).shape == (12,)
    north = (0.0, 1.0, 1.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0)
    seen = one.begin(np.array([*north, 0.6, 0.8]), np.array(True))
    np.testing.assert_allclose(seen[-2:], [0.8, -0.6])


def test_an_action_at_the_limit_is_taken_whatever_the_heading():
    env = egocentric(parallel_env(FREE, end_on_sight_lost=False))
    env.reset(seed=1)
    for action in ([1.0, 1.0], [1e6, 1e6], [-1e6, 1e6], [1e6, 0.0]):
        before = env.unwrapped.world.acceleration.copy()
        env.step(still(env) | {"uav_0": action})
        assert not np.array_equal(env.unwrapped.world.acceleration, before)
    one = Egocentric()
    one.space(parallel_env(ONE).observation_space("uav_0"))
    one.begin(np.array([0.0, 1.0, 1.0, 0.3, 0.4, 0.0, 0.0, 0.0, 0.0]), np.array(True))
    world = one.action(np.array([1e6, -1e6]))
    assert np.abs(world).max() == 1e6
    np.testing.assert_allclose(world / 1e6, [1.0, 1.0 / 7.0])  # shortened, its direction kept


def test_the_picture_turns_with_the_vehicle():
    one = Egocentric()
    space = parallel_env(ONE, coverage_patch=(5, 1.0)).observation_space("uav_0")
    one.space(space)
    picture = np.arange(25.0).reshape(5, 5) / 25.0

    def seen(vx, vy):
        row = np.array([0.0, 1.0, 1.0, vx, vy, 0.0, 0.0, 0.0, 0.0])
        return one.begin({"row": row, "coverage": picture}, np.array(True))["coverage"]

    np.testing.assert_array_equal(seen(0.5, 0.0), picture)
    np.testing.assert_array_equal(seen(-0.5, 0.0), picture[::-1, ::-1])
    np.testing.assert_array_equal(seen(0.0, 0.5), picture.T[::-1])  # ahead is north, left is west
    np.testing.assert_array_equal(seen(0.0, 0.5)[2], picture[:, 2])
    corners = seen(0.3, 0.3)[[0, 0, -1, -1], [0, -1, 0, -1]]
    np.testing.assert_array_equal(corners, 1.0)


# History.


class Rows(gymnasium.Env):
    """A UAV alone at the controls, in an environment that ends after some ticks."""

    def __init__(self, ticks, *, wrap=lambda env: env, patch=None):
        self.ticks = ticks
        self.env = wrap(parallel_env(ONE, end_on_sight_lost=False, coverage_patch=patch))
        self.observation_space = self.env.observation_space("uav_0")
        self.action_space = self.env.action_space("uav_0")

    def reset(self, *, seed=None, options=None):
        return self.env.reset(seed=seed)[0]["uav_0"], {}

    def step(self, action):
        observations, rewards, *_ = self.env.step({"uav_0": action, "ugv_0": np.zeros(2)})
        over = self.env.unwrapped.world.tick >= self.ticks
        return observations["uav_0"], rewards["uav_0"], False, over, {}


@pytest.mark.parametrize("patch", [None, PATCH])
@pytest.mark.parametrize("length", [1, 4])
def test_history_with_a_new_axis_is_gymnasiums_frame_stack(patch, length):
    ours = Rows(12, wrap=lambda env: history(env, length, new_axis=True), patch=patch)
    theirs = FrameStackObservation(Rows(12, patch=patch), length)
    assert ours.observation_space == theirs.observation_space
    for seed in (1, None):
        assert equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
        for _ in range(12):
            assert equal(ours.step(np.array([0.1, 0.2]))[0], theirs.step(np.array([0.1, 0.2]))[0])


@pytest.mark.parametrize(
    ("shape", "channels", "out", "axis"),
    [
        ((9,), "last", (27,), 0),
        ((9,), "first", (27,), 0),
        ((4, 5), "last", (4, 5, 3), -1),
        ((4, 5), "first", (3, 4, 5), 0),
        ((4, 5, 2), "last", (4, 5, 6), -1),
        ((2, 4, 5), "first", (6, 4, 5), 0),
    ],
)
def test_history_concatenates_with_a_stride_and_repeats_the_first(shape, channels, out, axis):
    one = History(3, stride=2, channels=channels)
    assert one.space(gymnasium.spaces.Box(-5.0, 50.0, shape, np.float32)).shape == out
    batch = History(3, stride=2, channels=channels)
    batch.space(gymnasium.spaces.Box(-5.0, 50.0, shape, np.float32))
    join = np.stack if len(out) > len(shape) else np.concatenate
    frames = np.random.default_rng(0).uniform(-5.0, 50.0, (9, *shape)).astype(np.float32)
    for k, frame in enumerate(frames):
        seen = one.begin(frame, np.array(True)) if k == 0 else one.apply(frame)
        pair = np.stack([frame, -frame])
        both = batch.begin(pair, np.ones(2, bool)) if k == 0 else batch.apply(pair)
        expected = join([frames[max(k - 4, 0)], frames[max(k - 2, 0)], frame], axis=axis)
        np.testing.assert_array_equal(seen, expected)
        np.testing.assert_array_equal(both, [expected, -expected])


# A batch of worlds.


class Arrays(SyncVectorEnv):
    """Worlds whose final observations come as arrays, or as dictionaries of arrays."""

    def step(self, actions):
        seen, *told, infos = super().step(actions)
        if "final_obs" in infos:
            last = enumerate(infos["final_obs"])
            rows = [one_of_world(seen, k) if one is None else one for k, one in last]
            infos["final_obs"] = concatenate(
                self.single_observation_space,
                rows,
                create_empty_array(self.single_observation_space, len(rows)),
            )
        return seen, *told, infos


def sync(mode, kind=SyncVectorEnv):
    return lambda worlds: kind([lambda world=world: world for world in worlds], autoreset_mode=mode)


COMPOSITIONS = {
    "normalized": normalized,
    "egocentric": egocentric,
    "history": lambda env: history(env, 3, stride=2),
    "all": lambda env: history(normalized(egocentric(env)), 4),
    "reversed": lambda env: normalized(
        history(egocentric(env), 2, new_axis=True), dtype=np.float64
    ),
}
PICTURES = {
    "image": lambda env: history(coverage_image(env, agents=pick(env)), 3),
    "all": lambda env: history(
        normalized(coverage_image(egocentric(env), channels="first", agents=pick(env))),
        3,
        channels="first",
    ),
    "only": lambda env: history(coverage_image(egocentric(env), only=True, agents=pick(env)), 2),
}
TICKS = (7, 11, 5)


def pick(env):
    return None if isinstance(env, VectorEnv) else ["uav_0"]


@pytest.mark.parametrize(
    "make",
    [sync("SameStep", Arrays), sync("SameStep"), sync("NextStep")],
    ids=["arrays", "same_step", "next_step"],
)
@pytest.mark.parametrize(
    ("wrap", "patch"),
    [pytest.param(wrap, None, id=name) for name, wrap in COMPOSITIONS.items()]
    + [pytest.param(wrap, PATCH, id=f"pictures-{name}") for name, wrap in PICTURES.items()],
)
def test_each_world_of_a_batch_is_as_it_is_alone_across_the_ends_of_episodes(make, wrap, patch):
    env = wrap(make([Rows(ticks, patch=patch) for ticks in TICKS]))
    alone = [Rows(ticks, patch=patch, wrap=wrap) for ticks in TICKS]
    assert env.single_observation_space == alone[0].observation_space
    assert env.observation_space == batch_space(env.single_observation_space, 3)
    assert env.action_space == batch_space(env.single_action_space, 3)
    rng = np.random.default_rng(5)
    seen, _ = env.reset(seed=3)
    for k, one in enumerate(alone):
        assert equal(one_of_world(seen, k), one.reset(seed=3 + k)[0])
    same_step = env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    to_begin, finals = [False] * len(alone), 0
    for _ in range(16):
        actions = rng.uniform(-0.3, 0.3, (3, 2))
        seen, _, terminations, truncations, infos = env.step(actions)
        assert env.observation_space.contains(seen)
        for k, one in enumerate(alone):
            if to_begin[k]:
                (now, _), end, to_begin[k] = one.reset(), False, False
            else:
                now, _, _, end, _ = one.step(actions[k])
            assert end == (terminations[k] or truncations[k])
            if end and same_step:
                assert infos["_final_obs"][k]
                assert equal(one_of_world(infos["final_obs"], k), now)
                of_objects = getattr(infos["final_obs"], "dtype", None) == np.dtype(object)
                assert of_objects != isinstance(env.unwrapped, Arrays)
                now, _ = one.reset()
                finals += 1
            else:
                to_begin[k] = end
            assert equal(one_of_world(seen, k), now)
    assert finals == (sum(16 // ticks for ticks in TICKS) if same_step else 0)


def test_worlds_that_are_reset_by_hand_begin_and_the_others_do_not():
    env = history(egocentric(sync("Disabled")([Rows(ticks) for ticks in TICKS])), 3)
    alone = [Rows(ticks, wrap=lambda env: history(egocentric(env), 3)) for ticks in TICKS]
    env.reset(seed=0)
    before = [one.reset(seed=k)[0] for k, one in enumerate(alone)]
    for _ in range(4):
        env.step(np.full((3, 2), 0.2))
        before = [one.step(np.full(2, 0.2))[0] for one in alone]
    seen, _ = env.reset(options={"reset_mask": np.array([False, True, False])})
    assert equal(seen[0], before[0])
    assert equal(seen[1], alone[1].reset()[0])
    assert equal(seen[2], before[2])


def test_bad_rows_of_a_batch_of_actions_pass_as_they_are():
    one = Egocentric()
    one.space(parallel_env(ONE).observation_space("uav_0"))
    rows = np.array([(0.0, 1.0, 1.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0)] * 3)
    one.begin(rows, np.ones(3, bool))
    world = one.action(np.array([[1.0, 0.0], [math.nan, 2.0], [3.0, 1e9]]))
    np.testing.assert_array_equal(world, [[0.0, 1.0], [math.nan, 2.0], [3.0, 1e9]])


# What does not fit.


def stacked(env):
    return history(env, 2, new_axis=True)


@pytest.mark.parametrize(
    ("wrap", "words"),
    [
        (coverage_image, "coverage_patch"),
        (lambda env: coverage_image(env, agents=["uav_0"]), r"uav_0: .*coverage_patch"),
        (lambda env: egocentric(normalized(env)), r"uav_0: Egocentric needs"),
        (lambda env: egocentric(egocentric(env)), r"uav_0: Egocentric needs"),
        (lambda env: egocentric(egocentric(env), agents=["ugv_0"]), r"ugv_0: Egocentric needs"),
        (lambda env: egocentric(history(env, 1, new_axis=True)), r"uav_0: Egocentric needs"),
        (lambda env: stacked(stacked(stacked(env))), None),
        (lambda env: history(stacked(stacked(stacked(env))), 2), "new_axis"),
        (lambda env: history(env, 0), "length = 0"),
        (lambda env: history(env, 2.5), "length = 2.5"),
        (lambda env: history(env, True), "length = True"),
        (lambda env: history(env, 2, stride=0), "stride = 0"),
        (lambda env: history(env, 2, channels="middle"), "channels"),
        (lambda env: normalized(env, scale=0.0), "scale"),
        (lambda env: normalized(env, scale=math.inf), "scale"),
        (lambda env: normalized(env, dtype=np.int32), "dtype"),
        (lambda env: egocentric(env, rest=-1.0), "rest"),
        (lambda env: normalized(env, agents=["uav_7"]), r"uav_7.*uav_0, ugv_0"),
        (lambda env: normalized(env, agents="uav_0"), "a list of any of uav_0, ugv_0"),
        (lambda env: normalized(sync("SameStep")([Rows(3)]), agents=["uav_0"]), "agents"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(wrap, words):
    if words is None:
        wrap(parallel_env(ONE))
        return
    with refused(ValueError, words):
        wrap(parallel_env(ONE))


def test_pictures_that_are_no_longer_the_environments_own_are_refused_in_one_line():
    for wrap in (
        lambda env: egocentric(coverage_image(env)),
        lambda env: coverage_image(coverage_image(env)),
        lambda env: coverage_image(history(env, 2)),
    ):
        with refused(ValueError, "own coverage"):
            wrap(parallel_env(ONE, coverage_patch=PATCH))


def test_what_is_no_environment_of_these_kinds_is_refused_in_one_line():
    for env in (5, None, parallel_to_aec(parallel_env(ONE)), Rows(3)):
        for wrap in (normalized, egocentric, coverage_image, lambda env: history(env, 2)):
            with pytest.raises(TypeError, match=r"ParallelEnv or a gymnasium\.vector\.VectorEnv"):
                wrap(env)
    worlds = sync("SameStep")([Rows(3)])
    worlds.metadata = {}
    with pytest.raises(ValueError, match="autoreset_mode"):
        normalized(worlds)


def test_only_the_agents_that_are_named_are_transformed():
    env = egocentric(parallel_env(ONE), agents=["uav_0"])
    plain = parallel_env(ONE)
    assert env.observation_space("ugv_0") == plain.observation_space("ugv_0")
    seen, raw = env.reset(seed=1)[0], plain.reset(seed=1)[0]
    assert equal(seen["ugv_0"], raw["ugv_0"])
    assert seen["uav_0"].shape == (10,)
    assert np.array_equal(env.state(), plain.state())


def test_the_safety_filter_goes_inside():
    env = history(normalized(egocentric(SafetyFilterWrapper(parallel_env(ONE, duration=0.3)))), 2)
    env.reset(seed=1)
    while env.agents:
        observations, *_, infos = env.step({name: np.array([0.3, 0.0]) for name in env.agents})
        check_inside(env, observations)
        assert "certified" in infos["uav_0"]


def test_a_transformation_of_ones_own_takes_its_place():
    env = transformed(parallel_env(ONE), lambda: Normalized(scale=1.0))
    twin = normalized(parallel_env(ONE), scale=1.0)
    assert equal(env.reset(seed=1)[0]["uav_0"], twin.reset(seed=1)[0]["uav_0"])


# The documentation.


def test_the_examples_of_the_documentation_run():
    page = "docs/how-to/learning-observations.md"
    *examples, _ = blocks("python", page)  # the last needs SuperSuit and Stable-Baselines3
    assert len(examples) == 2
    for example in examples:
        run_shown(example, page)
