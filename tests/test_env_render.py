"""Pictures of the environment, and the window."""

import sys

import gymnasium
import msgspec
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from bus.errors import OutriderError
from bus.messages.scenario import Area, Law
from flights import pairs
from outrider.envs.env_pilots import pilots
from outrider.envs.parallel import parallel_env
from outrider.envs.single import single_env
from outrider.envs.vector import parallel_vector_env, vector_env
from outrider.registration import ESCORT
from refusals import refused
from sim.env.view import Window
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav, Ugv
from sim.scene.colors import LIMIT, UAV, UGV

SCENARIO = Scenario(
    name="wide",
    duration=10.0,
    area=Area(width=40.0, height=20.0, cell=0.25),
    uav=(Uav(position=(12.0, 10.0)),),
    ugv=(Ugv(position=(10.0, 10.0), goals=((14.0, 10.0),)),),
)
ACTIONS = {"uav_0": [0.3, 0.0], "ugv_0": [0.0, 0.0]}


def pixels_of(frame, color):
    """Return rows and columns of the pixels with this color."""
    return np.argwhere(
        (np.abs(frame.astype(int) - np.array(to_rgb(color)) * 255.0) < 3.0).all(axis=2)
    )


def started_env(scenario=SCENARIO):
    env = parallel_env(scenario, render_mode="rgb_array")
    env.reset(seed=0)
    return env


def center_of(frame, color):
    """Return the row and the column of a vehicle, above the legend."""
    return np.median(pixels_of(frame[: int(0.9 * len(frame))], color), axis=0)


def test_pictures_follow_the_flight_in_proportion():
    env, scale = started_env(), 800 / 40
    frame = env.render()
    assert (frame.dtype, frame.ndim, frame.shape[2]) == (np.uint8, 3, 3)
    assert frame.shape[1] > 1.5 * frame.shape[0]
    uav, ugv = (center_of(frame, color) for color in (UAV[0], UGV[0]))
    assert uav[0] == pytest.approx(ugv[0], abs=3.0)
    assert uav[1] - ugv[1] == pytest.approx(2.0 * scale, abs=8.0)
    ring = pixels_of(frame[: int(0.9 * len(frame))], LIMIT)
    assert np.ptp(ring[:, 1]) == pytest.approx(2.0 * 4.75 * scale, abs=4.0)
    kept = frame.copy()
    for _ in range(60):
        env.step(ACTIONS)
    assert center_of(env.render(), UAV[0])[1] > uav[1] + 5.0
    assert (frame == kept).all()


def test_several_and_unbounded_vehicles_are_drawn():
    free = {"max_speed": float("inf"), "max_acceleration": float("inf")}
    uavs, ugvs = ((10.0, 10.0), free | {"position": (20.0, 10.0)}), ((10.0, 11.0), (20.0, 11.0))
    many = pairs(uavs, ugvs, law=Law(parameters={"reference_speed": 0.5}))
    frame = started_env(many).render()
    assert all(len(pixels_of(frame, color)) > 20 for color in (*UAV[:2], *UGV[:2]))


def test_without_a_mode_render_warns_and_draws_nothing():
    env = parallel_env(SCENARIO)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None


# -- vector and single environments


def in_parallel(scenario, seed, actions, agent="uav_0"):
    """Return the picture of the same run in the parallel environment."""
    env = parallel_env(scenario, render_mode="rgb_array")
    policies = pilots(env)
    seen, _ = env.reset(seed=seed)
    for action in actions:
        others = {one: policies[one](seen[one]) for one in env.agents if one != agent}
        seen, *_ = env.step(others | {agent: action})
    return env.render()


ACTIONS_OF_UAV = np.random.default_rng(0).uniform(-0.3, 0.3, (40, 2))


def test_single_environment_draws_the_same_picture():
    env = single_env(SCENARIO, render_mode="rgb_array")
    env.reset(seed=6)
    for action in ACTIONS_OF_UAV:
        env.step(action)
    assert (env.render() == in_parallel(SCENARIO, 6, ACTIONS_OF_UAV)).all()


@pytest.mark.parametrize("make", [vector_env, parallel_vector_env])
def test_vector_environments_draw_the_same_pictures(make):
    agents = {"agents": ["uav_0"]} if make is parallel_vector_env else {}
    env = make(SCENARIO, num_envs=2, render_mode="rgb_array", **agents)
    env.reset(seed=6)
    env.reset(options={"reset_mask": np.array([True, False])}, seed=[8, None])
    for action in np.repeat(ACTIONS_OF_UAV[:, None], 2, axis=1):
        env.step({"uav_0": action} if agents else action)
    for picture, seed in zip(env.render(), (8, 7), strict=True):
        assert (picture == in_parallel(SCENARIO, seed, ACTIONS_OF_UAV)).all()


def test_after_an_end_a_world_shows_the_new_episode():
    env = vector_env(SCENARIO, num_envs=2, duration=0.5, render_mode="rgb_array")
    env.reset(seed=1)
    for _ in range(13):
        env.step(np.full((2, 2), 0.3))
        env.render()
    short = msgspec.structs.replace(SCENARIO, duration=0.5)
    for picture, seed in zip(env.render(), env.worlds.episode_seeds, strict=True):
        assert (picture == in_parallel(short, seed, [[0.3, 0.3]] * 3)).all()


def test_worlds_with_hazards_of_their_own_show_them():
    env = parallel_vector_env("minefield", num_envs=2, duration=5.0, render_mode="rgb_array")
    env.reset(seed=2)
    first, other = env.render()
    assert (first != other).any()
    again = parallel_vector_env("minefield", num_envs=1, duration=5.0, render_mode="rgb_array")
    again.reset(seed=3)
    assert (again.render()[0] == other).all()


def test_gymnasium_collects_a_list_of_pictures():
    env = gymnasium.make(ESCORT, render_mode="rgb_array_list", duration=1.0)
    env.reset(seed=1)
    env.step(np.zeros(2))
    assert [frame.ndim for frame in env.render()] == [3, 3]


# -- the window


@pytest.fixture
def display(monkeypatch):
    """Provide a dummy display."""
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def test_window_shows_the_same_picture(display):
    import pygame  # noqa: PLC0415 - an extra

    human = parallel_env(SCENARIO, render_mode="human")
    plain = parallel_env(SCENARIO, render_mode="rgb_array")
    for env in (human, plain):
        env.reset(seed=0)
        env.step(ACTIONS)
    assert human.render() is None
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    assert (shown == plain.render()).all()
    for _ in range(2):
        human.close()
    assert not pygame.display.get_init()
    human.reset(seed=0)  # opens another one
    assert pygame.display.get_init()
    human.close()


def test_closed_window_stays_closed_and_the_flight_continues(display):
    import pygame  # noqa: PLC0415 - an extra

    env = parallel_env(SCENARIO, render_mode="human")
    env.reset(seed=0)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(3):
        env.step(ACTIONS)
    assert not pygame.display.get_init()
    assert env.world.tick == 3
    env.close()


def test_missing_pygame_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with refused(OutriderError, r"\[window\]"):
        Window("", 20.0)


@pytest.mark.parametrize("driver", ["offscreen", "no_such_driver"])
def test_missing_display_is_one_line(monkeypatch, driver):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", driver)
    env = parallel_env(SCENARIO, render_mode="human")
    with refused(OutriderError, "display"):
        env.reset(seed=0)
