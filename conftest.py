"""Fixtures that several test modules use."""

import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from bus import joining
from outrider.cli import main
from processes import wait_until

signal.signal(signal.SIGINT, signal.default_int_handler)
"""A shell that starts the tests in the background ignores it, and every process of a test would inherit that."""

FIRST = (
    *("assurance", "estimator_late", "fuzz_decoders", "bus", "attack"),
    *("faults", "dashboard_run", "falsify", "sweep", "rogue", "suite"),
)
"""The first test files, in this order. What takes long comes before what is short, which fills the end of the run.
With two workers the one compiles pilots and world while the other tests what needs nothing compiled; then the one
compiles the closed loop and the other the attack: little is compiled twice."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Order the files."""
    ranks = {f"test_{name}.py": rank for rank, name in enumerate(FIRST)}
    items.sort(key=lambda item: ranks.get(item.path.name, len(FIRST)))


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
            failure=lambda: f"left behind: {[str(path) for path in Path(folder).rglob('*')]}",
        )


@pytest.fixture
def command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., "CompletedProcess[str]"]:
    """A command of ours in this process, which need not start: its exit code and what it wrote."""

    def call(*arguments: object) -> "CompletedProcess[str]":
        monkeypatch.setattr(sys, "argv", ["outrider", *map(str, arguments)])
        monkeypatch.setenv("PYTHONSAFEPATH", "")  # which it sets
        monkeypatch.setattr(sys, "path", [*sys.path])  # a user's code adds its folder
        before = signal.getsignal(signal.SIGTERM)
        try:
            code = main.run_command_line()
        finally:
            signal.signal(signal.SIGTERM, before)
        written = capsys.readouterr()
        return CompletedProcess(arguments, code, written.out, written.err)

    return call


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the test works."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def endpoint(tmp_path: Path) -> str:
    """Endpoint of a router that listens in the test's folder."""
    return f"unixsock-stream/{tmp_path / 'bus.sock'}"


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A refused client shows it by trying in vain; here not for long."""
    monkeypatch.setitem(joining._CLIENT, "connect/timeout_ms", 600)
