"""Ctrl-C and SIGTERM as a request to stop, not as an exception in the middle of a tick."""

import contextlib
import queue
import signal
from collections.abc import Iterator
from types import FrameType


class Stop:
    """Request to stop: the signal received, if any."""

    def __init__(self) -> None:
        self.signal: int | None = None
        self.count = 0
        self._asked: queue.SimpleQueue[None] = queue.SimpleQueue()

    def __bool__(self) -> bool:
        return self.signal is not None

    def handle(self, number: int, _frame: FrameType | None) -> None:
        """Store the signal; a second one may arrive in here, where a lock would never be free again."""
        self.signal = number
        self.count += 1
        self._asked.put(None)  # reentrant, unlike `threading.Event.set`

    def wait(self) -> None:
        """Sleep until a signal arrives."""
        while self.signal is None:
            with contextlib.suppress(queue.Empty):
                self._asked.get(timeout=1.0)  # in short waits: signal handlers run between them

    @property
    def exit_code(self) -> int:
        """Exit code after the signal, as in a shell; 0 without a signal."""
        return 0 if self.signal is None else 128 + self.signal


def ended_by() -> list[signal.Signals]:
    """Return the signals that request a stop; without SIGHUP if it is ignored, as under nohup."""
    kept = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if kept else [signal.SIGHUP])]


@contextlib.contextmanager
def stop_on_signals() -> Iterator[Stop]:
    """Make SIGINT, SIGTERM and SIGHUP set a flag only, within this context; an ignored SIGHUP stays ignored."""
    stop = Stop()
    before = {number: signal.signal(number, stop.handle) for number in ended_by()}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
