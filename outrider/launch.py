"""A run as three operating-system processes or more: started together, watched, and ended together."""

import contextlib
import os
import queue
import secrets
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import IO

import msgspec

from bus.errors import BusError, PeerLost
from bus.keys import SIMULATOR_NAME
from outrider.cores import keep_apart
from outrider.reports import Report
from outrider.summary import Process, Summary
from sim.scenario import Scenario, Uav

_PATIENCE = 10.0
"""How long a process may take to end when it was asked to [s]."""
_LAST_WORDS = 12
"""Lines of a child's standard error that are kept."""


class Child:
    """One process of the run, with its last words.

    Args:
        name: On the bus.
        arguments: Of the `outrider` command line.
        lines: Where its standard output goes, line by line; None is its end.
    """

    def __init__(self, name: str, arguments: Sequence[str], lines: "queue.SimpleQueue[bytes | None] | None" = None) -> None:
        self.name = name
        self._words: deque[str] = deque(maxlen=_LAST_WORDS)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "outrider", *arguments, "--leash"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL if lines is None else subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C reaches us alone; we end the children in order
        )
        self._readers = [threading.Thread(target=self._listen, args=(self._process.stderr,), daemon=True)]
        if lines is not None:
            self._readers.append(threading.Thread(target=self._pass_on, args=(self._process.stdout, lines), daemon=True))
        for reader in self._readers:
            reader.start()

    def _listen(self, stream: IO[bytes]) -> None:
        for line in stream:
            self._words.append(line.decode(errors="replace").rstrip())

    @staticmethod
    def _pass_on(stream: IO[bytes], lines: "queue.SimpleQueue[bytes | None]") -> None:
        for line in stream:
            lines.put(line)
        lines.put(None)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def ended(self) -> int | None:
        """Exit code, negative for a signal; None while it runs."""
        return self._process.poll()

    def last_words(self) -> str:
        """The end of what it wrote to standard error."""
        for reader in self._readers:
            reader.join(1.0)
        return " | ".join(word for word in self._words if word)

    def epitaph(self) -> str:
        """How it ended, for a person."""
        code = self.ended
        how = f"was killed by signal {-code}" if code is not None and code < 0 else f"ended with exit code {code}"
        words = self.last_words()
        return f"{self.name} (pid {self.pid}) {how}" + (f": {words}" if words else "")

    def ask_to_end(self) -> None:
        """SIGTERM, if it still runs."""
        if self.ended is None:
            self._process.terminate()

    def wait(self, patience: float) -> bool:
        """Whether it has ended within `patience` [s]."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)
        return self.ended is not None

    def kill(self) -> None:
        """SIGKILL, and wait for its end."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """Close our ends of its pipes."""
        for reader in self._readers:
            reader.join(1.0)
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()


@contextlib.contextmanager
def _private_folder() -> Iterator[Path]:
    """A folder for the run's socket that only this user can enter; gone afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="outrider-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def _family() -> Iterator[list[Child]]:
    """Children that are all gone afterwards."""
    children: list[Child] = []
    try:
        yield children
    finally:
        for child in children:
            child.ask_to_end()
        limit = time.monotonic() + _PATIENCE
        for child in children:
            if not child.wait(max(0.1, limit - time.monotonic())):
                child.kill()
            child.close()


class Outcome(msgspec.Struct, kw_only=True):
    """How a run ended."""

    summary: Summary | None = None
    files: list[Path] = []
    fault: str = ""
    """Why it ended early, for a person; empty if it did not."""


