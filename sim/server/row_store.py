"""Growing array of rows in an unnamed file, so that old rows of a long run need no memory."""

import mmap
import os
import tempfile
import weakref
from typing import IO

import numpy as np

from sim.compiling.compile import FloatArray


class RowStore:
    """Array of rows that grows; after the first growth it is stored in a file if the disk has space.

    Args:
        rows: Initial capacity, and increment of each growth.
        shape: Shape of one row.
    """

    def __init__(self, rows: int, shape: tuple[int, ...]) -> None:
        self.array: FloatArray = np.empty((rows, *shape))
        """Shape (rows, *shape). Each growth replaces the array; older arrays keep their content."""
        self._more = rows
        self._file: IO[bytes] | None = None
        self._disk = True
        """False once the disk was full: all rows then stay in memory."""

    def grow(self) -> None:
        """Increase the capacity."""
        old, rows = self.array, len(self.array) + self._more
        if self._disk and old[:1].nbytes:
            try:
                self._grow_in_file(rows)
            except OSError:  # a full disk: continue in memory
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
