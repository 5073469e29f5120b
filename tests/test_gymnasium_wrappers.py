"""Gymnasium's wrappers around the environment of one vehicle, whose observations are bounded."""

from typing import Any

import gymnasium
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
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from worlds import FREE

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


def flown(env: Any, push: float = 0.2) -> list[Any]:
    """Return the observations of an episode, and check that all are inside the space."""
    seen, _ = env.reset(seed=1)
    kept, over = [seen], False
    while not over:
        seen, _, terminated, truncated, _ = env.step(np.full(2, push))
        over = terminated or truncated
        assert env.observation_space.contains(seen)
        kept.append(seen)
    return kept


@pytest.mark.parametrize("name", SETTINGS)
def test_wrappers_can_be_put_around_each_other(name: str) -> None:
    plain, env = (FlattenObservation(single(name)) for _ in range(2))
    box: Any = plain.observation_space
    one = box.dtype.type(1.0)
    rescaled = RescaleObservation(RescaleAction(env, np.float64(-1.0), np.float64(1.0)), -one, one)
    stacked = NormalizeObservation(FrameStackObservation(rescaled, 3))
    assert stacked.observation_space.shape == (3, *box.shape)
    assert np.isfinite(flown(stacked)).all()
    action = 0.2 * plain.action_space.high[0]
    for raw, seen in zip(flown(plain, action), flown(rescaled), strict=True):
        wanted = 2.0 * (raw.astype(np.float64) - box.low) / (box.high - box.low) - 1.0
        np.testing.assert_allclose(seen, wanted, atol=1e-6)


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
