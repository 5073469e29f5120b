"""Gymnasium's wrappers around the environment of one vehicle, whose observations are bounded."""

import math
from typing import Any

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.wrappers import (
    AddRenderObservation,
    FlattenObservation,
    FrameStackObservation,
    NormalizeObservation,
    RecordVideo,
    RescaleAction,
    RescaleObservation,
)

import outrider
from agents.drivers.policy import UgvRows
from bus.messages.vehicle import UgvObservation
from outrider.envs.parallel import parallel_env
from outrider.envs.vector import OutriderVectorEnv, vector_env
from sim.scenario.loading import load_scenario
from sim.scenario.types import Detections, Scenario, Ugv
from worlds import FREE, ONE

NOISY = msgspec.structs.replace(ONE, detections=Detections(noise=30.0, truncation=math.inf))
"""Detections with unbounded noise as large as the area."""
FAST = msgspec.structs.replace(
    FREE,
    detections=Detections(noise=30.0, truncation=math.inf),
    ugv=(Ugv(position=(10.0, 10.0), max_speed=2000.0, max_acceleration=1e6),),
)
"""The UAV has no limits, and the UGV crosses the area in less than a tick."""
SETTINGS: dict[str, tuple[str | Scenario, dict[str, Any]]] = {
    "row": ("escort", {}),
    "ugv": ("escort", {"agent": "ugv_0"}),
    "estimate": (FREE, {"estimate": True, "gradient": True, "dtype": np.float32}),
    "coverage": ("escort", {"estimate": True, "coverage_patch": (6, 1.0)}),
    "tiles": (load_scenario("minefield"), {"agent": "ugv_0", "tile_patch": 5}),
}


def single(name: str, **more: Any) -> gymnasium.Env[Any, Any]:
    """Return an environment with one learning vehicle."""
    scenario, settings = SETTINGS[name]
    return outrider.single_env(scenario, duration=2.0, end_on_sight_lost=False, **settings, **more)


def flown(env: Any, seed: int = 1, push: float = 0.2) -> list[Any]:
    """Return the observations of an episode, and check that all are inside the space."""
    seen, _ = env.reset(seed=seed)
    kept, over = [seen], False
    while not over:
        seen, _, terminated, truncated, _ = env.step(np.full(2, push))
        over = terminated or truncated
        assert env.observation_space.contains(seen)
        kept.append(seen)
    return kept


# -- every observation is bounded


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("scenario", [NOISY, FAST], ids=["noise", "speed"])
def test_observations_and_state_are_bounded_and_inside(scenario: Scenario, dtype: Any) -> None:
    env = parallel_env(scenario, duration=2.0, end_on_sight_lost=False, dtype=dtype)
    observations, _ = env.reset(seed=1)
    at_bound = 0
    while env.agents:
        for name, row in observations.items():
            space = env.observation_space(name)
            assert space.is_bounded()
            assert space.contains(row)
        largest = env.observation_space("uav_0").high[6]
        at_bound += int((np.abs(observations["uav_0"][6:8]) == largest).sum())
        assert env.state_space.is_bounded()
        assert env.state_space.contains(env.state())
        observations, *_ = env.step(dict.fromkeys(env.agents, np.array([1e6, -1e6])))
    assert at_bound > 0


@pytest.mark.parametrize("settings", [{}, {"estimate": True, "gradient": True}])
def test_the_worlds_of_a_batch_are_bounded_too(settings: dict[str, Any]) -> None:
    env: OutriderVectorEnv = vector_env(
        FAST, num_envs=3, duration=2.0, end_on_sight_lost=False, **settings
    )
    assert env.single_observation_space.is_bounded()
    env.reset(seed=1)
    for _ in range(39):
        seen, *_ = env.step(np.full((3, 2), 1e6))
        assert env.observation_space.contains(seen)
    env.close()


def test_the_detections_themselves_are_not_clipped() -> None:
    env = parallel_env(NOISY, duration=2.0, end_on_sight_lost=False)
    rows, _ = env.reset(seed=1)
    largest, beyond = env.observation_space("uav_0").high[6], 0
    while env.agents:
        for one in env.world.received(0):
            np.testing.assert_array_equal(
                rows["uav_0"][6:8], np.clip(one.relative_position, -largest, largest)
            )
            beyond += int(np.abs(one.relative_position).max() > largest)
        rows, *_ = env.step(dict.fromkeys(env.agents, np.zeros(2)))
    assert beyond > 0


def test_a_ugvs_policy_over_the_bus_has_the_same_bounds() -> None:
    env = parallel_env(FAST, duration=1.0, end_on_sight_lost=False)
    env.reset(seed=1)
    rows, *_ = env.step(dict.fromkeys(env.agents, np.array([1e6, 1e6])))
    own = UgvRows(env.briefing("ugv_0"))
    position, velocity = (
        tuple(one[1].tolist()) for one in (env.world.position, env.world.velocity)
    )
    observation = UgvObservation(tick=1, time=0.05, position=position, velocity=velocity)
    np.testing.assert_array_equal(own.row(observation), rows["ugv_0"])


# -- Gymnasium's wrappers


@pytest.mark.parametrize("name", SETTINGS)
def test_rescaled_observations_fill_the_unit_box(name: str) -> None:
    plain, env = (FlattenObservation(single(name)) for _ in range(2))
    box: Any = plain.observation_space
    one = box.dtype.type(1.0)
    rescaled = RescaleObservation(env, -one, one)
    for raw, seen in zip(flown(plain), flown(rescaled), strict=True):
        wanted = 2.0 * (raw.astype(np.float64) - box.low) / (box.high - box.low) - 1.0
        np.testing.assert_allclose(seen, wanted, atol=1e-6)


@pytest.mark.parametrize("name", SETTINGS)
def test_stacked_observations_are_the_last_ones(name: str) -> None:
    plain, env = flown(single(name)), FrameStackObservation(single(name), 3)
    for k, seen in enumerate(flown(env)):
        for part in seen if isinstance(seen, dict) else [None]:
            last = [plain[max(k - back, 0)] for back in (2, 1, 0)]
            rows = [one if part is None else one[part] for one in last]
            np.testing.assert_array_equal(seen if part is None else seen[part], np.stack(rows))


def test_wrappers_can_be_put_around_each_other() -> None:
    env = RescaleAction(single("coverage"), np.float64(-1.0), np.float64(1.0))
    env = RescaleObservation(FlattenObservation(env), np.float64(-1.0), np.float64(1.0))
    env = FrameStackObservation(env, 4)
    assert env.observation_space.shape == (4, 9 + 36)
    assert len(flown(env, push=1.0)) == 41


def test_observations_are_standardized() -> None:
    env = NormalizeObservation(single("row"))
    rows = np.array(flown(env))
    assert np.isfinite(rows).all()
    assert np.abs(rows[5:, 6:8]).max() < 10.0


def test_pictures_are_an_observation() -> None:
    env = AddRenderObservation(single("row", render_mode="rgb_array"))
    seen = flown(env)
    assert (seen[0] != seen[-1]).any()


def test_flights_are_recorded(tmp_path: Any) -> None:
    pytest.importorskip("moviepy")
    env = RecordVideo(single("row", render_mode="rgb_array"), str(tmp_path))
    flown(env)
    env.close()
    assert len(list(tmp_path.glob("*.mp4"))) == 1