def launch(
    scenario: Scenario,
    source: str,
    overrides: Sequence[str],
    *,
    out: Path | None,
    picture: bool = True,
    deadline: float = 10.0,
    join_timeout: float = 120.0,
    pin: bool = True,
    on_tick: Callable[[int], None],
    on_event: Callable[[str], None],
    stop: Callable[[], int],
) -> Outcome:
    """Fly a scenario as one process for the simulator and one for each vehicle, over Zenoh on a private socket.

    Args:
        scenario: What is flown.
        source: The same as a name or file, for the simulator's process.
        overrides: The same as `--set` arguments.
        out: Where the simulator writes.
        picture: Whether it draws.
        deadline: How long it waits for the commands of one tick [s].
        join_timeout: How long it waits for the vehicles [s].
        pin: Whether the UAVs keep to one half of the processor cores and the others to the other half.
        on_tick: Called with the tick, some times a second.
        on_event: Called with a line for a person.
        stop: How often somebody has asked for the end: once ends the run in order, twice at once.

    Returns:
        The summary of what was flown, if anything was; and the fault that ended it early.
    """
    with _private_folder() as folder, _family() as children:
        endpoint = f"unixsock-stream/{folder / 'bus.sock'}"
        run = f"run-{os.getpid()}-{secrets.token_hex(4)}"
        lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        settings = [argument for override in overrides for argument in ("--set", override)]
        output = ["--out", str(out)] if out else []
        drawing = [] if picture else ["--no-picture"]
        leash = ["--leash-folder", str(folder)]
        timing = ["--deadline", str(deadline), "--join-timeout", str(join_timeout)]
        simulator_arguments = [
            "simulator",
            source,
            "--listen",
            endpoint,
            "--run",
            run,
            "--events",
            *settings,
            *output,
            *drawing,
            *timing,
            *leash,
        ]
        children.append(Child(SIMULATOR_NAME, simulator_arguments, lines))
        _wait_for_socket(folder / "bus.sock", children[0], stop)
        if not stop():
            children += [Child(v.name, _vehicle_arguments(v.name, scenario, endpoint, run)) for v in scenario.vehicles]
            if pin:
                uavs = {uav.name for uav in scenario.uav}
                keep_apart({child.pid: child.name in uavs for child in children})
        outcome = _follow(children, lines, on_tick, on_event, stop)
        if outcome.summary is not None:
            for child in children:
                child.wait(2.0 if outcome.summary.complete else 0.5)
            who = [Process(name=child.name, pid=child.pid) for child in children]
            outcome.summary = msgspec.structs.replace(outcome.summary, processes=who)
        return outcome


def _vehicle_arguments(name: str, scenario: Scenario, endpoint: str, run: str) -> list[str]:
    common = ["--name", name, "--connect", endpoint, "--run", run]
    if any(isinstance(v, Uav) and v.name == name for v in scenario.vehicles):
        own = [("--weighting", scenario.custom.weighting), ("--path", scenario.custom.path)]
        return ["uav", *common, *(argument for option, value in own if value for argument in (option, value))]
    return ["ugv", *common]


def _wait_for_socket(path: Path, simulator: Child, stop: Callable[[], int]) -> None:
    """Until the router listens: before that a client would only try in vain."""
    while not path.exists() and simulator.ended is None and not stop():
        time.sleep(0.02)


def _follow(
    children: list[Child],
    lines: "queue.SimpleQueue[bytes | None]",
    on_tick: Callable[[int], None],
    on_event: Callable[[str], None],
    stop: Callable[[], int],
) -> Outcome:
    """Until the simulator's process has ended, whoever made it end."""
    simulator, outcome, asked = children[0], Outcome(), False
    while True:
        if stop() and not asked:
            asked = True
            simulator.ask_to_end()
        if stop() > 1:
            raise BusError("killed before the end")
        if not asked and outcome.summary is None:
            dead = next((child for child in children[1:] if child.ended is not None), None)
            if dead is not None and _has_ended_early(dead, lines, outcome, on_tick, on_event):
                outcome.fault = dead.epitaph()
                asked = True
                simulator.ask_to_end()
        with contextlib.suppress(queue.Empty):
            line = lines.get(timeout=0.1)
            if line is None:
                break
            _read(line, outcome, on_tick, on_event)
    simulator.wait(_PATIENCE)
    if outcome.summary is None and not outcome.fault and not stop():
        raise PeerLost(simulator.epitaph())
    if simulator.ended not in (0, None) and not stop() and not outcome.fault:
        outcome.fault = simulator.last_words() or simulator.epitaph()
    return outcome


def _has_ended_early(
    child: Child,
    lines: "queue.SimpleQueue[bytes | None]",
    outcome: Outcome,
    on_tick: Callable[[int], None],
    on_event: Callable[[str], None],
) -> bool:
    """Whether a vehicle's process that has ended did so before the run was over; the last report may be on its way."""
    if child.ended != 0:
        return True
    with contextlib.suppress(queue.Empty):
        while outcome.summary is None:
            line = lines.get(timeout=_PATIENCE)
            if line is None:
                lines.put(None)
                break
            _read(line, outcome, on_tick, on_event)
    return outcome.summary is None


def _read(line: bytes, outcome: Outcome, on_tick: Callable[[int], None], on_event: Callable[[str], None]) -> None:
    report = msgspec.json.decode(line, type=Report)
    if report.tick is not None:
        on_tick(report.tick)
    if report.event is not None:
        on_event(report.event)
    if report.summary is not None:
        outcome.summary = report.summary
    if report.files is not None:
        outcome.files = [Path(file) for file in report.files]
