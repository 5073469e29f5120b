"""Reports of the simulator's process to the process that started it: JSON lines on stdout."""

import sys
from collections.abc import Sequence

import msgspec

from outrider.running.summary import Summary


class Report(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One line; exactly one field is set."""

    tick: int | None = None
    """The flight has come to it."""
    event: str | None = None
    """Something a person should know."""
    warnings: Sequence[str] | None = None
    """Why what is flown will not do what one may expect."""
    summary: Summary | None = None
    """The flight is over."""
    files: list[str] | None = None
    """These are written."""


class Reports:
    """Writer of reports for the parent."""

    def write(self, report: Report) -> None:
        """Write one line."""
        sys.stdout.buffer.write(msgspec.json.encode(report) + b"\n")
        sys.stdout.buffer.flush()

    def show(self, tick: int) -> None:
        """Report the tick that the flight has reached."""
        self.write(Report(tick=tick))

    def say(self, line: str) -> None:
        """Report an event."""
        self.write(Report(event=line))
