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
from sim.scenario.types import Scenario, Uav, Ugv
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


def test_picture_shows_vehicles_and_limit_in_proportion():
    frame = started_env().render()
    assert frame.dtype == np.uint8
    assert frame.ndim == 3
    assert frame.shape[2] == 3
    assert frame.shape[1] > 1.5 * frame.shape[0]
    legend = int(0.9 * frame.shape[0])
    (a_row, a_column), (g_row, g_column) = (
        np.median(pixels_of(frame[:legend], color), axis=0) for color in (UAV[0], UGV[0])
    )
    assert a_row == pytest.approx(g_row, abs=3.0)
    assert a_column - g_column == pytest.approx(2.0 * 800 / 40, abs=8.0)
    ring = pixels_of(frame[:legend], LIMIT)
    assert np.ptp(ring[:, 1]) == pytest.approx(2.0 * 4.75 * 800 / 40, abs=4.0)


def test_pictures_follow_the_flight_and_are_not_overwritten():
    env = started_env()
    first = env.render()
    kept = first.copy()
    for _ in range(60):
        env.step(ACTIONS)
    later = env.render()
    assert (first == kept).all()
    assert (first != later).any()
    columns = [
        np.median(pixels_of(frame[: int(0.9 * len(frame))], UAV[0])[:, 1])
        for frame in (first, later)
    ]
    assert columns[1] > columns[0] + 5.0


def test_picture_depends_on_the_episode_alone():
    def picture(env):
        env.reset(seed=0)
        for _ in range(5):
            env.step(ACTIONS)
        return env.render()

    env = started_env()
    for _ in range(100):
        env.step(ACTIONS)
    env.render()
    assert (picture(env) == picture(started_env())).all()


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


@pytest.mark.parametrize("kind", ["single", "vector", "parallel vector"])
def test_the_same_flight_is_the_same_picture(kind):
    scenario = msgspec.structs.replace(SCENARIO, duration=3.0)
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (40, 2))
    if kind == "single":
        env = single_env(scenario, render_mode="rgb_array")
        env.reset(seed=6)
        [env.step(action) for action in actions]
        assert (env.render() == in_parallel(scenario, 6, actions)).all()
        return
    make = vector_env if kind == "vector" else parallel_vector_env
    agents = {} if kind == "vector" else {"agents": ["uav_0"]}
    env = make(scenario, num_envs=2, render_mode="rgb_array", **agents)
    env.reset(seed=6)
    env.reset(options={"reset_mask": np.array([True, False])}, seed=[8, None])
    for action in np.repeat(actions[:, None], 2, axis=1):
        env.step(action if kind == "vector" else {"uav_0": action})
    pictures = env.render()
    assert [picture.dtype for picture in pictures] == [np.uint8] * 2
    for picture, seed in zip(pictures, (8, 7), strict=True):
        assert (picture == in_parallel(scenario, seed, actions)).all()


def test_after_an_end_a_world_shows_the_new_episode():
    env = vector_env(SCENARIO, num_envs=2, duration=0.5, render_mode="rgb_array")
    env.reset(seed=1)
    for _ in range(13):
        env.step(np.full((2, 2), 0.3))
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


@pytest.mark.parametrize("mode", ["rgb_array", "rgb_array_list"])
def test_gymnasium_makes_what_draws(mode):
    env = gymnasium.make(ESCORT, render_mode=mode, duration=1.0)
    assert env.render_mode == mode
    env.reset(seed=1)
    env.step(np.zeros(2))
    frames = env.render() if mode.endswith("list") else [env.render()]
    assert [frame.ndim for frame in frames] == [3] * len(frames)
    assert env.metadata["render_fps"] == 20


# -- the window


@pytest.fixture
def display(monkeypatch):
    """Provide a dummy display."""
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def test_window_shows_the_same_picture(display):
    import pygame

    human = parallel_env(SCENARIO, render_mode="human")
    plain = parallel_env(SCENARIO, render_mode="rgb_array")
    for env in (human, plain):
        env.reset(seed=0)
        for _ in range(3):
            env.step(ACTIONS)
    assert human.render() is None
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    assert (shown == plain.render()).all()
    human.close()
    human.close()
    assert not pygame.display.get_init()
    human.reset(seed=0)  # opens another one
    assert pygame.display.get_init()
    human.close()


def test_closed_window_stays_closed_and_the_flight_continues(display):
    import pygame

    env = parallel_env(SCENARIO, render_mode="human")
    env.reset(seed=0)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(3):
        env.step(ACTIONS)
    assert not pygame.display.get_init()
    assert env.world.tick == 3
    env.close()


def test_missing_pygame_is_one_line_that_says_what_to_install(monkeypatch):
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
