"""Settings of the environments, each given by keyword."""

from collections.abc import Callable, Mapping
from types import UnionType
from typing import (
    Any,
    Literal,
    TypedDict,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

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


def completed(kind: type[Settings], given: Settings, defaults: Settings) -> Settings:
    """The settings that are given, and of the rest the defaults.

    Raises:
        TypeError: If something of another name or type is given.
    """
    types = get_type_hints(kind)
    for name, value in given.items():
        if name not in defaults:
            raise TypeError(f"{name!r}: no such setting; allowed: {', '.join(sorted(defaults))}")
        if not _is_of(value, types[name]):
            given_type = type(value).__name__  # and not the value, which may be a secret
            raise TypeError(f"{name}: is of type {given_type}; allowed: {_in_words(types[name])}")
    return cast("Settings", {**defaults, **given})


def _is_of(value: object, kind: Any) -> bool:  # noqa: ANN401 - a type as an annotation tells it
    """True if a value is of this type; what is within a mapping or a function is not looked at."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return any(_is_of(value, one) for one in arguments)
    if origin is Literal:  # one of those that are named: checked where it is used
        return True
    if origin is tuple:
        return (
            isinstance(value, (tuple, list))
            and len(value) == len(arguments)
            and all(map(_is_of, value, arguments))
        )
    if origin is type:  # whatever numpy takes for one
        return isinstance(value, (type, str, np.dtype))
    if kind is bool:
        return isinstance(value, (bool, np.bool_))
    if kind in (int, float):  # which of them it must be is checked where it is used
        return isinstance(value, (int, float, np.number))
    return callable(value) if origin is Callable else isinstance(value, origin or kind)


def _in_words(kind: Any) -> str:  # noqa: ANN401 - likewise
    """A type as one would write it."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return " or ".join(_in_words(one) for one in arguments)
    if origin is Callable:
        return "a function"
    if origin is None:
        return "None" if kind is type(None) else str(kind.__name__)
    return f"{origin.__name__}[{', '.join(_in_words(one) for one in arguments)}]"
