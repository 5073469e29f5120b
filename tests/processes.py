"""Runs with real processes, for the tests: starting them, looking at them, and what they leave behind."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bus.access import read_credential
from bus.keys import STATUS, Party, Role
from bus.messages import Status
from bus.session import Session, open_session

OUTRIDER = [sys.executable, "-m", "outrider"]


def outrider(*arguments: str, timeout: float = 120.0) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [*OUTRIDER, *arguments], capture_output=True, text=True, check=False, timeout=timeout
    )


def run_json(*arguments: str) -> dict[str, object]:
    run = outrider("run", *arguments, "--json", "--no-files")
    assert run.returncode == 0, run.stderr
    summary: dict[str, object] = json.loads(run.stdout)
    return summary


def family(pid: int) -> list[int]:
    """Children of a process, by the kernel's own list."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    return [int(child) for child in text.split()]


def alive(pid: int) -> bool:
    try:
        return (
            "Z"
            not in Path(f"/proc/{pid}/stat")
            .read_text(encoding="ascii")
            .rsplit(")", 1)[1]
            .split()[0]
        )
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_until(
    condition: Callable[[], bool],
    seconds: float = 30.0,
    told: Callable[[], str] = lambda: "waited in vain",
) -> None:
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, told()
        time.sleep(0.02)


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


@contextmanager
def observing(run: "subprocess.Popen[str]") -> Iterator[Session]:
    """An observer's session on the bus of a run."""
    words = command_line(child_of(run, "simulator")).split()
    endpoint, name, known = (
        words[words.index(option) + 1] for option in ("--listen", "--run", "--credentials")
    )
    wait_until(lambda: Path(endpoint.removeprefix("unixsock-stream/")).exists())
    credential = read_credential(Path(known).with_name("observer.json"))
    with open_session(
        Party(role=Role.OBSERVER, name="observer"), name, connect=endpoint, credential=credential
    ) as session:
        yield session


def await_status(
    session: Session, wanted: Callable[[Status], bool], seconds: float = 60.0
) -> Status:
    """The first status that is as wanted."""
    inbox = session.inbox(STATUS)
    limit = time.monotonic() + seconds
    last: Status | None = None
    while time.monotonic() < limit:
        letter = inbox.receive(1.0)
        if letter is not None and isinstance(letter.message, Status):
            last = letter.message
            if wanted(last):
                return last
    raise AssertionError(f"never came; the last status was {last}")


@contextmanager
def flying(*arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """A run in the background that is under way: all its children are there and it has flown for a moment."""
    run = subprocess.Popen(
        [*OUTRIDER, "run", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        wait_until(lambda: len(family(run.pid)) == 3)
        with observing(run) as session:
            await_status(session, lambda status: status.tick > 20)
        yield run
    finally:
        if run.poll() is None:
            run.kill()
            run.wait()
        for stream in (run.stdout, run.stderr):
            if stream:
                stream.close()


def command_line(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()


def blocks(pid: int, number: int) -> bool:
    """Whether a process has blocked a signal."""
    status = dict(
        line.split(":\t", 1)
        for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    )
    return bool(int(status["SigBlk"], 16) >> (number - 1) & 1)


def child_of(run: "subprocess.Popen[str]", what: str) -> int:
    return next(pid for pid in family(run.pid) if f" outrider {what} " in command_line(pid))
