"""Runs with real processes, for the tests: starting, watching, and cleaning up."""

import json
import random
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

from bus.credentials import read_credential
from bus.joining import open_session
from bus.keys import CONTROL, STATUS, Role
from bus.messages.control import Action, Control
from bus.messages.telemetry import Status
from bus.session import Session
from outrider.running import launch
from outrider.running.flying import fly
from outrider.running.parent import Output
from outrider.running.summary import Summary
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

OUTRIDER = [sys.executable, "-m", "outrider"]


def outrider(
    *arguments: str, timeout: float = 120.0, **settings: Any
) -> "subprocess.CompletedProcess[str]":
    """Run an outrider command and return its result.

    Args:
        arguments: Command-line arguments.
        timeout: Time limit [s].
        settings: Further arguments of `subprocess.Popen`.
    """
    with subprocess.Popen([*OUTRIDER, *arguments], **PIPES, **settings) as process:
        try:
            out, err = process.communicate(timeout=timeout)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(arguments, process.returncode, out, err)


PIPES: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}


def ran(
    command: Sequence[str | Path], *, check: bool = False, **settings: Any
) -> "subprocess.CompletedProcess[str]":
    """Run any command and return its result."""
    return subprocess.run(command, capture_output=True, text=True, check=check, **settings)


def python(
    code: str, *arguments: str, check: bool = True, **settings: Any
) -> "subprocess.CompletedProcess[str]":
    """Run code in a fresh interpreter and return its result."""
    done = ran([sys.executable, "-c", code, *arguments], **settings)
    assert not check or done.returncode == 0, done.stderr
    return done


def loaded_by(modules: str) -> set[str]:
    """Return all modules that a fresh interpreter loads to import these modules."""
    return set(python(f"import sys, {modules}; print(*sys.modules)").stdout.split())


def run_json(*arguments: str) -> dict[str, object]:
    run = outrider("run", *arguments, "--json", "--no-files")
    assert run.returncode == 0, run.stderr
    summary: dict[str, object] = json.loads(run.stdout)
    return summary


def flown_both_ways(
    name: str, *changes: str, seed: int | None = None
) -> tuple[dict[str, Any], Summary]:
    """Fly a run with three processes and in this one, check that the bits are the same, and return both summaries."""
    scenario = load_scenario(name, overrides=changes)
    seed = scenario.seed if seed is None else seed
    _, here = fly(scenario, seed)
    options = [word for change in changes for word in ("--set", change)]
    there = run_json(name, "--seed", str(seed), *options)
    assert there["trajectory_sha256"] == here.trajectory_sha256
    return there, here


SHORT = load_scenario("escort", overrides=["duration=1.0"])
"""The scenario of a run that this process launches."""


SILENT = launch.Watcher(
    on_tick=lambda _tick: None,
    on_event=lambda _line: None,
    on_warnings=lambda _lines: None,
    stop=lambda: 0,
)


def launched(
    watcher: launch.Watcher = SILENT, *, scenario: Scenario = SHORT, **settings: Any
) -> launch.Outcome:
    """Launch a run with three processes and return its outcome."""
    return launch.launch(scenario, watcher, Output(), **settings)


def children_of(pid: int) -> list[int]:
    """Return the children of a process, from the kernel's list."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    return [int(child) for child in text.split()]


def free_port() -> int:
    """Return a port of this machine on which no process listens, below those that systems give to clients."""
    for port in random.sample(range(20_000, 32_000), 100):
        with suppress(OSError), socket.socket() as probe:
            probe.bind(("127.0.0.1", port))
            return port
    raise OSError("no free port")


def kind_of(pid: int) -> str:
    """Return the outrider command of a process; empty for another program."""
    words = command_line(pid).split()
    return words[words.index("outrider") + 1] if "outrider" in words else ""


def family(pid: int) -> list[int]:
    """Return the started processes of a run."""
    return [child for child in children_of(pid) if kind_of(child)]


def stat_of(pid: int) -> list[str]:
    """Return the kernel's status of a process: state, parent, group, session, and more."""
    text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii")
    return text.rpartition(")")[2].split()


def alive(pid: int) -> bool:
    try:
        return stat_of(pid)[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_until(condition, seconds=30.0, failure=lambda: "waited in vain"):
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit, failure()
        time.sleep(0.02)


@contextmanager
def joined(run: "subprocess.Popen[str]", role: Role) -> Iterator[Session]:
    """Open a session of an observer or operator on the bus of a run."""
    words = command_line(child_of(run, "simulator")).split()
    endpoint, name = (words[words.index(option) + 1] for option in ("--listen", "--run"))
    path = Path(endpoint.removeprefix("unixsock-stream/"))
    wait_until(path.exists)
    credential = read_credential(path.with_name(f"{role.value}.json"))
    with open_session(credential.party, name, connect=endpoint, credential=credential) as session:
        yield session


def observing(run: "subprocess.Popen[str]") -> AbstractContextManager[Session]:
    """Open an observer's session on the bus of a run."""
    return joined(run, Role.OBSERVER)


def await_status(
    session: Session, wanted: Callable[[Status], Any], seconds: float = 60.0
) -> Status:
    """Return the first new status that fulfils a condition."""
    return status_in(session.inbox(STATUS), wanted, seconds)


def status_in(inbox: Any, wanted: Callable[[Status], Any], seconds: float) -> Status:
    """Return the first status in an inbox that fulfils a condition."""
    limit = time.monotonic() + seconds
    last: Status | None = None
    while time.monotonic() < limit:
        envelope = inbox.receive(1.0)
        if envelope is not None and isinstance(envelope.message, Status):
            last = envelope.message
            if wanted(last):
                return last
    raise AssertionError(f"never came; the last status was {last}")


def fly_to(operator: Session, tick: int) -> None:
    """Fly a run that has not started to this tick, pause it until that is confirmed, and resume it."""
    controls = operator.outbox(CONTROL)
    compiled = 180.0  # s: compiling from an empty cache, beside other tests
    wait_until(lambda: controls.wanted, compiled)  # the simulator receives controls
    controls.send(Control(action=Action.STEP, ticks=tick))
    await_status(operator, lambda status: status.paused and status.tick >= tick, compiled)
    controls.send(Control(action=Action.RESUME))
    # otherwise a dying router could lose the control
    await_status(operator, lambda status: not status.paused)


@contextmanager
def started(*arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """Run an outrider command in the background; kill it at the end."""
    process = subprocess.Popen([*OUTRIDER, *arguments], **PIPES)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        for stream in (process.stdout, process.stderr):
            if stream:
                stream.close()


@contextmanager
def flying(*arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a simulation in the background that has flown 20 ticks with all processes.

    It pauses at that tick until the test starts.
    """
    with started("run", *arguments) as run:
        wait_until(lambda: "simulator" in map(kind_of, family(run.pid)))
        with joined(run, Role.OPERATOR) as operator:
            fly_to(operator, 20)
            yield run


def command_line(pid: int) -> str:
    """Return the command line of a process, joined by blanks; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().rstrip(b"\0").replace(b"\0", b" ").decode()
    except (FileNotFoundError, ProcessLookupError):
        return ""


def child_of(run: "subprocess.Popen[str]", what: str) -> int:
    return next(pid for pid in family(run.pid) if kind_of(pid) == what)
