"""The terminal, and how to leave it as it was, whatever ends the drive."""

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
"""The time that the screen may take to close once all is handed back [s], after a signal and after a key.

A terminal that has gone never does, one that has just told a key is slow at worst."""
_LEAVE = b"\x1b[<u\x1b[?1049l\x1b[?25h\x1b[?1004l\x1b[?2004l\x1b[?7h"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def check_terminal() -> None:
    """Refuse to drive without one.

    Raises:
        ScenarioError: If standard input, output or error is none.
    """
    for name, stream in (
        ("input", sys.__stdin__),
        ("output", sys.__stdout__),
        ("error", sys.__stderr__),
    ):
        if stream is None or not stream.isatty():
            raise ScenarioError(
                f"drive: standard {name} is no terminal; over SSH use `ssh -t`, in a container `-it`"
            )


def know_colours() -> None:
    """Count on 256 colours where the terminal says no more than `xterm`, as in containers.

    To be called before Textual loads.
    """
    if os.environ.get("TERM") in ("xterm", "screen", "tmux") and not os.environ.get("COLORTERM"):
        os.environ.setdefault("TEXTUAL_COLOR_SYSTEM", "256")


class Ending:
    """Signals as a wish: the wheel is handed back first."""

    def __init__(self, link: DriveLink) -> None:
        self._link = link
        self.code = 0
        """The exit code that the signal asks for."""
        self.closed = threading.Event()

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Take the signal down."""
        self.code = 128 + number
        self._link.leave()

    def guard(self, descriptor: int, attributes: list[Any]) -> None:
        """End the process even if its screen cannot close.

        Textual waits for its writer thread, which waits for ever in a write to a stuck terminal. So no clean exit is
        possible then: this is the one place that calls `os._exit`.
        """
        with contextlib.suppress(Exception):  # is told by whoever waits for the link
            self._link.wait()
        if not self.closed.wait(_GRACE if self.code else _PATIENCE):
            with contextlib.suppress(OSError, termios.error):
                termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
                os.set_blocking(descriptor, False)
                os.write(descriptor, _LEAVE)
            os._exit(self.code or 1)


@contextlib.contextmanager
def ending(link: DriveLink) -> Iterator[Ending]:
    """While this lasts, SIGINT, SIGTERM and SIGHUP hand the wheel back; afterwards the terminal is as before."""
    descriptor = sys.__stdin__.fileno() if sys.__stdin__ is not None else 0
    attributes = termios.tcgetattr(descriptor)
    # what was typed before there was a screen drives nothing
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
    """While this lasts, warnings are kept instead of written across the screen."""
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
