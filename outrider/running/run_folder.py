"""The private folder of a run: socket, credentials and scenario; the next start removes that of a killed run."""

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

    It is TMPDIR, or another if the path there is too long for a socket or has characters that mean something to Zenoh.

    Raises:
        BusError: If there is none.
    """
    wanted = tempfile.gettempdir()
    for place in (wanted, os.environ.get("XDG_RUNTIME_DIR", ""), "/tmp", "/var/tmp"):  # noqa: S108 - for private folders
        fits = not Locator.of(f"{UNIX}/{place}/{_PREFIX}12345678/bus.sock").syntax_fault()
        if fits and os.path.isabs(place) and os.access(place, os.W_OK | os.X_OK):
            return place
    raise BusError(
        f"TMPDIR = {wanted!r}: no place for the run's socket; allowed: a short path without '#' and '?'"
    )


def remove_left_folders() -> None:
    """Remove the folders of runs that no process holds any more."""
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
    """Make a folder that only this user can enter, for as long as this is open or the process lives."""
    remove_left_folders()
    with (
        tempfile.TemporaryDirectory(
            prefix=_PREFIX, dir=socket_parent(), ignore_cleanup_errors=True
        ) as name,
        Path(name, _LOCK).open("wb") as file,
    ):
        fcntl.flock(file, fcntl.LOCK_EX)
        yield Path(name)
