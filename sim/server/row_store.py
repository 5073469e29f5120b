"""Rows that grow in an unnamed file, so that the old ones of a long flight need not stay in memory."""

import mmap
import os
import tempfile
import weakref
from typing import IO

import numpy as np

from sim.compiling.compile import FloatArray


class RowStore:
    """An array of rows that grows; from the first growth on it lies in a file, if the disk has room.

    Args:
        rows: Room at first, and so much more each time.
        shape: Of one row.
    """

    def __init__(self, rows: int, shape: tuple[int, ...]) -> None:
        self.array: FloatArray = np.empty((rows, *shape))
        """Shape (rows, *shape). Another one after each growth; older ones keep what they have."""
        self._more = rows
        self._file: IO[bytes] | None = None
        self._disk = True
        """Whether the disk had room so far; once it was full, all rows stay in memory."""

    def grow(self) -> None:
        """Make room for more rows."""
        old, rows = self.array, len(self.array) + self._more
        if self._disk and old[:1].nbytes:
            try:
                self._grow_in_file(rows)
            except OSError:  # a full disk: the flight goes on in memory
                self._disk = False
            else:
                return
        self.array = np.empty((rows, *old.shape[1:]))
        self.array[: len(old)] = old

    def _grow_in_file(self, rows: int) -> None:
        old, first = self.array, self._file is None
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - open for as long as the store lives
            weakref.finalize(self, self._file.close)
        size = rows * old[:1].nbytes
        os.posix_fallocate(self._file.fileno(), 0, size)
        content = mmap.mmap(self._file.fileno(), size)
        self.array = np.ndarray((rows, *old.shape[1:]), np.float64, content)
        if first:
            self.array[: len(old)] = old
