"""A child process ends when its parent has gone, however it went."""

import os
import signal
import sys
import threading


def hold() -> None:
    """Send this process SIGTERM once its standard input closes: nobody is left who holds the other end."""

    def wait() -> None:
        while os.read(sys.stdin.fileno(), 1024):
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="outrider-leash", daemon=True).start()
