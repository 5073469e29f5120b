"""Settings of the environments, given by keyword."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sim.engine.run_keys import check_secret
from sim.env.patch import TILE_PATCH, CoveragePatch, check_tile_patch, given_patch
from sim.env.reward_function import RewardFunction
from sim.env.rewards import RewardWeights
from sim.env.spaces import check_dtype, check_omit

BatchPolicy = Callable[[Any], npt.ArrayLike]
"""Function from the observations of one vehicle in all worlds to its accelerations [m/s²], shape (num_envs, 2)."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of every environment, with one world or many.

    Raises:
        ValueError: If a value is not allowed.
        TypeError: If a value has a wrong type.
    """

    duration: float | None = None
    """Duration of an episode [s], after which it is truncated; None: the scenario's."""
    rewards: RewardWeights = field(default_factory=RewardWeights)
    """Weights of the reward terms."""
    reward_function: RewardFunction | None = None
    """Function from `metrics()`, with arrays of shape (worlds,), to the rewards by vehicle; a vehicle left out receives
    its weighted terms. None: all do.
    """
    end_on_sight_lost: bool = True
    """True: an episode terminates when a UAV loses sight of its UGV; in a team, when all its UAVs have."""
    end_on_goals_reached: bool = False
    """True: an episode terminates when every UGV with goals has reached all of them."""
    coverage_patch: CoveragePatch | tuple[int, float] | Mapping[str, Any] | None = None
    """Pixels, and metres per pixel, of a picture of the UAV's own map; its observation is then a dictionary with `row`
    and `coverage`. None: no picture.

    This setting, `dtype`, `estimate`, `gradient` and `omit` may be mappings by vehicle; a missing vehicle has the
    default. All pictures have the same size.
    """
    tile_patch: int = TILE_PATCH
    """Tiles per side of a UGV's picture of the ground, an odd number; no effect without hazards."""
    dtype: type[np.floating] | Mapping[str, Any] = np.float64
    """Type of observations and state."""
    secret: str = ""
    """Secret of all random numbers, combined with each episode's seed: 32 to 128 hexadecimal digits. Empty: none, and
    the seed can be found from the random numbers.
    """
    estimate: bool | Mapping[str, bool] = False
    """True: the UAVs' rows hold the Kalman filter's estimate instead of the raw detection."""
    gradient: bool | Mapping[str, bool] = False
    """True: the UAVs' rows include `bus.observations.GRADIENT` at the end."""
    omit: Sequence[str] | Mapping[str, Sequence[str]] = ()
    """Parts left out of the UAVs' rows: `time`, `position` (x and y), or both."""
    safety_filter: bool = False
    """True: the UAVs' actions pass the safety filter, as in the law `certified`. In a team, their roles decide."""
    roles: Literal["rules", "action"] = "rules"
    """Roles of a team's UAVs. "rules": as in a run. "action": each action has a last entry: from 0.5 on it asks its UAV
    to guard, up to -0.5 it asks for relief, as an operator does; the rules decide what is safe.
    """
    others: Mapping[str, str | BatchPolicy] | None = None
    """Control of the other vehicles: a law, driver or saved policy by name, such as `npz:FILE.npz`, or a policy for all
    worlds; None: the scenario's law and drivers.
    """
    randomize: Mapping[str, Sequence[float]] | None = None
    """Smallest and largest value of scenario fields, such as `{"uav.*.max_speed": [0.4, 0.8]}`, from which each episode
    draws uniformly by its seed; `sim.env.randomization.RANDOMIZED` lists the fields. None: no field is random.
    """
    threads: int | None = None
    """Processor cores for the worlds; None: all that this process may use."""

    def __post_init__(self) -> None:
        for name in _SWITCHES:
            for value in (
                _values(getattr(self, name)) if name in BY_AGENT else [getattr(self, name)]
            ):
                if not isinstance(value, (bool, np.bool_)):
                    raise TypeError(f"{name} = {value!r}; allowed: True, False")
        if not isinstance(self.rewards, RewardWeights):
            raise TypeError(f"rewards = {self.rewards!r}; allowed: RewardWeights(...)")
        if not (self.reward_function is None or callable(self.reward_function)):
            raise TypeError(
                f"reward_function = {self.reward_function!r}; allowed: a function of the metrics, or None"
            )
        if not (self.others is None or isinstance(self.others, Mapping)):
            raise TypeError(f"others = {self.others!r}; allowed: pilots by vehicle, or None")
        if not (self.randomize is None or isinstance(self.randomize, Mapping)):
            raise TypeError(
                f"randomize = {self.randomize!r}; allowed: ranges by field, "
                "such as {'uav.*.max_speed': [0.4, 0.8]}, or None"
            )
        if self.roles not in ("rules", "action"):
            raise ValueError(f"roles = {self.roles!r}; allowed: 'rules', 'action'")
        check_secret(self.secret)
        for dtype in _values(self.dtype):
            check_dtype(dtype)
        for patch in _values(self.coverage_patch):
            given_patch(patch)
        for omit in _values(self.omit):
            check_omit(omit)
        check_tile_patch(self.tile_patch)

    def of_agent(self, name: str) -> "Settings":
        """Return the settings of one vehicle, without mappings by vehicle."""
        own = {
            key: given.get(name, default)
            for key, default in BY_AGENT.items()
            if isinstance(given := getattr(self, key), Mapping)
        }
        return replace(self, **own) if own else self

    def of_loop(self, uavs: Iterable[str]) -> "Settings":
        """Return the settings of the closed loop, which serves all vehicles.

        The estimate is in the loop's rows only if all UAVs observe it; the estimator runs if any does.

        Raises:
            ValueError: If two pictures differ in size.
        """
        if not any(isinstance(getattr(self, key), Mapping) for key in BY_AGENT):
            return self
        each = [self.of_agent(name) for name in uavs]
        patches = {given_patch(one.coverage_patch) for one in each} - {None}
        if len(patches) > 1:
            sizes = ", ".join(str(tuple(patch)) for patch in patches if patch)
            raise ValueError(
                f"coverage_patch: {sizes}; allowed: the same for all vehicles, or None"
            )
        estimate = bool(each) and all(one.estimate for one in each)
        gradient = any(one.gradient or bool(one.estimate) != estimate for one in each)
        patch = next(iter(patches), None)
        return replace(
            self, estimate=estimate, gradient=gradient, coverage_patch=patch, dtype=np.float64
        )

    def check_agents(self, names: Sequence[str]) -> None:
        """Check that mappings by vehicle name these vehicles only.

        Raises:
            ValueError: If one names another.
        """
        for key in BY_AGENT:
            given = getattr(self, key)
            for name in given if isinstance(given, Mapping) else ():
                if name not in names:
                    raise ValueError(
                        f"{key}: {name!r}: no such vehicle; allowed: {', '.join(names)}"
                    )


BY_AGENT: Mapping[str, Any] = {
    "estimate": False,
    "gradient": False,
    "omit": (),
    "coverage_patch": None,
    "dtype": np.float64,
}
"""Settings of an observation, which may be mappings by vehicle, with their defaults."""
_SWITCHES = [one.name for one in fields(Settings) if isinstance(one.default, bool)]


def _values(given: object) -> list[Any]:
    """Return the values of a setting: of all vehicles, or one for all."""
    return list(given.values()) if isinstance(given, Mapping) else [given]


def settings_of(given: Mapping[str, Any]) -> Settings:
    """Return the settings with given values, and defaults for the rest.

    Raises:
        TypeError: If a setting is unknown, or a value has a wrong type.
        ValueError: If a value is not allowed.
    """
    names = [one.name for one in fields(Settings)]
    for name in given:
        if name not in names:
            close = get_close_matches(name, names, 1)
            meant = f" (did you mean {close[0]!r}?)" if close else ""
            if name == "num_envs":
                meant = " (for many worlds: outrider.vector_env, outrider.parallel_vector_env)"
            raise TypeError(
                f"{name!r}: unknown setting{meant}; allowed: {', '.join(sorted(names))}"
            )
    return Settings(**given)
