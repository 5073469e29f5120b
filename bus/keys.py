"""THE table: which message travels on which key, who writes it and who reads it. Everything else is derived from it.

A key is `outrider/<run>/<vehicle>/<topic>`, or `outrider/<run>/<topic>` where no vehicle is meant.
"""

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from bus.errors import AccessDenied
from bus.messages.base import Message
from bus.messages.control import Control
from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.messages.vehicle import (
    Teleoperation,
    UavBriefing,
    UavCommand,
    UavObservation,
    UgvBriefing,
    UgvCommand,
    UgvObservation,
)

ROOT = "outrider"
PLACES = 8
"""Sessions of one party that can be there at once; each declares a liveliness token of its own."""
_SMALL, _LARGE, _HUGE = 1 << 16, 1 << 20, 1 << 24


class Role(StrEnum):
    """The role of a process."""

    SIMULATOR = "simulator"
    UAV = "uav"
    UGV = "ugv"
    OPERATOR = "operator"
    OBSERVER = "observer"
    GUEST = "guest"
    """A party of an extension without rows in this table: `bus.roles`."""


SIMULATOR_NAME = Role.SIMULATOR.value
OPERATOR_NAME = Role.OPERATOR.value
OBSERVER_NAME = Role.OBSERVER.value
STAFF = {SIMULATOR_NAME: Role.SIMULATOR, OPERATOR_NAME: Role.OPERATOR, OBSERVER_NAME: Role.OBSERVER}
"""The names on the bus that no vehicle may bear, and whose they are."""


class Delivery(StrEnum):
    """A message's way of travelling."""

    EVERY = "every"
    """Each one arrives, in order; the writer waits rather than lose one."""
    NEWEST = "newest"
    """Old ones may be dropped; the writer never waits."""


@dataclass(frozen=True, slots=True)
class Key:
    """One row of the table."""

    topic: str
    vehicle: Role | None
    """The kind of vehicle whose key this is; None: the key has no vehicle in it."""
    message: type[Message]
    writer: Role
    readers: tuple[Role, ...]
    delivery: Delivery = Delivery.EVERY
    largest: int = _SMALL
    """Larger payloads [bytes] the router drops where the writer is not the simulator, and readers refuse unread."""

    def expression(self, run: str, vehicle: str = "") -> str:
        """The key of one vehicle (or of none) in one run; `*` stands for any."""
        middle = f"{vehicle}/" if self.vehicle is not None else ""
        return f"{ROOT}/{run}/{middle}{self.topic}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Party:
    """The identity of a process, by role and name: `uav_0` is not `uav_1`."""

    role: Role
    """Role by whose rows of this table it reads and writes."""
    name: str
    extension: str = ""
    """Role of an extension (`bus.roles`); empty: none."""


class Grant(NamedTuple):
    """One thing that the router lets through for a party, or does not though another rule would."""

    message: str
    """Zenoh's kind of message."""
    flow: str
    """`ingress` or `egress`, as the router sees it."""
    keys: tuple[str, ...]
    permission: str = "allow"
    """`allow`, or `deny`, which is stronger."""


_WATCHING = (Role.OBSERVER, Role.OPERATOR)

# To a vehicle: every message counts, and it may be large.
UAV_BRIEFING = Key("briefing", Role.UAV, UavBriefing, Role.SIMULATOR, (Role.UAV,), largest=_LARGE)
UGV_BRIEFING = Key("briefing", Role.UGV, UgvBriefing, Role.SIMULATOR, (Role.UGV,), largest=_LARGE)
UAV_OBSERVATION = Key(
    "observation", Role.UAV, UavObservation, Role.SIMULATOR, (Role.UAV,), largest=_LARGE
)
UGV_OBSERVATION = Key(
    "observation", Role.UGV, UgvObservation, Role.SIMULATOR, (Role.UGV,), largest=_LARGE
)
# To the simulator, from vehicles and operators: every message counts.
UAV_COMMAND = Key("command", Role.UAV, UavCommand, Role.UAV, (Role.SIMULATOR,))
UGV_COMMAND = Key("command", Role.UGV, UgvCommand, Role.UGV, (Role.SIMULATOR,))
OPERATOR = Key("operator", Role.UGV, Teleoperation, Role.OPERATOR, (Role.SIMULATOR,))
CONTROL = Key("control", None, Control, Role.OPERATOR, (Role.SIMULATOR,))
# To observers and operators: the newest message counts, and it may be large.
TRUTH = Key("truth", None, Truth, Role.SIMULATOR, _WATCHING, Delivery.NEWEST, _LARGE)
SAMPLED_TRUTH = Key(
    "sampled-truth", None, Truth, Role.SIMULATOR, _WATCHING, Delivery.NEWEST, _LARGE
)
"""The truth for people's eyes: some ticks of it, as often as an eye can see."""
COVERAGE = Key("coverage", None, CoverageMap, Role.SIMULATOR, _WATCHING, Delivery.NEWEST, _LARGE)
GROUND = Key("ground", None, GroundMap, Role.SIMULATOR, _WATCHING, Delivery.NEWEST, _HUGE)
"""The hazards, if there are any: what no vehicle is told of them, with what the vehicles know."""
STATUS = Key("status", None, Status, Role.SIMULATOR, _WATCHING, Delivery.NEWEST, _LARGE)

