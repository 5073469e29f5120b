"""Safe reading of files from other parties, and atomic writing.

Only regular files up to a maximum size are read.
"""

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

UNFINISHED = ".unfinished"
"""Suffix of a file that is being written; it may remain after a kill."""


def open_regular(path: Path, most: int | None = None) -> BufferedReader:
    """Open a file for reading; never block on a FIFO or read a device.

    Args:
        path: The file.
        most: Maximum size [bytes]; None: any.

    Raises:
        OSError: If it cannot be opened, is not a regular file, or is larger.
    """
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    try:
        status = os.fstat(descriptor)
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        if most is not None and status.st_size > most:
            raise _too_large(path, most)
        return os.fdopen(descriptor, "rb")
    except OSError:
        os.close(descriptor)
        raise


def read_regular(path: Path, most: int) -> bytes:
    """Return the content of a file; see `open_regular`."""
    with open_regular(path, most) as file:
        content = file.read(most + 1)  # the file may grow meanwhile
    if len(content) > most:
        raise _too_large(path, most)
    return content


def create_unused(path: Path, *, folder: bool = False) -> Path:
    """Create an empty file or folder that no other process has; a name in use gets `-2`, `-3`, and so on.

    Args:
        path: Wanted path; missing parents of a folder are created.
        folder: True: create a folder.

    Returns:
        The created path.

    Raises:
        OSError: If it cannot be created.
    """
    suffix = "" if folder else path.suffix
    stem, made, number = path.name.removesuffix(suffix), path, 1
    while True:
        try:
            if folder:
                made.mkdir(parents=True)
            else:
                made.touch(exist_ok=False)
        except FileExistsError:
            number += 1
            made = path.with_name(f"{stem}-{number}{suffix}")
        else:
            return made


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Add the file's name to an error raised while writing it: a full disk reports none."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def write_whole(
    path: Path,
    content: bytes,
    *,
    private: bool = False,
    fresh: bool = False,
    owner: tuple[int, int] | None = None,
) -> None:
    """Write a file atomically: write a temporary file in the same folder, then rename it.

    Args:
        path: The file.
        content: Content of the file.
        private: Make the file readable only by its owner, from its first byte on.
        fresh: Fail if the file exists; otherwise replace it.
        owner: User and group that become its owner.

    Raises:
        OSError: If it cannot be written; names the file.
    """
    beside = path.with_name(f"{path.name}.{secrets.token_hex(4)}{UNFINISHED}")
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    with writing(path):
        try:
            with os.fdopen(os.open(beside, flags, 0o600 if private else 0o666), "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
                if owner is not None:
                    os.fchown(file.fileno(), *owner)
            if fresh:
                os.link(beside, path)
            else:
                beside.replace(path)
        except OSError as error:
            error.filename = str(path)
            raise
        finally:
            beside.unlink(missing_ok=True)


def _too_large(path: Path, most: int) -> OSError:
    return OSError(errno.EFBIG, f"larger than {most / 2**20:g} MiB", str(path))
