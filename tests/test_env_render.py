"""The environment's pictures, and the window."""

import sys

import numpy as np
import pytest
from flights import pairs
from matplotlib.colors import to_rgb
from processes import python
from refusals import refused

from bus.errors import OutriderError
from bus.messages import Area, Law
from sim.env.parallel import parallel_env
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
    """Where the picture has this color, as rows and columns."""
    return np.argwhere(
        (np.abs(frame.astype(int) - np.array(to_rgb(color)) * 255.0) < 3.0).all(axis=2)
    )


def test_the_environment_loads_nothing_that_draws():
    code = (
        "import sys, sim.env.parallel, outrider.envs.env_pilots;"
        "print([m for m in ('matplotlib', 'pygame') if m in sys.modules])"
    )
    assert python(code).stdout.strip() == "[]"


def begun(scenario=SCENARIO):
    env = parallel_env(scenario, render_mode="rgb_array")
    env.reset(seed=0)
    return env


def test_picture_shows_both_vehicles_and_the_limit_where_they_are_in_the_areas_proportion():
    frame = begun().render()
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
    env = begun()
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


def test_picture_depends_on_the_episode_alone_not_on_earlier_pictures():
    def picture(env):
        env.reset(seed=0)
        for _ in range(5):
            env.step(ACTIONS)
        return env.render()

    env = begun()
    for _ in range(100):
        env.step(ACTIONS)
    env.render()
    assert (picture(env) == picture(begun())).all()


def test_several_and_unbounded_vehicles_are_drawn():
    free = {"max_speed": float("inf"), "max_acceleration": float("inf")}
    uavs, ugvs = ((10.0, 10.0), free | {"position": (20.0, 10.0)}), ((10.0, 11.0), (20.0, 11.0))
    many = pairs(uavs, ugvs, law=Law(reference_speed=0.5))
    frame = begun(many).render()
    assert all(len(pixels_of(frame, color)) > 20 for color in (*UAV[:2], *UGV[:2]))


def test_without_a_mode_render_warns_and_draws_nothing():
    env = parallel_env(SCENARIO)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None


# -- the window


@pytest.fixture
def display(monkeypatch):
    """A display that nobody sees."""
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
    human.reset(seed=0)  # opens another
    assert pygame.display.get_init()
    human.close()


def test_a_window_that_a_person_closes_stays_closed_and_the_flight_goes_on(display):
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
