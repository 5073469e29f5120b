"""Settings of the environments, each given by keyword."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from sim.engine.run_keys import check_secret
from sim.env.patch import TILE_PATCH, CoveragePatch, check_tile_patch, given_patch
from sim.env.rewards import RewardWeights
from sim.env.spaces import check_dtype

BatchPolicy = Callable[[Any], npt.ArrayLike]
"""The observations of one vehicle in all worlds in, its accelerations [m/s²] out, shape (num_envs, 2)."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of every environment, of one world or of many.

    Raises:
        ValueError: If a value is not allowed.
        TypeError: If a value is of another type.
    """

    duration: float | None = None
    """Length of an episode [s], instead of the scenario's: then the episode is truncated."""
    rewards: RewardWeights = field(default_factory=RewardWeights)
    """Weights of what the vehicles are paid for."""
    end_on_sight_lost: bool = True
    """True: an episode terminates when a UAV is r_v or more from its UGV: the promise is broken."""
    end_on_goals_reached: bool = False
    """True: it terminates when every UGV that has goals has reached them all."""
    coverage_patch: CoveragePatch | tuple[int, float] | None = None
    """Pixels and meters per pixel of a picture of the UAV's own map, which makes its observation a dictionary with
    `row` and `coverage`; None: no picture."""
    tile_patch: int = TILE_PATCH
    """Tiles on each side of a UGV's picture of the ground, an odd number; nothing without hazards."""
    dtype: type[np.floating] = np.float64
    """Of observations and state."""
    secret: str = ""
    """Of all random numbers, with each episode's seed: 32 to 128 hexadecimal digits; empty: none, and who
    sees what is drawn finds the seed."""
    estimate: bool = False
    """True: the UAVs' rows have the Kalman filter's estimate in the place of the raw detection."""
    gradient: bool = False
    """True: the UAVs' rows end with `bus.observations.GRADIENT`."""
    safety_filter: bool = False
    """True: the UAVs' actions go through the safety filter, as those of the law `certified` do."""
    others: Mapping[str, str | BatchPolicy] | None = None
    """Pilots of the vehicles that do not learn: a law or driver by name, or a policy for all worlds at once;
    None: the scenario's law and drivers."""
    threads: int | None = None
    """Processor cores that share the worlds; None: all that this process may use."""

    def __post_init__(self) -> None:
        for name in _SWITCHES:
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise TypeError(f"{name} = {getattr(self, name)!r}; allowed: True, False")
        if not isinstance(self.rewards, RewardWeights):
            raise TypeError(f"rewards = {self.rewards!r}; allowed: RewardWeights(...)")
        if not (self.others is None or isinstance(self.others, Mapping)):
            raise TypeError(f"others = {self.others!r}; allowed: pilots by vehicle, or None")
        check_secret(self.secret)
        check_dtype(self.dtype)
        given_patch(self.coverage_patch)
        check_tile_patch(self.tile_patch)


_SWITCHES = [one.name for one in fields(Settings) if one.type is bool]


def settings_of(given: Mapping[str, Any]) -> Settings:
    """Return the settings that are given by keyword, and of the rest the defaults.

    Raises:
        TypeError: If there is no setting of such a name, or a value is of another type.
        ValueError: If a value is not allowed.
    """
    names = [one.name for one in fields(Settings)]
    for name in given:
        if name not in names:
            raise TypeError(f"{name!r}: no such setting; allowed: {', '.join(sorted(names))}")
    return Settings(**given)
