"""The body frame and stacked observations, in every world of a vector environment across episodes."""

import math
from types import SimpleNamespace
from typing import Any

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers import FrameStackObservation

import outrider
from bus.observations import GRADIENT, UAV, UGV, by_name
from outrider_learning.egocentric import UAV_BODY, UGV_BODY, Egocentric
from outrider_learning.repeat import ActionRepeat
from outrider_learning.stacking import Stack
from outrider_learning.transformation import Transformation, Transformed
from refusals import refused
from sim.env.observation import ObservationFormat, one_of_world
from sim.env.settings import settings_of
from sim.scenario.loading import load_scenario
from sim.scenario.vehicle_types import Ugv
from worlds import FREE, ONE, equal

PATCH = (9, 0.7)
ALL = np.ones(1, dtype=np.bool_)
TICKS = (7, 11, 5)


class Rows(gymnasium.Env[Any, Any]):
    """One vehicle in an environment that ends after some ticks."""

    def __init__(self, ticks: int, patch: tuple[int, float] | None = None) -> None:
        self.ticks = ticks
        self.env = outrider.single_env(ONE, end_on_sight_lost=False, coverage_patch=patch)
        self.observation_space, self.action_space = (
            self.env.observation_space,
            self.env.action_space,
        )

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        self.tick = 0
        return self.env.reset(seed=seed)

    def step(self, action: Any) -> Any:
        seen, reward, *_ = self.env.step(action)
        self.tick += 1
        return seen, reward, False, self.tick >= self.ticks, {}


def worlds(mode: str, patch: Any = None, ticks: Any = TICKS) -> SyncVectorEnv:
    """Return a world for each of `ticks`."""
    return SyncVectorEnv([lambda n=n: Rows(n, patch) for n in ticks], autoreset_mode=mode)


def in_both(env: Any) -> Transformed:
    """Apply the body frame, then stack."""
    return Transformed(Transformed(env, Egocentric()), Stack(3))


def named(table: Any, row: Any) -> SimpleNamespace:
    """Return the entries of a row by name."""
    return SimpleNamespace(**{name: float(one) for name, one in by_name(table, row).items()})


def bound(one: Transformation, space: Any) -> Transformation:
    """Bind a transformation to the observations of one world."""
    one.space(space)
    return one


def uav_space(**settings: Any) -> Any:
    """Return the observation space of a UAV."""
    return outrider.single_env(ONE, **settings).observation_space


# -- each world of a batch


