"""A run described: typed, read from TOML, refused where it is impossible."""

import math
import re
import tomllib
from collections.abc import Sequence
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import msgspec
from msgspec import Meta

from bus.errors import ScenarioError
from bus.messages import Area, Estimator, Law, Name, NonNegative, Positive, Region, Sensor, Text, Vector

Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Bound = Annotated[float, Meta(gt=0.0)]
"""A bound that may be infinite (TOML: inf)."""


class _Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of the scenario's tables."""


class Visibility(_Table, frozen=True, kw_only=True):
    """The constraint (5)."""

    radius: Positive = 4.75
    """r_v [m]."""


class Coverage(_Table, frozen=True, kw_only=True):
    """What is to be seen, and what has been already."""

    desired: Positive = 2.0
    """C* of (4)."""
    covered: tuple[Region, ...] = ()
    """Rectangles that are covered from the start."""


class Detections(_Table, frozen=True, kw_only=True):
    """The UAV's detector of the UGV: certain inside r_v, falling to nothing at the sensor's range."""

    noise: NonNegative = 0.0
    """Standard deviation per axis [m]."""
    cut: Annotated[float, Meta(ge=0.0)] = 3.0
    """The noise vector's norm is cut at this many standard deviations; 0 switches the cut off."""
    rate: Positive = 20.0
    """Looks per second [1/s]; a whole number of ticks must fit between two."""
    dropout: Share = 0.0
    """Share of looks that fail for no reason."""


class Uav(_Table, frozen=True, kw_only=True):
    """A UAV at the start."""

    name: Name = "uav_0"
    escorts: Name = "ugv_0"
    position: Vector
    velocity: Vector = (0.0, 0.0)
    max_speed: Bound = 0.6
    max_acceleration: Bound = 0.3


class Ugv(_Table, frozen=True, kw_only=True):
    """A UGV at the start, and its task."""

    name: Name = "ugv_0"
    position: Vector
    velocity: Vector = (0.0, 0.0)
    max_speed: Bound = 0.2
    max_acceleration: Bound = 0.1
    driver: Name = "waypoints"
    goals: tuple[Vector, ...] = ()
    goal_tolerance: Positive = 0.05


class Custom(_Table, frozen=True, kw_only=True):
    """Functions of the user's own, as `module:function`; they are loaded by the UAV's process alone and never travel."""

    weighting: Text = ""
    """(distance, r_s) -> (alpha, beta), for the law `weighted`."""
    path: Text = ""
    """t -> ((x, y), (x'', y'')), relative to the UGV, for the law `path`."""


class Scenario(_Table, frozen=True, kw_only=True):
    """One run. SI units; the area's lower left corner is the origin."""

    name: Text = ""
    """The file's name without its ending, where none is given."""
    title: Text = ""
    seed: Annotated[int, Meta(ge=0, le=2**53 - 1)] = 0
    duration: Positive = 160.0
    """[s], a whole number of ticks."""
    dt: Positive = 0.05
    """Length of a tick [s]."""
    hold: NonNegative = 0.5
    """How long the last command is held when none comes [s]; then the vehicle brakes."""
    area: Area = Area(width=40.0, height=40.0, cell=0.25)
    sensor: Sensor = Sensor()
    visibility: Visibility = Visibility()
    coverage: Coverage = Coverage()
    detections: Detections = Detections()
    estimator: Estimator = Estimator()
    law: Law = Law()
    custom: Custom = Custom()
    uav: Annotated[tuple[Uav, ...], Meta(min_length=1)]
    ugv: Annotated[tuple[Ugv, ...], Meta(min_length=1)]

    @property
    def ticks(self) -> int:
        """Number of ticks of the whole run."""
        return round(self.duration / self.dt)

    @property
    def vehicles(self) -> tuple[Uav | Ugv, ...]:
        """All vehicles in name order, which is the order of every array."""
        return tuple(sorted((*self.uav, *self.ugv), key=lambda vehicle: vehicle.name))

    @property
    def detection_period(self) -> int:
        """Ticks between two looks of the detector."""
        return max(1, round(1.0 / (self.detections.rate * self.dt)))

    @property
    def noise_cut(self) -> float:
        """The cut of the detection noise in standard deviations; infinite where it is switched off."""
        return self.detections.cut or math.inf


DEFAULT_SCENARIO = "escort"
_SHIPPED = files("sim") / "scenarios"


def scenario_names() -> tuple[str, ...]:
    """Names of the shipped scenarios, the default first."""
    names = sorted(entry.name.removesuffix(".toml") for entry in _SHIPPED.iterdir() if entry.name.endswith(".toml"))
    return tuple(sorted(names, key=lambda name: name != DEFAULT_SCENARIO))


