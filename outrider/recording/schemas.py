"""The content of a recording: its channels, their JSON schemas, and the head that says what was flown.

Times are simulated: nanoseconds since the first tick. One file holds one run; a run that was reset has several
flights, one after the other, each with a head of its own.
"""

import copy
import math
from dataclasses import dataclass
from importlib.metadata import version
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from bus.errors import ScenarioError
from bus.messages.base import Message, Name, NonNegative, Text, Tick, Vector
from bus.messages.control import Change
from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.messages.vehicle import Teleoperation
from sim.input.overrides import apply_override
from sim.input.reading import typed
from sim.scenario.checks import check_scenario
from sim.scenario.types import Scenario
from sim.server.recorder import platform_row

FORMAT = 1
"""Of the file. Another number cannot be read."""
PROFILE = "outrider"
"""In the MCAP header."""


LATEST = (1 << 31) * 1_000_000_000 - 1
"""The latest time of a recording [ns]: formats of others count seconds in 32 bits."""


class Head(Message, frozen=True, kw_only=True):
    """The scenario, seed and platform of a flight; its first message."""

    format: int = FORMAT
    outrider: Text
    """Version that wrote the file."""
    episode: Tick = 0
    """The flight's number in the run."""
    start: NonNegative = 0.0
    """The place of this flight's tick 0 on the file's clock [s]."""
    name: Text
    """Of the scenario."""
    seed: Tick
    secret: str = ""
    """Of the run. Empty: none, or whoever recorded was not told it."""
    platform: dict[str, str]
    """The platform that the bits depend on besides scenario and seed."""
    scenario: dict[str, Any] | None = None
    """All of it; None: whoever recorded did not know it."""
    infinite: tuple[str, ...] = ()
    """Fields of the scenario that are infinite: JSON has no such number and they are null there."""


class Commands(Message, frozen=True, kw_only=True):
    """Each vehicle's commanded acceleration during a tick, before the bounds: needed to fly it again."""

    tick: Tick
    accelerations: dict[Name, Vector]
    """[m/s²]"""


class OperatorWord(Teleoperation, frozen=True, kw_only=True):
    """An operator's command, and the tick of the UGV's observation that held it."""

    tick: Tick


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """One of our own channels."""

    name: str
    message: type[Message]


SCENARIO = Topic(name="/scenario", message=Head)
TRUTH = Topic(name="/truth", message=Truth)
COMMANDS = Topic(name="/commands", message=Commands)
STATUS = Topic(name="/status", message=Status)
COVERAGE = Topic(name="/coverage", message=CoverageMap)
TOPICS = (SCENARIO, TRUTH, COMMANDS, STATUS, COVERAGE)
"""Those that every recording has."""
CHANGES = Topic(name="/changes", message=Change)
"""The operators' changes, where there are any: law and driver, each with its tick.

An observer is told of the clock too.
"""
GROUND = Topic(name="/ground", message=GroundMap)
"""The ground with its hazards, where there are any."""
_OPERATOR = "operator"


def operator_topic(ugv: str) -> Topic:
    """The channel of the operators' commands to this UGV, where there are any."""
    return Topic(name=f"/{ugv}/{_OPERATOR}", message=OperatorWord)


def ugv_of(topic: str) -> str | None:
    """The UGV at whose wheel a topic's words were said; None where it is another topic."""
    ugv, _, last = topic.removeprefix("/").partition("/")
    return ugv if last == _OPERATOR else None


def inlined_schema(message: type[Message]) -> dict[str, Any]:
    """The JSON schema of a message without references: foxglove-sdk refuses the `$ref` that msgspec puts on top."""
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
    """The head of a flight.

    Args:
        scenario: What is flown; None: an observer is not told.
        seed: Of all random numbers.
        name: Of the scenario, where it is not given.
        secret: Of the run, where it is known.
        episode: Which flight of the run.
        start: Where its tick 0 lies on the file's clock [s].
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
    """The scenario that was flown, every bit of it.

    Raises:
        ScenarioError: If it is not there, or this version cannot fly it.
    """
    if head.scenario is None:
        raise ScenarioError(
            f"{file}: recorded by an observer without the scenario; allowed: a file recorded with --scenario"
        )
    raw = copy.deepcopy(head.scenario)  # to put the infinite ones into
    for field in head.infinite:
        apply_override(raw, field, math.inf, file=file)
    return check_scenario(typed(raw, Scenario, file=file), source=file)


class _AnyFormat(msgspec.Struct, frozen=True):
    format: Annotated[int, Meta(ge=0)]


def read_head(data: bytes, *, file: str) -> Head:
    """The head from its JSON.

    Raises:
        ScenarioError: If it is none, or of another version of the format.
    """
    try:
        written = msgspec.json.decode(data, type=_AnyFormat).format
        if written != FORMAT:
            raise ScenarioError(
                f"{file}: a recording of format {written}; allowed: {FORMAT}, which this version reads"
            )
        return msgspec.json.decode(data, type=Head)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ScenarioError(
            f"{file}: {SCENARIO.name}: {error}; allowed: the head that Outrider writes"
        ) from error
