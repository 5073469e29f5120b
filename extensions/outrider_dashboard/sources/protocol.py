"""Protocol of the sources of the page: a live run (`live`) or a recording (`recorded`)."""

from collections.abc import Iterator
from typing import Protocol

import msgspec

from bus.messages.base import Message
from bus.messages.control import Control
from bus.messages.vehicle import Teleoperation


class Playing(msgspec.Struct, frozen=True, kw_only=True):
    """Playback state of a recording."""

    file: str
    begin: float
    """Start of the recording [s]."""
    end: float
    """End of the recording [s]."""
    at: float
    """Simulated time shown [s]."""
    playing: bool
    speed: float
    """Simulated seconds per second of wall time."""
    note: str = ""
    """Damage of the file; empty: none."""


class SourceState(msgspec.Struct, frozen=True, kw_only=True):
    """State of a source."""

    level: str = ""
    """Severity of `line`: `bad`, `info` or empty."""
    line: str = ""
    """Text of the banner; empty: no banner."""
    router: bool = True
    simulator: bool = True
    replay: Playing | None = None


class Source(Protocol):
    """Interface of a source, as used by the hub."""

    may_steer: bool
    """True if the source accepts commands."""

    def news(self) -> Iterator[Message]:
        """Yield the new Status, Truth, CoverageMap and GroundMap messages, in this order of types."""

    @property
    def factor(self) -> float:
        """Recent simulated seconds per second of wall time."""

    @property
    def state(self) -> SourceState:
        """Current state."""

    def control(self, control: Control) -> bool:
        """Send a command to the simulator; return False if it cannot be sent."""

    def drive(self, vehicle: str, drive: Teleoperation) -> bool:
        """Send a command to a UGV; return False if it cannot be sent."""

    def close(self) -> None:
        """Stop sending, and release the resources."""
