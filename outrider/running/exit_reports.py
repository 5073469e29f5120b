"""Reports of the simulator's process to the process that started it: JSON lines on stdout."""

import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec

from outrider.running.summary import Summary


class Report(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One line; exactly one field is set."""

    tick: int | None = None
    event: str | None = None
    warnings: list[str] | None = None
    summary: Summary | None = None
    files: list[str] | None = None


class Reports:
    """Writes reports, or nothing where nobody asked for them."""

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled

    def _write(self, report: Report) -> None:
        if self._enabled:
            sys.stdout.buffer.write(msgspec.json.encode(report) + b"\n")
            sys.stdout.buffer.flush()

    def show(self, tick: int) -> None:
        """The flight has come to this tick."""
        self._write(Report(tick=tick))

    def say(self, line: str) -> None:
        """Something a person should know."""
        self._write(Report(event=line))

    def warn(self, lines: Sequence[str]) -> None:
        """Why what is flown will not do what one may expect."""
        self._write(Report(warnings=list(lines)))

    def summary(self, summary: Summary) -> None:
        """The flight is over."""
        self._write(Report(summary=summary))

    def files(self, files: list[Path]) -> None:
        """These files are written."""
        self._write(Report(files=[str(file) for file in files]))
