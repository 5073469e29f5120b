"""The protocol of the page's sources: a run that is flown now (`live`), or a recording that is played (`tape`)."""

from collections.abc import Iterator
from typing import Protocol

import msgspec

from bus.messages.base import Message
from bus.messages.control import Control
from bus.messages.vehicle import Teleoperation


class Playing(msgspec.Struct, frozen=True, kw_only=True):
    """The state of a recording that is played."""

    file: str
    begin: float
    """Of the recording [s]."""
    end: float
    at: float
    """The simulated time that is shown [s]."""
    playing: bool
    speed: float
    """Simulated seconds per second of wall time."""
    note: str = ""
    """The fault of the file; empty: none."""


class SourceState(msgspec.Struct, frozen=True, kw_only=True):
    """The state of a source."""

    level: str = ""
    """The severity of `line`: `bad`, `info`, or nothing."""
    line: str = ""
    router: bool = True
    simulator: bool = True
    replay: Playing | None = None


class Source(Protocol):
    """The hub's side of either."""

    may_steer: bool
    """True if anybody receives what is sent."""

    def news(self) -> Iterator[Message]:
        """Status, Truth, CoverageMap and GroundMap that have come since the last call, in this order of kinds."""

    @property
    def factor(self) -> float:
        """Simulated seconds per second of wall time, lately."""

    @property
    def standing(self) -> SourceState:
        """Its state now."""

    def control(self, control: Control) -> bool:
        """Say something to the simulator; False if it cannot be said."""

    def drive(self, vehicle: str, drive: Teleoperation) -> bool:
        """Say something to a UGV; False if it cannot be said."""

    def close(self) -> None:
        """Say no more."""