def _text(source: str | Path) -> tuple[str, str]:
    """The scenario's name and its TOML text."""
    shipped = scenario_names()
    if isinstance(source, str) and source in shipped:
        return source, (_SHIPPED / f"{source}.toml").read_text(encoding="utf-8")
    path = Path(source)
    if path.suffix != ".toml" and not path.exists():
        near = get_close_matches(str(source), shipped, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ScenarioError(
            f"no scenario {str(source)!r}; {hint}shipped are {', '.join(shipped)}; a file of your own ends in .toml"
        )
    try:
        return path.stem, path.read_text(encoding="utf-8")
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: is not text in UTF-8 ({error.reason} at byte {error.start})") from error


def _step_into(table: object, part: str, override: str) -> object:
    """One step along an override's key, making tables on the way."""
    if isinstance(table, list):
        if not part.isdigit() or int(part) >= len(table):
            raise ScenarioError(f"--set {override}: {part!r} is no entry of a list of {len(table)}; they count from 0")
        return table[int(part)]
    if not isinstance(table, dict):
        raise ScenarioError(f"--set {override}: {part!r} is no table")
    return table.setdefault(part, {})


def _override(raw: dict[str, Any], override: str) -> None:
    key, separator, text = override.partition("=")
    parts = key.strip().split(".")
    if not separator or not all(parts):
        raise ScenarioError(f"--set {override}: allowed is KEY=VALUE, such as detections.noise=0.2 or uav.0.max_speed=0.5")
    try:
        value = tomllib.loads(f"value = {text.strip()}")["value"]
    except (tomllib.TOMLDecodeError, KeyError):
        value = text.strip()
    table: object = raw
    for part in parts[:-1]:
        table = _step_into(table, part, override)
    if isinstance(table, list):
        _step_into(table, parts[-1], override)
        table[int(parts[-1])] = value
    elif isinstance(table, dict):
        table[parts[-1]] = value
    else:
        raise ScenarioError(f"--set {override}: {'.'.join(parts[:-1])} is no table")


def _value_at(raw: object, path: list[str]) -> object:
    for part in path:
        raw = raw[int(part)] if isinstance(raw, list) else raw[part]  # type: ignore[index]
    return raw


def _translate(error: msgspec.ValidationError, raw: object) -> str:
    """A validation error as `field = value: what is wrong`."""
    text, _, where = str(error).partition(" - at `$")
    path = [part for part in re.split(r"[.\[\]`]+", where) if part]
    unknown = re.search(r"unknown field `(.*)`", text)
    if unknown:
        allowed = _allowed_fields(path)
        near = get_close_matches(unknown.group(1), allowed, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        return f"{'.'.join([*path, unknown.group(1)])}: unknown field; {hint}allowed: {', '.join(allowed)}"
    if not path:
        return text
    try:
        value = f" = {_value_at(raw, path)!r}"
    except (KeyError, IndexError, TypeError, ValueError):
        value = ""
    return f"{'.'.join(path)}{value}: {text[0].lower()}{text[1:]}"


def _allowed_fields(path: list[str]) -> list[str]:
    kind: Any = Scenario
    for part in path:
        if part.isdigit():
            continue
        kind = get_type_hints(kind)[part]
        if get_args(kind):
            kind = get_args(kind)[0]
    return list(kind.__struct_fields__)


def load_scenario(source: str | Path = DEFAULT_SCENARIO, *, overrides: Sequence[str] = ()) -> Scenario:
    """Read and validate a scenario.

    Args:
        source: A shipped name, or a TOML file.
        overrides: Changes as `key=value`, such as `uav.0.max_speed=0.5`; the value as TOML writes it, or plain text.

    Raises:
        ScenarioError: If it cannot be read or cannot be flown: one line with file, field, value and what is allowed.
    """
    from sim.scenario_checks import check_scenario  # noqa: PLC0415 - the checks need the types of this file

    name, text = _text(source)
    try:
        raw: dict[str, Any] = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ScenarioError(f"{source}: no valid TOML: {error}") from error
    for override in overrides:
        _override(raw, override)
    try:
        scenario = msgspec.convert(raw, Scenario)
    except msgspec.ValidationError as error:
        raise ScenarioError(f"{source}: {_translate(error, raw)}") from error
    if not scenario.name:
        scenario = msgspec.structs.replace(scenario, name=name)
    return check_scenario(scenario, source=str(source))
