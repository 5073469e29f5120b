"""Events that an adversary causes in a flight of a team; in a file they repeat its attack."""

from enum import StrEnum
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.messages.base import Tick

NO_ONE = ""


class EventKind(StrEnum):
    """Kind of an event."""

    DEATH = "DEATH"
    """The process of `vehicle` ends before its answer to this tick, and another one answers `ticks` later."""
    BLACKOUT = "BLACKOUT"
    """No message that is sent to a team-mate in the next `ticks` arrives."""
    REQUEST = "REQUEST"
    """The message of `vehicle` in this tick asks `asked` for relief."""


class Event(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One event."""

    tick: Tick
    kind: EventKind
    vehicle: str = NO_ONE
    ticks: Annotated[int, Meta(ge=0)] = 0
    asked: str = NO_ONE


Events = tuple[Event, ...]
