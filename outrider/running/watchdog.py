"""A child process ends when its parent has gone, however it went."""

import atexit
import os
import select
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from multiprocessing import resource_tracker
from pathlib import Path

_PR_SET_PDEATHSIG = 1


def _wake_when_the_parent_dies() -> None:
    """A process that stands still (SIGSTOP) cannot notice anything: let the kernel wake it, where it is Linux."""
    if sys.platform == "linux":
        import ctypes  # noqa: PLC0415 - only here

        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, int(signal.SIGCONT), 0, 0, 0)


def start_watchdog(folder: Path | None = None) -> None:
    """Send this process SIGTERM once its standard input closes: nobody is left who holds the other end.

    Args:
        folder: What the parent would have removed; it is removed then.
    """

    def tidy() -> None:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)

    def wait() -> None:
        while os.read(sys.stdin.fileno(), 1024):
            pass
        tidy()
        os.kill(os.getpid(), signal.SIGTERM)

    def leave() -> None:
        # The main thread may notice first that the parent has gone (a broken pipe, the run's end) and would cut
        # `wait` short. The system closes a dead parent's pipes one by one, this one perhaps last of all.
        pipes = select.poll()
        pipes.register(sys.stdin.fileno(), select.POLLIN)
        for broken in (1, 2):
            pipes.register(broken, 0)
        if pipes.poll(0):
            tidy()

    _wake_when_the_parent_dies()
    atexit.register(leave)
    threading.Thread(target=wait, name="outrider-watchdog", daemon=True).start()


@cache
def end_with_parent(parent: int) -> None:
    """End this worker of a pool when its parent has gone, however it went: a pool's own workers would stay.

    Args:
        parent: The process without which this one is not to stay.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, name="outrider-watchdog", daemon=True).start()


@contextmanager
def interrupts_masked() -> Iterator[None]:
    """Start processes that do not receive SIGINT, which a terminal sends to all; their parent ends them."""
    resource_tracker.ensure_running()  # it would be started with the first process, and let SIGINT through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
