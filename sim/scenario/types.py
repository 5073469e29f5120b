"""A run described: typed, read from TOML, refused where it is impossible."""

import math
from collections.abc import Mapping, Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.errors import ScenarioError
from bus.files import read_regular
from bus.messages import (
    Area,
    Estimator,
    Law,
    LinkKind,
    LinkSettings,
    Name,
    NonNegative,
    Positive,
    Region,
    ScriptStep,
    Sensor,
    Text,
    Vector,
)
from sim.input.faults import near, one_line
from sim.input.reading import apply_override, as_raw, parse_override, parse_toml, typed
from sim.scenario.checks import check_scenario
from sim.scenario.link_tables import with_profiles
from sim.scenario.tracks import with_tracks

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
    cut: NonNegative = 3.0
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
    script: tuple[ScriptStep, ...] = ()
    """For the driver `script`: what it wants from a time on, in the order of time."""
    track: Text = ""
    """Instead of a script: the trajectory.csv of an earlier run, whose track of this UGV is driven again."""


class Certificate(_Table, frozen=True, kw_only=True):
    """What is declared to the UAVs for the law `certified`.

    A network that is worse is told as uncertified, tick by tick.
    """

    error: NonNegative | None = None
    """Largest error of a detection [m]; by default the noise at its cut, and without a cut none."""
    age: Positive = 1.0
    """Largest age of the newest detection that has arrived [s]."""
    delay: NonNegative | None = None
    """From the tick that a command answers to the one in which it acts [s]; by default the longest of its link."""
    margin: NonNegative = 0.0
    """Taken off r_v [m], for what the theorem does not cover: jitter and loss of commands."""


class Custom(_Table, frozen=True, kw_only=True):
    """Functions of the user's own, as `module:function`.

    Each is loaded by its vehicle's process alone and never travels.
    """

    weighting: Text = ""
    """(distance, r_s) -> (alpha, beta), for the law `weighted`."""
    path: Text = ""
    """t -> ((x, y), (x'', y'')), relative to the UGV, for the law `path`."""
    policy: Text = ""
    """(observation, briefing) -> (acceleration x, y), for the driver `policy`."""


class VehicleLinks(_Table, frozen=True, kw_only=True):
    """The links of one vehicle, where they are not as everybody's."""

    vehicle: Name
    detections: LinkSettings = LinkSettings()
    commands: LinkSettings = LinkSettings()
    operator: LinkSettings = LinkSettings()
    radio: LinkSettings = LinkSettings()


class LinkTable(_Table, frozen=True, kw_only=True):
    """What the ether does to messages, kind by kind.

    In TOML each may name a `profile` that it starts from, and so may all.
    """

    detections: LinkSettings = LinkSettings()
    """From a UAV's detector to its computer."""
    commands: LinkSettings = LinkSettings()
    """From a vehicle's computer to its actuators."""
    operator: LinkSettings = LinkSettings()
    """From an operator to a UGV."""
    radio: LinkSettings = LinkSettings()
    """From a UAV to its UGV."""
    only: tuple[VehicleLinks, ...] = ()
    """Vehicles whose links are other ones; what is not given is as everybody's."""

    def of(self, vehicle: str, kind: LinkKind) -> LinkSettings:
        """What the link of this kind does to this vehicle's messages."""
        own = next((row for row in self.only if row.vehicle == vehicle), self)
        settings: LinkSettings = getattr(own, kind)
        return settings

    def path_of(self, vehicle: str, kind: LinkKind) -> str:
        """Where these settings stand in the scenario, such as `links.commands` or `links.only.0.commands`."""
        own = next((f"only.{k}." for k, row in enumerate(self.only) if row.vehicle == vehicle), "")
        return f"links.{own}{kind}"

    def changed(self, kind: LinkKind, vehicle: str | None, settings: LinkSettings) -> "LinkTable":
        """The table with other settings for one vehicle's link of this kind, or, where none is named, for everybody's."""
        if vehicle is None:
            rows = tuple(msgspec.structs.replace(row, **{kind: settings}) for row in self.only)
            return msgspec.structs.replace(self, only=rows, **{kind: settings})
        kinds = {other: self.of(vehicle, other) for other in LinkKind}
        new = VehicleLinks(vehicle=vehicle, **{**kinds, kind: settings})
        rows = tuple(new if row.vehicle == vehicle else row for row in self.only)
        return msgspec.structs.replace(self, only=rows if new in rows else (*rows, new))


