"""Terminal settings, and their restoration at the end of the teleoperation."""

import contextlib
import logging
import os
import signal
import sys
import termios
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

from bus.errors import ScenarioError
from outrider.view.terminal.teleoperation import DriveLink

_GRACE, _PATIENCE = 2.0, 15.0
"""Longest time for the screen to close after control is returned [s]: after a signal, and after a key.

A terminal that is closed never answers; one that has just sent a key is slow at worst."""
_LEAVE = b"\x1b[<u\x1b[?1049l\x1b[?25h\x1b[?1004l\x1b[?2004l\x1b[?7h"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def check_terminal() -> None:
    """Check that the process has a terminal.

    Raises:
        ScenarioError: If standard input, output or error is not a terminal.
    """
    for name, stream in (
        ("input", sys.__stdin__),
        ("output", sys.__stdout__),
        ("error", sys.__stderr__),
    ):
        if stream is None or not stream.isatty():
            raise ScenarioError(
                f"drive: standard {name} is not a terminal; over SSH use `ssh -t`, in a container `-it`"
            )


def know_colours() -> None:
    """Assume 256 colors for a terminal that reports only `xterm`, as in containers.

    Must be called before Textual is imported.
    """
    if os.environ.get("TERM") in ("xterm", "screen", "tmux") and not os.environ.get("COLORTERM"):
        os.environ.setdefault("TEXTUAL_COLOR_SYSTEM", "256")


class Ending:
    """Handler of signals that first returns control."""

    def __init__(self, link: DriveLink) -> None:
        self._link = link
        self.code = 0
        """Exit code after the signal; 0 without a signal."""
        self.closed = threading.Event()

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Store the signal, and request to quit."""
        self.code = 128 + number
        self._link.leave()

    def guard(self, descriptor: int, attributes: list[Any]) -> None:
        """Exit even if the screen cannot close.

        Textual waits for its writer thread, which blocks forever in a write to a hung terminal. No clean exit is
        possible then; this is the only place that calls `os._exit`.
        """
        with contextlib.suppress(Exception):  # reported by the caller that waits for the link
            self._link.wait()
        if not self.closed.wait(_GRACE if self.code else _PATIENCE):
            with contextlib.suppress(OSError, termios.error):
                termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
                os.set_blocking(descriptor, False)
                os.write(descriptor, _LEAVE)
            os._exit(self.code or 1)


@contextlib.contextmanager
def ending(link: DriveLink) -> Iterator[Ending]:
    """Make SIGINT, SIGTERM and SIGHUP return control within this context; restore the terminal afterwards."""
    descriptor = sys.__stdin__.fileno() if sys.__stdin__ is not None else 0
    attributes = termios.tcgetattr(descriptor)
    # Keys typed before the screen appears must not drive.
    termios.tcflush(descriptor, termios.TCIFLUSH)
    end = Ending(link)
    before = {number: signal.signal(number, end.handle) for number in SIGNALS}
    threading.Thread(
        target=end.guard, args=(descriptor, attributes), name="outrider-ending", daemon=True
    ).start()
    try:
        yield end
    finally:
        end.closed.set()
        for number, handler in before.items():
            signal.signal(number, handler)
        with contextlib.suppress(termios.error):
            termios.tcsetattr(descriptor, termios.TCSANOW, attributes)


@contextlib.contextmanager
def quiet_logs() -> Iterator[list[str]]:
    """Collect log messages within this context instead of writing them across the screen."""
    lines: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if len(lines) < 100:
                lines.append(f"{record.name}: {record.getMessage()}")

    root = logging.getLogger()
    before, root.handlers = root.handlers, [Keep()]
    try:
        yield lines
    finally:
        root.handlers = before
