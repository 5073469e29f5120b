"""Private folder of a run, with socket, credentials and scenario. The next run removes the folder of a killed one."""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bus.errors import BusError
from bus.locator import UNIX, Locator

_PREFIX, _LOCK = "outrider-", ".lock"


def socket_parent() -> str:
    """Return a folder in which private folders can hold a Unix socket.

    This is TMPDIR, unless its path is too long for a socket or contains characters with a meaning for Zenoh.

    Raises:
        BusError: If no folder is suitable.
    """
    wanted = tempfile.gettempdir()
    for parent in (wanted, os.environ.get("XDG_RUNTIME_DIR", ""), "/tmp", "/var/tmp"):  # noqa: S108 - for private folders
        fits = not Locator.of(f"{UNIX}/{parent}/{_PREFIX}12345678/bus.sock").syntax_fault()
        if fits and os.path.isabs(parent) and os.access(parent, os.W_OK | os.X_OK):
            return parent
    raise BusError(
        f"TMPDIR = {wanted!r}: unsuitable for the run's socket; allowed: a short path without '#' and '?'"
    )


def remove_left_folders() -> None:
    """Remove the folders of runs whose process no longer exists."""
    for lock in Path(socket_parent()).glob(f"{_PREFIX}*/{_LOCK}"):
        with contextlib.suppress(OSError):
            status = lock.parent.lstat()
            if status.st_uid != os.geteuid():
                continue
            with lock.open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(lock.parent)


@contextlib.contextmanager
def run_folder() -> Iterator[Path]:
    """Make a folder that only this user can enter, and remove it afterwards."""
    remove_left_folders()
    with (
        tempfile.TemporaryDirectory(
            prefix=_PREFIX, dir=socket_parent(), ignore_cleanup_errors=True
        ) as name,
        Path(name, _LOCK).open("wb") as file,
    ):
        fcntl.flock(file, fcntl.LOCK_EX)
        yield Path(name)