KEYS: tuple[Key, ...] = (
    UAV_BRIEFING,
    UGV_BRIEFING,
    UAV_OBSERVATION,
    UGV_OBSERVATION,
    UAV_COMMAND,
    UGV_COMMAND,
    OPERATOR,
    CONTROL,
    TRUTH,
    SAMPLED_TRUTH,
    COVERAGE,
    GROUND,
    STATUS,
)

BRIEFING = {Role.UAV: UAV_BRIEFING, Role.UGV: UGV_BRIEFING}
OBSERVATION = {Role.UAV: UAV_OBSERVATION, Role.UGV: UGV_OBSERVATION}
COMMAND = {Role.UAV: UAV_COMMAND, Role.UGV: UGV_COMMAND}

_TOKEN = "alive"  # noqa: S105 - a part of a liveliness token's key
_PLACE_NUMBERS = {str(place): place for place in range(PLACES)}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def check_run_name(run: str) -> str:
    """The run's name, if it can be part of a key.

    Raises:
        ValueError: If it cannot.
    """
    if not _NAME.fullmatch(run):
        raise ValueError(
            f"run = {run!r}: allowed are 1 to 64 letters, digits, '_', '.' and '-', first a letter or digit"
        )
    return run


def token(run: str, name: str, place: int | str) -> str:
    """The liveliness token of one session of a party: there while its process is.

    Places are numbered, so that access control can list all keys that a party may declare.

    Args:
        run: Name of the run.
        name: Of the party; `*` stands for any.
        place: Number of the session, from 0 to `PLACES` - 1; `*` stands for any. In the place of a number the
            simulator puts a vehicle's role: see `slot_token`.
    """
    return f"{ROOT}/{run}/{name}/{_TOKEN}/{place}"


def token_owner(expression: str) -> tuple[str, int]:
    """The owner of a token, and the number of its session; -1 where it has none."""
    parts = expression.split("/")
    return parts[-3], _PLACE_NUMBERS.get(parts[-1], -1)


def slot_token(run: str, name: str, role: Role) -> str:
    """The simulator's liveliness token of a vehicle in its scenario.

    Args:
        run: Name of the run.
        name: Of the vehicle; `*` stands for any.
        role: Its kind.
    """
    return token(run, name, role.value)


def largest_payloads(run: str) -> dict[int, tuple[str, ...]]:
    """The largest payload [bytes], and the keys of a run for which it is that, of all that is not the simulator's."""
    found: dict[int, tuple[str, ...]] = {}
    for key in KEYS:
        if key.writer is not Role.SIMULATOR:
            expression = key.expression(run, "*")
            found[key.largest] = tuple(dict.fromkeys((*found.get(key.largest, ()), expression)))
    return found


def written_by(party: Party) -> tuple[Key, ...]:
    """The rows that a party may write, for its own vehicle if it is one."""
    return tuple(key for key in KEYS if party.role is key.writer)


def read_by(party: Party) -> tuple[Key, ...]:
    """The rows that a party may read, for its own vehicle if it is one."""
    return tuple(key for key in KEYS if party.role in key.readers)


def _check(may: bool, verb: str, key: Key, party: Party, vehicle: str) -> None:
    """Refuse what the table does not give, and a vehicle the keys of others."""
    if party.role in (Role.UAV, Role.UGV) and key.vehicle is not None:
        may = may and party.role is key.vehicle and party.name == vehicle
    if not may:
        raise AccessDenied(
            f"{party.name} ({party.role}) may not {verb} {vehicle or 'the'} {key.topic}"
        )


def check_writes(key: Key, party: Party, vehicle: str = "") -> None:
    """Refuse what the table does not give.

    Raises:
        AccessDenied: If this party may not write this key of this vehicle.
    """
    _check(party.role is key.writer, "write", key, party, vehicle)


def check_reads(key: Key, party: Party, vehicle: str = "") -> None:
    """Refuse what the table does not give.

    Raises:
        AccessDenied: If this party may not read this key of this vehicle.
    """
    _check(party.role in key.readers, "read", key, party, vehicle)
