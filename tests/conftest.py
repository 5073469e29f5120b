"""Fixtures that several test modules use."""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import wait_until


@pytest.fixture
def nothing_left_behind(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Each test has a folder for temporary things of its own, which must be empty in the end.

    Its path is short, for sockets.
    """
    with tempfile.TemporaryDirectory(prefix="o-") as folder:
        monkeypatch.setenv("TMPDIR", folder)
        yield
        wait_until(
            lambda: not os.listdir(folder),
            told=lambda: f"left behind: {[str(path) for path in Path(folder).rglob('*')]}",
        )
