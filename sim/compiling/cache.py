"""Files of the compile cache: checked before their first use.

numba reads and writes them without a check, and any failure ends the process: an empty file after a crash, a full disk.
Each process therefore records the checksums of new files when it ends. The first process that opens the folder removes
all other files, which costs a recompilation. Processes that open it meanwhile trust the files of those still alive.
"""

import atexit
import contextlib
import errno
import fcntl
import os
import pickle
import shutil
import tempfile
import traceback
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numba

from bus.files import write_whole

_SUMS, _LOCK = "checksums", "lock"
_WHOLE, _LEAST = 32 * 2**20, 4 * 2**20
"""Size of a filled cache, and space that must be left beside a filled one [bytes]."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_NUMBA = os.path.dirname(numba.__file__) + os.sep


class _Sum(NamedTuple):
    """Checksum of a file; size and time show whether it has been written again since."""

    checksum: int
    size: int
    mtime: int
    """Time of the last change [ns]."""


def open_cache(folder: Path) -> int:
    """Open the folder for this process, and create it if necessary; return the number of damaged files removed.

    Raises:
        OSError: If it cannot be used, or its disk is full.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = (folder / _LOCK).open("ab")
    atexit.register(lock.close)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        removed = _remove_damaged(folder)
    except BlockingIOError:
        removed = 0
    fcntl.flock(lock, fcntl.LOCK_SH)  # waits while another process removes files
    _check_space(folder)
    os.utime(folder)
    atexit.register(_record, folder)
    return removed


def failure_in_numba(error: BaseException | None) -> str:
    """Describe a failure of numba to read or write a file; empty if the error is another one."""
    while error is not None:
        if isinstance(error, OSError | EOFError | pickle.UnpicklingError) and any(
            frame.filename.startswith(_NUMBA) for frame in traceback.extract_tb(error.__traceback__)
        ):
            reason = error.strerror if isinstance(error, OSError) else None
            return reason or f"{type(error).__name__}: {error}"
        error = error.__cause__ or error.__context__
    return ""


def _files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield each file of the cache, which has folders of one level, with its name.

    Raises:
        PermissionError: If a folder cannot be read or written: numba would use another one.
    """
    for entry in sorted(os.scandir(folder), key=lambda one: one.name):
        if not entry.is_dir(follow_symlinks=False):
            if entry.name not in (_SUMS, _LOCK):
                yield entry.name, Path(entry.path)
            continue
        if not os.access(entry.path, os.R_OK | os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), entry.path)
        for name in sorted(os.listdir(entry.path)):
            yield f"{entry.name}/{name}", Path(entry.path, name)


def _sum_of(path: Path) -> _Sum | None:
    """Return the checksum of a file; None if it cannot be read."""
    with contextlib.suppress(OSError):
        if path.is_file():
            status = path.stat()
            return _Sum(zlib.crc32(path.read_bytes()), status.st_size, status.st_mtime_ns)
    return None


def _content(folder: Path) -> bytes:
    try:
        return (folder / _SUMS).read_bytes()
    except OSError:
        return b""


def _sums(folder: Path) -> dict[str, _Sum]:
    """Return the recorded checksums; skip damaged lines."""
    found: dict[str, _Sum] = {}
    for line in _content(folder).decode(errors="replace").splitlines():
        *numbers, name = line.split(" ", 3)
        with contextlib.suppress(TypeError, ValueError):
            found[name] = _Sum(*map(int, numbers))
    return found


def _lines(sums: dict[str, _Sum]) -> bytes:
    rows = (f"{one.checksum} {one.size} {one.mtime} {name}\n" for name, one in sums.items())
    return "".join(rows).encode()


def _remove_damaged(folder: Path) -> int:
    sums = _sums(folder)
    good: dict[str, _Sum] = {}
    damaged = 0
    for name, path in _files(folder):
        known, found = sums.get(name), _sum_of(path)
        if known is not None and found is not None and found[:2] == known[:2]:
            good[name] = found
        else:
            _remove(path)
            damaged += known is not None
    if _content(folder) != _lines(good):
        write_whole(folder / _SUMS, _lines(good))
    return damaged


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _record(folder: Path) -> None:
    """Append the checksums of all new files."""
    with contextlib.suppress(OSError), (folder / _SUMS).open("ab", buffering=0) as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # processes of a run end together
        sums, new = _sums(folder), dict[str, _Sum]()
        for name, path in _files(folder):
            status = path.stat()
            if sums.get(name, ())[1:] != (status.st_size, status.st_mtime_ns):
                found = _sum_of(path)
                if found is not None:
                    new[name] = found
        file.write(_lines(new))


def _check_space(folder: Path) -> None:
    """Check that the disk has room for what is not compiled yet, and the user may fill it."""
    present = sum(path.stat().st_size for _, path in _files(folder) if path.is_file())
    needed = max(_LEAST, _WHOLE - present)
    free = shutil.disk_usage(folder).free
    if free < needed:
        text = f"{free / 2**20:.0f} MiB free; {needed / 2**20:.0f} MiB needed"
        raise OSError(errno.ENOSPC, text, str(folder))
    with tempfile.TemporaryFile(dir=folder.parent) as file:
        try:
            os.posix_fallocate(file.fileno(), 0, _LEAST)
        except OSError as error:
            if error.errno in _FULL:  # a quota, or a limit of this process
                raise OSError(error.errno, os.strerror(error.errno), str(folder)) from error
