"""Files: reading those that others may have made, and writing.

Read are regular ones alone, and none that is larger than it can have reason to be.
"""

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


def open_regular(path: Path, most: int | None = None) -> BinaryIO:
    """Open a file for reading, without waiting at a FIFO and without reading a device.

    Args:
        path: The file.
        most: Its largest size [bytes]; None: any.

    Raises:
        OSError: If it cannot be opened, is no regular file, or is larger.
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
    """The content of a file; otherwise as `open_regular`."""
    with open_regular(path, most) as file:
        content = file.read(most + 1)  # it may grow meanwhile
    if len(content) > most:
        raise _too_large(path, most)
    return content


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Let an error while a file is written name it: a disk that is full knows no file, nor does a write that fails."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def _too_large(path: Path, most: int) -> OSError:
    return OSError(errno.EFBIG, f"larger than {most / 2**20:g} MiB", str(path))
