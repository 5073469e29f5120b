"""Settings of the environments, each given by keyword."""

from collections.abc import Mapping
from typing import TypedDict, TypeVar, cast

import numpy as np

from sim.env.patch import TILE_PATCH, CoveragePatch
from sim.env.rewards import RewardWeights


class EpisodeSettings(TypedDict, total=False):
    """Settings of an episode, whoever steps it; by default `EPISODE_DEFAULTS`."""

    rewards: RewardWeights | None
    """Weights of what the vehicles are paid for; None: `RewardWeights()`."""
    end_on_sight_lost: bool
    """True: an episode terminates when a UAV is r_v or more from its UGV: the promise is broken."""
    end_on_goals_reached: bool
    """True: it terminates when every UGV that has goals has reached them all."""
    coverage_patch: CoveragePatch | tuple[int, float] | None
    """Pixels and meters per pixel of a picture of the UAV's own map, which makes its observation a dictionary with
    `row` and `coverage`; None: no picture."""
    secret: str
    """Of all random numbers, with each episode's seed: 32 to 128 hexadecimal digits; empty: none, and who
    sees what is drawn finds the seed."""


class EnvSettings(EpisodeSettings, total=False):
    """Settings of every environment; by default `ENV_DEFAULTS`."""

    duration: float | None
    """Length of an episode [s], instead of the scenario's: then the episode is truncated."""
    tile_patch: int
    """Tiles on each side of a UGV's picture of the ground, an odd number; nothing without hazards."""
    dtype: type[np.floating]
    """Of observations and state. With float64 the paper's pilots fly the same bits as in
    `outrider.run`."""


EPISODE_DEFAULTS = EpisodeSettings(
    rewards=None,
    end_on_sight_lost=True,
    end_on_goals_reached=False,
    coverage_patch=None,
    secret="",
)
ENV_DEFAULTS = EnvSettings(
    **EPISODE_DEFAULTS, duration=None, tile_patch=TILE_PATCH, dtype=np.float64
)

Settings = TypeVar("Settings", bound=Mapping[str, object])


def completed(given: Settings, defaults: Settings) -> Settings:
    """The settings that are given, and of the rest the defaults.

    Raises:
        TypeError: If something of another name is given, as where a function lists its arguments.
    """
    for name in given:
        if name not in defaults:
            raise TypeError(f"{name!r}: no such setting; allowed: {', '.join(sorted(defaults))}")
    return cast("Settings", {**defaults, **given})
