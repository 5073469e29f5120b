"""Ranges of scenario fields, from which each episode of an environment draws its own values."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from bus.messages.links import LinkKind
from sim.compiling.compile import FloatArray
from sim.engine.run_keys import derive_key
from sim.input.faults import near, shown
from sim.models.randomness import RANGES
from sim.scenario.checks import check_scenario
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav, Ugv

_LIMITS = ("max_speed", "max_acceleration")
_FIELDS: Mapping[str, Sequence[str]] = {
    "uav.*": (*_LIMITS, "position_error", "position_error_time"),
    "ugv.*": _LIMITS,
    "detections": ("noise", "dropout"),
    "wind": ("mean.0", "mean.1", "gust", "gust_time", "limit"),
    "certificate": (
        "max_measurement_error",
        "max_measurement_age",
        "max_command_delay",
        "max_command_interval",
        "max_tracking_error",
        "margin",
    ),
} | {
    f"links.{kind}": (
        "delay",
        "jitter",
        "loss",
        "burst_length",
        "burst_interval",
        "burst_loss",
        "blackout_interval",
        "blackout_length",
        "duplicates",
        "reorder",
        "reorder_delay",
    )
    for kind in (LinkKind.DETECTIONS, LinkKind.COMMANDS, LinkKind.RADIO)
}
"""Fields that may differ between worlds, by table. None of them needs less memory at a larger value."""
RANDOMIZED = tuple(f"{table}.{field}" for table, fields in _FIELDS.items() for field in fields)
"""Fields that may be randomized; `*` stands for an index, a name, or all vehicles of a kind."""
MOST_RANGES = 10
"""Maximum number of ranges: every combination of their ends is checked."""

_Path = tuple[str | int, ...]


class Range(NamedTuple):
    """Range of one field, or of the same field of all vehicles of a kind, which then have the same value."""

    key: str
    """Field as the user wrote it."""
    paths: tuple[_Path, ...]
    """Paths of the field in the scenario."""
    low: float
    high: float
    knowing: frozenset[str]
    """Vehicles whose briefing contains the value; the others must not learn it."""


class Randomization:
    """Ranges of an environment's episodes.

    Args:
        scenario: Scenario of the other fields, as `check_scenario` returns it.
        given: Smallest and largest value by field, such as `{"uav.*.max_speed": [0.4, 0.8]}`.

    Raises:
        ScenarioError: If a combination of the ranges' ends makes the scenario invalid.
        ValueError: If a field is unknown or cannot vary, or a range is not allowed.
    """

    def __init__(self, scenario: Scenario, given: Mapping[str, Sequence[float]]) -> None:
        self._scenario = scenario
        self.ranges = tuple(_range_of(scenario, key, value) for key, value in given.items())
        """Ranges in the given order."""
        _check_paths(self.ranges)
        self.keys = tuple(one.key for one in self.ranges)
        """Fields as the user wrote them."""
        for corner in self.corners():
            check_scenario(corner, source=f"randomize: {scenario.name or 'scenario'}")
        self.widest = self._with([one.high for one in self.ranges])
        """Scenario with the largest values, for arrays and spaces."""

    def corners(self) -> Iterator[Scenario]:
        """Yield the scenario with every combination of the ranges' ends."""
        for values in itertools.product(*(dict.fromkeys((r.low, r.high)) for r in self.ranges)):
            yield self._with(values)

    def draw(self, seed: int, secret: str) -> tuple[FloatArray, Scenario]:
        """Return the values of an episode, uniform in the ranges, and its scenario.

        Args:
            seed, secret: Seed and secret of the episode.
        """
        values = [
            min(one.low + (one.high - one.low) * _share(seed, n, secret), one.high)
            for n, one in enumerate(self.ranges)
        ]
        return np.array(values), self._with(values)

    def _with(self, values: Sequence[float]) -> Scenario:
        changed: Any = self._scenario
        for one, value in zip(self.ranges, values, strict=True):
            for path in one.paths:
                changed = _replaced(changed, path, value)
        result: Scenario = changed
        return result

    def known_to(self, vehicle: str) -> list[int]:
        """Return the indices of the ranges whose values a vehicle may know."""
        return [n for n, one in enumerate(self.ranges) if vehicle in one.knowing]


def _share(seed: int, number: int, secret: str) -> float:
    """Return a uniform random number in [0, 1) with 53 bits."""
    return float((int(derive_key(seed, RANGES, number, secret), 16) >> 75) * 2.0**-53)


