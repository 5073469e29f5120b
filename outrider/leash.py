"""A child process ends when its parent has gone, however it went."""

import os
import shutil
import signal
import sys
import threading
from pathlib import Path


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

    threading.Thread(target=wait, name="outrider-leash", daemon=True).start()
