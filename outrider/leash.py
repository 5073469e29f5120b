"""A child process ends when its parent has gone, however it went."""

import os
import shutil
import signal
import sys
import threading
from pathlib import Path

_PR_SET_PDEATHSIG = 1


def _wake_when_the_parent_dies() -> None:
    """A process that stands still (SIGSTOP) cannot notice anything: let the kernel wake it, where it is Linux."""
    if sys.platform == "linux":
        import ctypes  # noqa: PLC0415 - only here

        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, int(signal.SIGCONT), 0, 0, 0)


def hold(folder: Path | None = None) -> None:
    """Send this process SIGTERM once its standard input closes: nobody is left who holds the other end.

    Args:
        folder: What the parent would have removed; it is removed then.
    """

    def wait() -> None:
        while os.read(sys.stdin.fileno(), 1024):
            pass
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        os.kill(os.getpid(), signal.SIGTERM)

    _wake_when_the_parent_dies()
    threading.Thread(target=wait, name="outrider-leash", daemon=True).start()
