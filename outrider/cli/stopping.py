"""Ctrl-C and SIGTERM as a wish, not as an exception in the middle of a tick."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Stop:
    """The signal that has asked for the end, if any."""

    def __init__(self) -> None:
        self.signal: int | None = None
        self.count = 0
        self._asked = threading.Event()

    def __bool__(self) -> bool:
        return self.signal is not None

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Take the signal down."""
        self.signal = number
        self.count += 1
        self._asked.set()

    def wait(self) -> None:
        """Sleep until a signal asks for the end."""
        while not self._asked.wait(1.0):  # in pieces: a signal's handler runs between two of them
            pass

    @property
    def exit_code(self) -> int:
        """As a shell would say it."""
        return 0 if self.signal is None else 128 + self.signal


def ended_by() -> list[signal.Signals]:
    """The signals that ask for the end."""
    kept = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if kept else [signal.SIGHUP])]


@contextmanager
def stop_on_signals() -> Iterator[Stop]:
    """While this lasts, SIGINT, SIGTERM and SIGHUP only set a flag; the last not where it is ignored, as by nohup."""
    stop = Stop()
    before = {number: signal.signal(number, stop.handle) for number in ended_by()}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