@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
@pytest.mark.parametrize("patch", [None, PATCH], ids=["row", "pictures"])
def test_each_world_matches_a_single_one_across_episode_ends(mode: str, patch: Any) -> None:
    env = in_both(worlds(mode, patch))
    alone = [in_both(worlds("Disabled", patch, [ticks])) for ticks in TICKS]
    assert env.single_observation_space == alone[0].single_observation_space
    assert env.observation_space == batch_space(env.single_observation_space, 3)
    rng, restart, finals = np.random.default_rng(5), [False] * 3, 0
    seen, _ = env.reset(seed=3)
    for k, one in enumerate(alone):
        assert equal(one_of_world(seen, k), one_of_world(one.reset(seed=3 + k)[0], 0))
    for _ in range(16):
        actions = rng.uniform(-0.3, 0.3, (3, 2))
        seen, _, _, truncated, infos = env.step(actions)
        assert env.observation_space.contains(seen)
        for k, one in enumerate(alone):
            end = [False]
            if restart[k]:
                now, restart[k] = one.reset()[0], False
            else:
                now, _, _, end, _ = one.step(actions[k : k + 1])
            assert end[0] == truncated[k]
            if end[0] and mode == "SameStep":
                assert equal(infos["final_obs"][k], one_of_world(now, 0))
                now, finals = one.reset()[0], finals + 1
            else:
                restart[k] = bool(end[0])
            assert equal(one_of_world(seen, k), one_of_world(now, 0))
    assert finals == (sum(16 // ticks for ticks in TICKS) if mode == "SameStep" else 0)


def test_only_worlds_in_the_reset_mask_restart() -> None:
    env = in_both(worlds("Disabled"))
    first, _ = env.reset(seed=0)
    for _ in range(4):
        before, *_ = env.step(np.full((3, 2), 0.2))
    mask = np.array([False, True, False])
    seen, _ = env.reset(seed=[None, 1, None], options={"reset_mask": mask})
    assert equal(seen[[0, 2]], before[[0, 2]])
    assert equal(seen[1], first[1])
    assert not equal(before[1], first[1])


def test_changing_a_returned_observation_has_no_effect() -> None:
    touched, untouched = (in_both(worlds("SameStep", PATCH)) for _ in range(2))
    (one, _), (other, _) = touched.reset(seed=1), untouched.reset(seed=1)
    for _ in range(8):
        assert equal(one, other)
        for array in one.values():
            array[...] = 77
        one, other = (env.step(np.full((3, 2), 0.05))[0] for env in (touched, untouched))


@pytest.mark.parametrize("patch", [None, PATCH])
@pytest.mark.parametrize("length", [1, 4])
def test_a_stack_is_gymnasiums_of_one_world(patch: Any, length: int) -> None:
    ours = Transformed(worlds("Disabled", patch, [12]), Stack(length))
    theirs = FrameStackObservation(Rows(12, patch), length)
    assert ours.single_observation_space == theirs.observation_space
    for seed in (1, None):
        assert equal(one_of_world(ours.reset(seed=seed)[0], 0), theirs.reset(seed=seed)[0])
        for _ in range(12):
            seen = ours.step(np.array([[0.1, 0.2]]))[0]
            assert equal(one_of_world(seen, 0), theirs.step(np.array([0.1, 0.2]))[0])


# -- the body frame


def turned(heading: Any, x: float, y: float) -> tuple[float, float]:
    """Return a vector of the body frame in the world frame."""
    return heading[0] * x - heading[1] * y, heading[1] * x + heading[0] * y


def test_a_uavs_row_in_its_frame_says_the_same_as_in_the_worlds() -> None:
    settings = {"num_envs": 2, "duration": 10.0, "end_on_sight_lost": False, "gradient": True}
    plain = outrider.vector_env("escort", **settings)
    env = Transformed(outrider.vector_env("escort", **settings), Egocentric())
    raw, seen = plain.reset(seed=4)[0], env.reset(seed=4)[0]
    rng = np.random.default_rng(4)
    for _ in range(199):
        assert env.observation_space.contains(seen)
        for k in range(2):
            was, now = named(UAV + GRADIENT, raw[k]), named(UAV_BODY + GRADIENT, seen[k])
            heading = now.heading_x, now.heading_y
            assert math.hypot(*heading) == pytest.approx(1.0)
            assert (now.time, now.detected, now.age) == (was.time, was.detected, was.age)
            if now.speed >= 0.01:
                ahead = turned(heading, now.speed, 0.0)
                np.testing.assert_allclose(ahead, (was.vx, was.vy), atol=1e-12)
            for name, wanted in (
                ("centre", (20.0 - was.x, 20.0 - was.y)),
                ("relative", (was.relative_x, was.relative_y)),
                ("gradient", (was.gradient_x, was.gradient_y)),
            ):
                own = (getattr(now, f"{name}_{axis}") for axis in "xy")
                np.testing.assert_allclose(turned(heading, *own), wanted, atol=1e-9)
        body = rng.uniform(-0.2, 0.2, (2, 2))
        world = [turned(seen[k, 2:4], *body[k]) for k in range(2)]
        raw, seen = plain.step(world)[0], env.step(body)[0]


def test_goal_is_relative_to_the_ugv_and_zero_after_the_last() -> None:
    near = Ugv(position=(10.0, 10.0), velocity=(0.0, 0.1), goals=((10.1, 10.3), (10.0, 10.4)))
    scenario = msgspec.structs.replace(ONE, ugv=(near,))
    settings = {"num_envs": 1, "agent": "ugv_0", "end_on_sight_lost": False}
    env = Transformed(outrider.vector_env(scenario, **settings), Egocentric())
    row = named(UGV_BODY, env.reset(seed=0)[0][0])
    assert (row.heading_x, row.heading_y, row.speed) == pytest.approx((0.0, 1.0, 0.1))
    # ahead is north, left is west
    assert (row.underway, row.goal_x, row.goal_y) == pytest.approx((1.0, 0.3, -0.1))
    one = bound(Egocentric(), env.env.single_observation_space)
    arrived = np.array([[1.0, 10.0, 10.0, 0.1, 0.0, 0.0, 12.0, 13.0]])
    assert len(arrived[0]) == len(UGV)
    np.testing.assert_array_equal(one.begin(arrived, ALL)[0, -3:], 0.0)


def test_heading_starts_east_and_is_kept_at_rest() -> None:
    one = bound(Egocentric(rest=0.1), uav_space())

    def row(vx: float, vy: float) -> Any:
        return np.array([[0.0, 1.0, 1.0, vx, vy, 0.0, 0.0, 0.0, 0.0]])

    def heading(seen: Any) -> list[float]:
        return seen[0, 2:4].tolist()

    assert heading(one.begin(row(0.0, 0.09), ALL)) == [1.0, 0.0]
    assert heading(one.apply(row(0.0, 0.2))) == [0.0, 1.0]
    assert heading(one.apply(row(-0.05, 0.0))) == [0.0, 1.0]
    np.testing.assert_array_equal(one.action(np.array([[0.3, 0.1]])), [[-0.1, 0.3]])
    assert heading(one.begin(row(0.0, 0.0), ALL)) == [1.0, 0.0]
    np.testing.assert_array_equal(one.action(np.array([[0.3, 0.1]])), [[0.3, 0.1]])
    assert heading(one.begin(row(-0.5, 0.0), ALL)) == [-1.0, 0.0]


@pytest.mark.parametrize("omit", [("time",), ("position",), ("time", "position")])
def test_a_short_row_turns_like_the_whole_one(omit: tuple[str, ...]) -> None:
    whole = {"estimate": True, "gradient": True, "duration": 10.0}
    long, short = (
        Transformed(outrider.vector_env(num_envs=2, **whole, **more), Egocentric())
        for more in ({}, {"omit": omit})
    )
    seen, shown = (env.reset(seed=3)[0] for env in (long, short))
    gone = [0] * ("time" in omit) + [4, 5] * ("position" in omit)
    for _ in range(20):
        np.testing.assert_array_equal(np.delete(seen, gone, axis=1), shown)
        assert short.observation_space.contains(shown)
        actions = np.tile((0.2, 0.1), (2, 1))
        seen, shown = (env.step(actions)[0] for env in (long, short))


@pytest.mark.parametrize("gradient", [False, True])
def test_altitude_and_climb_rate_do_not_turn(gradient: bool) -> None:
    settings = settings_of({"gradient": gradient})
    one = bound(Egocentric(), ObservationFormat(load_scenario("town"), settings).spaces["uav_0"])
    row = [0.0, 1.0, 1.0, 0.0, 0.5, 1.0, 0.2, 0.3, 0.0, 14.0, -0.5]
    seen = one.begin(np.array([row + [0.6, 0.8] * gradient]), ALL)[0]
    assert seen[10:12].tolist() == [14.0, -0.5]
    assert seen[7:9] == pytest.approx([0.3, -0.2])  # ahead is north, left is west
    assert seen[12:] == pytest.approx([0.8, -0.6] * gradient)
    np.testing.assert_array_equal(one.action(np.array([[0.3, 0.1, -0.7]])), [[-0.1, 0.3, -0.7]])


def test_the_picture_turns_with_the_vehicle() -> None:
    one = bound(Egocentric(), uav_space(coverage_patch=(5, 1.0)))
    picture = np.arange(25.0).reshape(5, 5) / 25.0

    def seen(vx: float, vy: float) -> Any:
        row = np.array([[0.0, 1.0, 1.0, vx, vy, 0.0, 0.0, 0.0, 0.0]])
        return one.begin({"row": row, "coverage": picture[None]}, ALL)["coverage"][0]

    np.testing.assert_array_equal(seen(0.5, 0.0), picture)
    np.testing.assert_array_equal(seen(-0.5, 0.0), picture[::-1, ::-1])
    np.testing.assert_array_equal(seen(0.0, 0.5), picture.T[::-1])  # ahead is north, left is west
    corners = seen(0.3, 0.3)[[0, 0, -1, -1], [0, -1, 0, -1]]
    np.testing.assert_array_equal(corners, 1.0)


@pytest.mark.parametrize("action", [np.zeros(3), [["a", "b"]], [[math.nan, 0.0]], None])
def test_a_bad_action_is_refused_by_the_environment(action: Any) -> None:
    env = Transformed(outrider.vector_env(FREE, num_envs=1), Egocentric())
    env.reset(seed=1)
    with refused(ValueError, "^actions? of uav_0"):
        env.step(action)


# -- refusals


def test_what_does_not_fit_is_refused_in_one_line() -> None:
    for space in (
        batch_space(uav_space(), 2),
        gymnasium.spaces.Box(-1.0, 1.0, (9,)),
        gymnasium.spaces.Discrete(3),
        bound(Egocentric(), uav_space()).space(uav_space()),
    ):
        with refused(ValueError, "Egocentric needs the row of a UAV or a UGV"):
            Egocentric().space(space)
    for length in (0, -1, 2.5, None, 10**9):
        with refused(ValueError, "length = .*; allowed: a whole number from 1"):
            Stack(length)
    for rest in (0.0, -1.0, math.inf):
        with refused(ValueError, "rest = .*; must be positive and finite"):
            Egocentric(rest=rest)


def test_other_libraries_find_the_mode_through_each_layer() -> None:
    env = outrider.vector_env(ONE, num_envs=2)
    for layer in (ActionRepeat(env, 2), Transformed(env, Stack(2))):
        assert layer.autoreset_mode is AutoresetMode.SAME_STEP
