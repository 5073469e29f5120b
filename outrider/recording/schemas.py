"""Content of a recording: channels, their JSON schemas, and the head of each flight.

Times are simulated, in nanoseconds since the first tick. A file holds one run. A run that was reset has several
flights in order, each with its own head.
"""

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from bus.errors import ScenarioError
from bus.messages.base import Message, Name, NonNegative, Seed, Text, Tick, Vector
from bus.messages.control import Change
from bus.messages.ground import GroundMap
from bus.messages.team import Role
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.messages.vehicle import Teleoperation
from sim.input.overrides import apply_override
from sim.input.reading import typed
from sim.scenario.checks import check_scenario
from sim.scenario.types import Scenario
from sim.server.recorder import platform_row

FORMAT = 1
"""Version of the file format; other versions cannot be read."""
PROFILE = "outrider"
"""Profile in the MCAP header."""


LATEST = (1 << 31) * 1_000_000_000 - 1
"""Latest time of a recording [ns]: other formats count seconds in 32 bits."""


class Head(Message, frozen=True, kw_only=True):
    """First message of a flight, with scenario, seed and platform."""

    format: int = FORMAT
    outrider: Text
    """Version that wrote the file."""
    episode: Tick = 0
    """Number of the flight in the run."""
    start: NonNegative = 0.0
    """Time of the flight's tick 0 on the file's clock [s]."""
    name: Text
    """Name of the scenario."""
    seed: Seed
    secret: str = ""
    """Secret of the run; empty: none, or unknown to the observer."""
    platform: dict[str, str]
    """Platform, which may affect the last bits of a trajectory."""
    scenario: dict[str, Any] | None = None
    """Complete scenario; None: unknown to the observer."""
    infinite: tuple[str, ...] = ()
    """Infinite fields of the scenario, which are null there, as JSON has no infinite numbers."""


class Commands(Message, frozen=True, kw_only=True):
    """Commanded acceleration of each vehicle during a tick, before bounds apply; needed for a second flight."""

    tick: Tick
    accelerations: dict[Name, Vector]
    """Accelerations by vehicle [m/s²]."""
    vertical: dict[Name, float] = msgspec.field(default_factory=dict)
    """Vertical acceleration of each UAV with an altitude, after its bounds [m/s²]."""


def commands_of(truth: Truth) -> Commands:
    """Return the commands of the tick before this truth, which led to it."""
    return Commands(
        tick=truth.tick - 1,
        accelerations={name: one.command for name, one in truth.vehicles.items()},
        vertical={
            name: one.vertical_acceleration
            for name, one in truth.vehicles.items()
            if one.altitude is not None
        },
    )


class OperatorCommand(Teleoperation, frozen=True, kw_only=True):
    """Operator's command, with the tick of the UGV's observation that contained it."""

    tick: Tick


class TeamState(Message, frozen=True, kw_only=True):
    """State of a UAV in its team, for viewers."""

    tick: Tick
    role: Role | None = None
    """Role; None: none reported yet."""
    number: Tick
    """Stored number; 0: it has never guarded."""
    charge: NonNegative | None = None
    """Flight time left [s]; None: unlimited."""


def team_states(status: Status) -> Iterator[tuple[str, TeamState]]:
    """Yield each UAV in a team with its state."""
    if status.team is not None:
        for uav, number in status.team.numbers.items():
            role, charge = status.roles.get(uav), status.team.charges.get(uav)
            yield uav, TeamState(tick=status.tick, role=role, number=number, charge=charge)


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """Channel with Outrider's messages."""

    name: str
    message: type[Message]


SCENARIO = Topic(name="/scenario", message=Head)
TRUTH = Topic(name="/truth", message=Truth)
COMMANDS = Topic(name="/commands", message=Commands)
STATUS = Topic(name="/status", message=Status)
COVERAGE = Topic(name="/coverage", message=CoverageMap)
TOPICS = (SCENARIO, TRUTH, COMMANDS, STATUS, COVERAGE)
"""Channels of every recording."""
CHANGES = Topic(name="/changes", message=Change)
"""Operators' changes and requests, with their ticks; in an observer's recording also changes of the clock."""
GROUND = Topic(name="/ground", message=GroundMap)
"""Ground map with hazards, if the scenario has hazards."""
_OPERATOR = "operator"


