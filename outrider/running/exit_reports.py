"""Reports of the simulator's process to its parent: JSON lines on standard output."""

import sys
from collections.abc import Sequence

import msgspec

from outrider.running.summary import Summary


class Report(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Report of one line; exactly one field is set."""

    tick: int | None = None
    """Current tick."""
    event: str | None = None
    """Event to show to the user."""
    warnings: Sequence[str] | None = None
    """Warnings about the scenario."""
    summary: Summary | None = None
    """Summary at the end of the run."""
    files: list[str] | None = None
    """Files that were written."""


class Reports:
    """Writer of reports for the parent."""

    def write(self, report: Report) -> None:
        """Write one line."""
        sys.stdout.buffer.write(msgspec.json.encode(report) + b"\n")
        sys.stdout.buffer.flush()

    def show(self, tick: int) -> None:
        """Report the current tick."""
        self.write(Report(tick=tick))

    def say(self, line: str) -> None:
        """Report an event."""
        self.write(Report(event=line))