def _replaced(value: Any, path: _Path, number: float) -> Any:  # noqa: ANN401 - part of a scenario
    """Return a part of a scenario with another number at a path."""
    if not path:
        return number
    first, rest = path[0], path[1:]
    if isinstance(first, int):
        return (*value[:first], _replaced(value[first], rest, number), *value[first + 1 :])
    return msgspec.structs.replace(value, **{first: _replaced(getattr(value, first), rest, number)})


def _range_of(scenario: Scenario, key: object, given: Any) -> Range:  # noqa: ANN401 - a user's value
    """Return a checked range."""
    if not isinstance(key, str):
        raise ValueError(f"randomize: {key!r}: not a field; allowed: {', '.join(RANDOMIZED)}")
    paths, names = _paths_of(scenario, key)
    try:
        low, high = map(float, given)
    except (TypeError, ValueError):
        low = high = math.nan
    where = f"randomize: {key} = {shown(given)}"
    if isinstance(given, str | Mapping) or math.isnan(low) or math.isnan(high):
        raise ValueError(f"{where}: not a range; allowed: two numbers, such as [0.4, 0.8]")
    if math.isinf(low) or math.isinf(high):
        raise ValueError(f"{where}: not finite; allowed: two finite numbers")
    if low > high:
        raise ValueError(f"{where}: reversed; allowed: the smaller number first")
    return Range(key, paths, low, high, _knowing(scenario, key, names))


def _paths_of(scenario: Scenario, key: str) -> tuple[tuple[_Path, ...], list[str]]:
    """Return the paths of a field, and the names of the vehicles that have it; empty: no vehicle's field."""
    table, _, rest = key.partition(".")
    kinds: Mapping[str, Sequence[Uav | Ugv]] = {"uav": scenario.uav, "ugv": scenario.ugv}
    vehicles = kinds.get(table)
    general, names = key, list[str]()
    if vehicles is not None:
        chosen, _, field = rest.partition(".")
        general = f"{table}.*.{field}"
        names = [one.name for one in vehicles]
    if general not in RANDOMIZED:
        wrong = (
            "cannot differ between worlds"
            if _exists(scenario, general.split("."))
            else f"unknown field{near(general, RANDOMIZED)}"
        )
        raise ValueError(f"randomize: {key}: {wrong}; allowed: {', '.join(RANDOMIZED)}")
    if vehicles is None:
        if table == "links" and getattr(scenario.links, key.split(".")[1]).trace:
            raise ValueError(f"randomize: {key}: the link replays a trace; allowed: links without")
        return (tuple(int(part) if part.isdigit() else part for part in key.split(".")),), []
    rows = [k for k, name in enumerate(names) if chosen in ("*", name, str(k))]
    if not rows:
        raise ValueError(
            f"randomize: {key}: no such vehicle; allowed: {table}.*.{field}, or an index or name: {', '.join(names)}"
        )
    return tuple((table, k, field) for k in rows), [names[k] for k in rows]


def _exists(value: Any, parts: Sequence[str]) -> bool:  # noqa: ANN401 - part of a scenario
    """Return whether a scenario has a field; `*` or a number stands for any entry of a list."""
    if not parts:
        return True
    if isinstance(value, tuple):
        return (parts[0] == "*" or parts[0].isdigit()) and any(
            _exists(one, parts[1:]) for one in value
        )
    fields = getattr(value, "__struct_fields__", ())
    return parts[0] in fields and _exists(getattr(value, parts[0]), parts[1:])


def _check_paths(ranges: Sequence[Range]) -> None:
    """Check that there are not too many ranges, and that no two have a field in common."""
    if len(ranges) > MOST_RANGES:
        raise ValueError(
            f"randomize: {len(ranges)} ranges; allowed: up to {MOST_RANGES}, "
            "since every combination of their ends is checked"
        )
    for one, other in itertools.combinations(ranges, 2):
        if set(one.paths) & set(other.paths):
            raise ValueError(
                f"randomize: {other.key}: also in {one.key}; allowed: one range per field"
            )


def _knowing(scenario: Scenario, key: str, names: Sequence[str]) -> frozenset[str]:
    """Return the vehicles whose briefing contains a field: see `sim.engine.briefing`.

    A vehicle knows its own limits, a UAV also the limits of its UGV, the detector's noise and the declared bounds.
    """
    uavs = [uav.name for uav in scenario.uav]
    if key.startswith("certificate.") or key == "detections.noise":
        return frozenset(uavs)
    if not key.endswith(_LIMITS):
        return frozenset()
    return frozenset(names) | {uav.name for uav in scenario.uav if uav.escorts in names}