def operator_topic(ugv: str) -> Topic:
    """Return the channel of the operators' commands to a UGV."""
    return Topic(name=f"/{ugv}/{_OPERATOR}", message=OperatorCommand)


def team_topic(uav: str) -> Topic:
    """Return the channel with the role, number and charge of a UAV in a team."""
    return Topic(name=f"/{uav}/team", message=TeamState)


def ugv_of(topic: str) -> str | None:
    """Return the UGV of a channel of operators' commands; None for another channel."""
    ugv, _, last = topic.removeprefix("/").partition("/")
    return ugv if last == _OPERATOR else None


def inlined_schema(message: type[Message]) -> dict[str, Any]:
    """Return the JSON schema of a message without references: foxglove-sdk rejects msgspec's top-level `$ref`."""
    schema = msgspec.json.schema(message)
    definitions: dict[str, Any] = schema.pop("$defs", {})

    def resolved(part: Any) -> Any:  # noqa: ANN401 - JSON
        if isinstance(part, list):
            return [resolved(entry) for entry in part]
        if not isinstance(part, dict):
            return part
        target = part.get("$ref")
        if target is None:
            return {key: resolved(value) for key, value in part.items()}
        beside = {key: resolved(value) for key, value in part.items() if key != "$ref"}
        return {**resolved(definitions[str(target).rpartition("/")[2]]), **beside}

    found: dict[str, Any] = resolved(schema)
    return found


def _infinite(value: object, path: str) -> list[str]:
    if isinstance(value, float):
        return [path] if math.isinf(value) else []
    pairs = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list | tuple)
        else ()
    )
    return [
        found
        for key, part in pairs
        for found in _infinite(part, f"{path}.{key}" if path else str(key))
    ]


def head_of(
    scenario: Scenario | None,
    seed: int,
    *,
    name: str = "",
    secret: str = "",
    episode: int = 0,
    start: float = 0.0,
) -> Head:
    """Return the head of a flight.

    Args:
        scenario: Scenario that is flown; None: unknown to an observer.
        seed: Seed of all random numbers.
        name: Name of the scenario, if the scenario is None.
        secret: Secret of the run, if known.
        episode: Number of the flight in the run.
        start: Time of the flight's tick 0 on the file's clock [s].
    """
    plain: dict[str, Any] | None = msgspec.to_builtins(scenario)
    return Head(
        outrider=version("outrider"),
        episode=episode,
        start=start,
        name=name if scenario is None else scenario.name,
        seed=seed,
        secret=secret,
        platform=platform_row(),
        scenario=plain,
        infinite=tuple(_infinite(plain, "")),
    )


def scenario_in(head: Head, *, file: str) -> Scenario:
    """Return the scenario that was flown, exact to the last bit.

    Raises:
        ScenarioError: If the head has no scenario, or this version cannot fly it.
    """
    if head.scenario is None:
        raise ScenarioError(
            f"{file}: recorded by an observer without the scenario; allowed: a file recorded with --scenario"
        )
    raw = copy.deepcopy(head.scenario)  # to set the infinite fields
    for field in head.infinite:
        apply_override(raw, field, math.inf, file=file)
    return check_scenario(typed(raw, Scenario, file=file), source=file)


class _AnyFormat(msgspec.Struct, frozen=True):
    format: Annotated[int, Meta(ge=0)]


def read_head(data: bytes, *, file: str) -> Head:
    """Decode a head.

    Raises:
        ScenarioError: If the data is not a head, or has another version of the format.
    """
    try:
        written = msgspec.json.decode(data, type=_AnyFormat).format
        if written != FORMAT:
            raise ScenarioError(f"{file}: recording of format {written}; allowed: {FORMAT}")
        return msgspec.json.decode(data, type=Head)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ScenarioError(
            f"{file}: {SCENARIO.name}: {error}; allowed: a head written by Outrider"
        ) from error