_DEFAULT_AREA = Area(width=40.0, height=40.0, cell=0.25)


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
    area: Area = _DEFAULT_AREA
    sensor: Sensor = Sensor()
    visibility: Visibility = Visibility()
    coverage: Coverage = Coverage()
    detections: Detections = Detections()
    estimator: Estimator = Estimator()
    links: LinkTable = LinkTable()
    certificate: Certificate = Certificate()
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
MOST_BYTES = 1 << 20
"""Of a scenario's or a sweep's file: room for some thousand vehicles."""
FILE_RULE = f"a TOML file of {MOST_BYTES >> 20} MiB at most"


def _shipped() -> dict[str, Traversable]:
    """The shipped scenarios by name."""
    entries = (files("sim.scenario") / "shipped").iterdir()
    return {
        entry.name.removesuffix(".toml"): entry for entry in entries if entry.name.endswith(".toml")
    }


def scenario_names() -> tuple[str, ...]:
    """Names of the shipped scenarios, the default first."""
    return tuple(sorted(_shipped(), key=lambda name: (name != DEFAULT_SCENARIO, name)))


def shipped_text(name: str) -> str:
    """The TOML text of a shipped scenario.

    Raises:
        ScenarioError: If none has this name.
    """
    if name not in _shipped():
        known = scenario_names()
        raise ScenarioError(
            f"{one_line(name)}: no such scenario{near(name, known)}; allowed: {', '.join(known)}"
        )
    return _read(name, name)


def _read(source: str | Path, file: str) -> str:
    """The TOML text of a shipped scenario or of a file."""
    try:
        shipped = _shipped().get(str(source))
        content = (
            shipped.read_bytes() if shipped is not None else read_regular(Path(source), MOST_BYTES)
        )
        return content.decode("utf-8-sig")
    except FileNotFoundError as error:
        known = scenario_names()
        meant = near(Path(source).stem, known)
        raise ScenarioError(
            f"{file}: no such file or scenario{meant}; allowed: a TOML file, or {', '.join(known)}"
        ) from error
    except UnicodeDecodeError as error:
        raise ScenarioError(
            f"{file}: byte {error.start}: not UTF-8, {error.reason}; allowed: text in UTF-8"
        ) from error
    except (OSError, ValueError) as error:  # a ValueError: a NUL in the path
        reason = one_line(str(getattr(error, "strerror", None) or error))
        raise ScenarioError(f"{file}: cannot be read: {reason}; allowed: {FILE_RULE}") from error


def _changes(
    overrides: Mapping[str, object] | Sequence[str], file: str
) -> list[tuple[str, object]]:
    if isinstance(overrides, Mapping):
        return [(str(key), as_raw(value, file=file)) for key, value in overrides.items()]
    changes = [overrides] if isinstance(overrides, str) else overrides
    return [parse_override(change, file=file) for change in changes]


def load_scenario(
    source: str | Path = DEFAULT_SCENARIO, *, overrides: Mapping[str, object] | Sequence[str] = ()
) -> Scenario:
    """Read and validate a scenario.

    Args:
        source: A shipped name, or a TOML file.
        overrides: Changes made before anything is validated: fields and their values, or texts such as
            `uav.0.max_speed=0.5`, the value as TOML writes it or else plain text.

    Returns:
        The scenario; its name is the file's, without its ending, where none is given.

    Raises:
        ScenarioError: If it cannot be read or cannot be flown; one line with file, field, value, what is wrong and
            allowed.
    """
    file = one_line(str(source)) or "."
    raw = parse_toml(_read(source, file), file=file)
    for key, value in _changes(overrides, file):
        apply_override(raw, key, value, file=file)
    if isinstance(raw.get("area"), dict):
        raw["area"] = {**msgspec.to_builtins(_DEFAULT_AREA), **raw["area"]}
    with_profiles(raw, file=file)
    scenario = typed(raw, Scenario, file=file)
    if not scenario.name:
        scenario = msgspec.structs.replace(scenario, name=one_line(Path(source).stem))
    return check_scenario(with_tracks(scenario, file=file), source=file)
