"""Key table: each message with its key, its writer and its readers. Access control is derived from it.

A key is `outrider/<run>/<vehicle>/<topic>`, or `outrider/<run>/<topic>` for a key without a vehicle.
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
MAX_SESSIONS = 8
"""Maximum number of simultaneous sessions of one party; each declares its own liveliness token."""
_SMALL, _LARGE, _HUGE = 1 << 16, 1 << 20, 1 << 24


class Role(StrEnum):
    """Role of a process."""

    SIMULATOR = "simulator"
    UAV = "uav"
    UGV = "ugv"
    OPERATOR = "operator"
    OBSERVER = "observer"
    GUEST = "guest"
    """Party of an extension without rows in this table: see `bus.roles`."""


SIMULATOR_NAME = Role.SIMULATOR.value
OPERATOR_NAME = Role.OPERATOR.value
OBSERVER_NAME = Role.OBSERVER.value
STAFF = {SIMULATOR_NAME: Role.SIMULATOR, OPERATOR_NAME: Role.OPERATOR, OBSERVER_NAME: Role.OBSERVER}
"""Reserved names on the bus, with their roles."""


class Delivery(StrEnum):
    """Delivery guarantee of a message."""

    EVERY = "every"
    """Each message arrives, in order; the writer blocks rather than lose one."""
    NEWEST = "newest"
    """Old messages may be dropped; the writer never blocks."""


@dataclass(frozen=True, slots=True)
class Key:
    """One row of the table."""

    topic: str
    vehicle: Role | None
    """Kind of vehicle in the key; None: no vehicle."""
    message: type[Message]
    writer: Role
    readers: tuple[Role, ...]
    delivery: Delivery = Delivery.EVERY
    largest: int = _SMALL
    """Maximum payload [bytes]. The router drops larger ones unless the simulator sent them; readers reject them
    unread.
    """

    def expression(self, run: str, vehicle: str = "") -> str:
        """Return the key of one vehicle (or of none) in one run; `*` matches any vehicle."""
        middle = f"{vehicle}/" if self.vehicle is not None else ""
        return f"{ROOT}/{run}/{middle}{self.topic}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Party:
    """Identity of a process: its role and name. `uav_0` is not `uav_1`."""

    role: Role
    """Role whose rows of this table apply to it."""
    name: str
    extension: str = ""
    """Role of an extension (`bus.roles`); empty: none."""


class Grant(NamedTuple):
    """Permission of a party for one kind of message, or an exception to another permission."""

    message: str
    """Zenoh's kind of message."""
    flow: str
    """`ingress` or `egress`, from the router's point of view."""
    keys: tuple[str, ...]
    permission: str = "allow"
    """`allow`, or `deny`, which takes precedence."""


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
"""Truth for display: sampled at a rate for the human eye."""
COVERAGE = Key("coverage", None, CoverageMap, Role.SIMULATOR, _WATCHING, Delivery.NEWEST, _HUGE)
GROUND = Key("ground", None, GroundMap, Role.SIMULATOR, _WATCHING, Delivery.NEWEST, _HUGE)
"""Hazards, if there are any: their true state, which no vehicle receives, and the vehicles' knowledge."""
STATUS = Key("status", None, Status, Role.SIMULATOR, _WATCHING, Delivery.NEWEST, _HUGE)
"""With the geometry of a run, whose buildings may have 100,000 corners."""

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
_SESSION_NUMBERS = {str(number): number for number in range(MAX_SESSIONS)}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def check_run_name(run: str) -> str:
    """Return the name of a run after checking that it can be part of a key.

    Raises:
        ValueError: If it cannot.
    """
    if not _NAME.fullmatch(run):
        raise ValueError(
            f"run = {run!r}: allowed are 1 to 64 letters, digits, '_', '.' and '-', first a letter or digit"
        )
    return run


def token(run: str, name: str, number: int | str) -> str:
    """Return the liveliness token of one session of a party; it exists as long as the process.

    Session numbers are limited, so that access control can list all keys that a party may declare.

    Args:
        run: Name of the run.
        name: Name of the party; `*` matches any.
        number: Number of the session, less than `MAX_SESSIONS`; `*` matches any. The simulator uses a vehicle's role
            instead: see `vehicle_token`.
    """
    return f"{ROOT}/{run}/{name}/{_TOKEN}/{number}"


def token_owner(expression: str) -> tuple[str, int]:
    """Return the owner of a token, and the number of its session; -1 if it has none."""
    parts = expression.split("/")
    return parts[-3], _SESSION_NUMBERS.get(parts[-1], -1)


def vehicle_token(run: str, name: str, role: Role) -> str:
    """Return the simulator's liveliness token of a vehicle in its scenario.

    Args:
        run: Name of the run.
        name: Name of the vehicle; `*` matches any.
        role: Role of the vehicle.
    """
    return token(run, name, role.value)


def largest_payloads(run: str) -> dict[int, tuple[str, ...]]:
    """Return the payload limits [bytes] of all keys that the simulator does not write, each with its keys."""
    found: dict[int, tuple[str, ...]] = {}
    for key in KEYS:
        if key.writer is not Role.SIMULATOR:
            expression = key.expression(run, "*")
            found[key.largest] = tuple(dict.fromkeys((*found.get(key.largest, ()), expression)))
    return found


def written_by(party: Party) -> tuple[Key, ...]:
    """Return the rows that a party may write, a vehicle for itself only."""
    return tuple(key for key in KEYS if party.role is key.writer)


def read_by(party: Party) -> tuple[Key, ...]:
    """Return the rows that a party may read, a vehicle for itself only."""
    return tuple(key for key in KEYS if party.role in key.readers)


def _check(may: bool, verb: str, key: Key, party: Party, vehicle: str) -> None:
    """Reject what the table does not grant, and the keys of other vehicles."""
    if party.role in (Role.UAV, Role.UGV) and key.vehicle is not None:
        may = may and party.role is key.vehicle and party.name == vehicle
    if not may:
        raise AccessDenied(
            f"{party.name} ({party.role}) may not {verb} {vehicle or 'the'} {key.topic}"
        )


def check_writes(key: Key, party: Party, vehicle: str = "") -> None:
    """Check that a party may write a key.

    Raises:
        AccessDenied: If this party may not write this key of this vehicle.
    """
    _check(party.role is key.writer, "write", key, party, vehicle)


def check_reads(key: Key, party: Party, vehicle: str = "") -> None:
    """Check that a party may read a key.

    Raises:
        AccessDenied: If this party may not read this key of this vehicle.
    """
    _check(party.role in key.readers, "read", key, party, vehicle)
