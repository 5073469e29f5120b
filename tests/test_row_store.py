"""Rows of a long run, in a file, or in memory if the disk is full."""

import os

import numpy as np
import pytest

from sim.server.row_store import RowStore


@pytest.mark.parametrize("full", [(), (1,), (2,), (1, 2, 3, 4), (3,)])
def test_no_row_is_lost_whenever_the_disk_is_full(
    full: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    allocate, growth = os.posix_fallocate, 0

    def sometimes(*given: int) -> None:
        if growth in full:
            raise OSError(28, "No space left on device")
        allocate(*given)

    monkeypatch.setattr(os, "posix_fallocate", sometimes)
    store = RowStore(4, (2,))
    for row in range(20):
        if row == len(store.array):
            growth += 1
            store.grow()
        store.array[row] = row
    assert store.array.shape == (20, 2)
    assert np.array_equal(store.array[:, 0], np.arange(20.0))
