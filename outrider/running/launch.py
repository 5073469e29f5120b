"""A run as three operating-system processes or more: started together, watched, and ended together."""

import contextlib
import functools
import os
import queue
import secrets
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec

from bus.credentials import new_credentials, write_credential
from bus.errors import PeerLost
from bus.keys import OBSERVER_NAME, OPERATOR_NAME, SIMULATOR_NAME
from bus.locator import UNIX
from bus.registry import DRIVERS
from outrider.running.child import Child
from outrider.running.companions import Beside, Companions
from outrider.running.exit_reports import Report
from outrider.running.parent import Output, Start
from outrider.running.run_folder import run_folder
from outrider.running.summary import Process, Summary
from sim.scenario.resolved import as_toml
from sim.scenario.types import Scenario, Uav, Ugv

_HELD = 3.0
"""Time for which an event before the first tick waits [s]: it is not told if a vehicle's own error ends the run."""
_PATIENCE = 10.0
"""Time that a process may take to end when it was asked to [s]."""
_UNUSABLE = 2
"""Exit code of a process that cannot use what the user has given."""
_LIVES = 3
"""A process that dies more often than this while the clock stands still is not started again."""


@contextlib.contextmanager
def _ended_afterwards() -> Iterator[list[Child]]:
    """Children that are all ended afterwards."""
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
    """The end of a run."""

    summary: Summary | None = None
    files: list[Path] = []
    fault: str = ""
    """The failure on the way, for a person; empty where nothing did."""
    unusable: bool = False
    """True: the failure is that what the user has given cannot be flown."""


class Watcher(msgspec.Struct, frozen=True, kw_only=True):
    """Callbacks of whoever follows a run, and can end it."""

    on_tick: Callable[[int], None]
    """Called with the tick, some times a second."""
    on_event: Callable[[str], None]
    """Called with a line for a person."""
    on_warnings: Callable[[Sequence[str]], None]
    """Called with what stands in the way of the scenario's promise, a line each."""
    stop: Callable[[], int]
    """Counts who has asked for the end: once ends the run in order, twice at once."""
    companions: tuple[Beside, ...] = ()
    """Commands that run beside the run."""


def launch(
    scenario: Scenario,
    watcher: Watcher,
    output: Output,
    *,
    secret: str = "",
) -> Outcome:
    """Fly a scenario as one process for the simulator and one for each vehicle, over Zenoh on a private socket.

    Each process has credentials of its own, made for this run alone and gone with it. The scenario is written into the
    run's private folder, where the simulator reads it; no vehicle is told of the file, which holds goals and seed.

    Args:
        scenario: What is flown, with all options applied.
        watcher: Who follows the run.
        output: What is written.
        secret: Of the run, for the simulator's process alone; empty: none.

    Returns:
        The summary of what was flown, if anything was; and the fault that ended it early.
    """
    with run_folder() as folder, _ended_afterwards() as beside, _ended_afterwards() as children:
        run = f"run-{os.getpid()}-{secrets.token_hex(4)}"
        logs = Path(output.folder, "logs") if output.folder else None
        processes = _Processes(scenario, folder, run, children, watcher, logs)
        processes.start_simulator(output, secret)
        unready = processes.start_companions(beside)
        if unready is not None:
            fault = unready.position_error() or unready.exit_report()
            unready.drop_log()
            return Outcome(fault=fault, unusable=unready.ended == _UNUSABLE)
        if not watcher.stop():
            processes.start_vehicles()
        outcome = _follow(processes, watcher, respawn=scenario.run.respawn)
        processes.companions.await_end_shown()
        if outcome.summary is not None:
            for child in children:
                child.wait(2.0 if outcome.summary.complete else 0.5)
            if (
                not watcher.stop() and not scenario.run.respawn
            ):  # one may have failed just before the end
                failed = [child.exit_report() for child in children[1:] if child.ended]
                outcome.fault = outcome.fault or next(iter(failed), "")
            who = [Process(name=child.name, pid=child.pid) for child in children]
            outcome.summary = msgspec.structs.replace(outcome.summary, processes=who)
        return outcome


def _is_outside(vehicle: Uav | Ugv) -> bool:
    """Return whether the user starts this vehicle's process."""
    return isinstance(vehicle, Ugv) and DRIVERS[vehicle.driver].outside


class _Processes:
    """The run's processes, the simulator's first.

    Args:
        scenario: What is flown.
        folder: The run's private folder.
        run: Its name.
        children: Where they are kept, so that they are ended whatever happens.
        watcher: Who follows the run, and is told what the processes warn of.
        logs: The folder for what each writes to standard error; None: it is not kept.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        run: str,
        children: list[Child],
        watcher: Watcher,
        logs: Path | None,
    ) -> None:
        self.children = children
        self._watcher = watcher
        self._logs = logs
        self.lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        """Reports of the simulator, a line each."""
        self._scenario, self._folder, self._run = scenario, folder, run
        self._endpoint = f"{UNIX}/{folder / 'bus.sock'}"
        self._uavs = [uav.name for uav in scenario.uav]
        self.companions = Companions(watcher.on_event)
        ugvs = [ugv.name for ugv in scenario.ugv]
        own = [vehicle.name for vehicle in scenario.vehicles if _is_outside(vehicle)]
        self._credentials = new_credentials(run, self._uavs, ugvs)
        self._files = {
            name: folder / f"{name}.json" for name in (OPERATOR_NAME, OBSERVER_NAME, *own)
        }
        """Credentials of parties that are no children of ours: they read them from a file."""
        for name, path in self._files.items():
            write_credential(self._credentials.of(name), path)

    @property
    def simulator(self) -> Child:
        """The simulator's process."""
        return self.children[0]

    def _log(self, name: str) -> Path | None:
        return self._logs / f"{name}.log" if self._logs is not None else None

    def _joining(self) -> list[str]:
        """Return the options by which a client finds the router."""
        return ["--connect", self._endpoint, "--run", self._run]

    def start_simulator(self, output: Output, secret: str) -> None:
        """Start it; clients wait until its router listens."""
        file = self._folder / "scenario.toml"
        file.write_text(as_toml(self._scenario), encoding="utf-8")
        arguments = ["simulator", str(file), "--listen", self._endpoint, "--run", self._run]
        start = Start(
            credentials=self._credentials, secret=secret, folder=str(self._folder), output=output
        )
        self.children.append(
            Child(
                SIMULATOR_NAME,
                arguments,
                start,
                lines=self.lines,
                log=self._log(SIMULATOR_NAME),
                on_warning=self._watcher.on_event,
            )
        )

    def start_companions(self, started: list[Child]) -> Child | None:
        """Start the companions, and wait until they are ready; return the first that fails."""
        for name, words, _ in self._watcher.companions:
            self.companions.add(functools.partial(self._start_companion, name, words, started))
        return self.companions.failed_before_ready(
            lambda: bool(self._watcher.stop()) or self.simulator.ended is not None
        )

    def _start_companion(
        self,
        name: str,
        words: Sequence[str],
        started: list[Child],
        lines: "queue.SimpleQueue[bytes | None]",
    ) -> Child:
        child = Child(
            name,
            [name, *self._joining(), *words],
            Start(credential=self._credentials.of(OPERATOR_NAME), law=self._scenario.law),
            lines=lines,
            log=self._log(name),
            companion=True,
            on_warning=self._watcher.on_event,
        )
        started.append(child)
        return child

    def _start(self, name: str) -> Child:
        custom, is_uav = self._scenario.custom, name in self._uavs
        fields = ("weighting", "path", "uav_policy") if is_uav else ("policy",)
        start = Start(
            credential=self._credentials.of(name),
            join_timeout=self._scenario.run.join_timeout,
            code={field: getattr(custom, field) for field in fields},
        )
        return Child(
            name,
            ["uav" if is_uav else "ugv", "--name", name, *self._joining()],
            start,
            log=self._log(name),
            on_warning=self._watcher.on_event,
        )

    def start_vehicles(self) -> None:
        """Start a process for each, and say what one of the user's own needs to know."""
        for vehicle in self._scenario.vehicles:
            if _is_outside(vehicle):
                joining = " ".join(self._joining())
                known = f"--name {vehicle.name} --credentials {self._files[vehicle.name]}"
                self._watcher.on_event(f"{vehicle.name} is yours: {joining} {known}")
            else:
                self.children.append(self._start(vehicle.name))

    def start_again(self, dead: Child) -> None:
        """Put a new process in the place of one that has ended."""
        place = self.children.index(dead)
        dead.close()
        self.children[place] = self._start(dead.name)


def _follow(processes: _Processes, watcher: Watcher, *, respawn: bool) -> Outcome:
    """Follow the run until the simulator's process has ended."""
    simulator, followed = processes.simulator, _Followed(processes, watcher, respawn=respawn)
    outcome, asked = followed.outcome, False
    while True:
        if watcher.stop() > 1:
            raise KeyboardInterrupt  # who asks twice does not wait for a summary
        if not asked and (watcher.stop() or followed.must_end()):
            asked = True
            simulator.ask_to_end()
        followed.show_events()
        with contextlib.suppress(queue.Empty):
            line = processes.lines.get(timeout=0.1)
            if line is None:
                break
            followed.read(line)
    followed.show_events(all_of_them=True)
    simulator.wait(_PATIENCE)
    if outcome.summary is None and not outcome.fault and not watcher.stop():
        raise PeerLost(simulator.exit_report())
    if simulator.ended not in (0, None) and not watcher.stop() and not outcome.fault:
        outcome.fault = simulator.stderr_tail() or simulator.exit_report()
    return outcome


class _Followed:
    """State of a run that is followed.

    Args:
        processes: Processes of the run.
        watcher: Receives ticks, events and warnings.
        respawn: True: a vehicle's process that fails is started again.
    """

    def __init__(self, processes: _Processes, watcher: Watcher, *, respawn: bool) -> None:
        self.outcome = Outcome()
        self._processes, self._watcher, self._respawn = processes, watcher, respawn
        self._tick = 0
        self._deaths = Counter[str]()
        """Failures of each vehicle's process since the newest tick."""
        self._counted: set[int] = set()
        self._events: deque[tuple[float, str]] = deque()
        """Events that wait, and the time at which each is shown."""
        self._is_dropping_events = False

    def read(self, line: bytes) -> None:
        """Read one of the simulator's reports."""
        report = msgspec.json.decode(line, type=Report)
        if report.tick is not None:
            if report.tick > self._tick:
                self._deaths.clear()
            self._tick = report.tick
            self._watcher.on_tick(report.tick)
        if report.event is not None and not self._is_dropping_events:
            held = 0.0 if self._tick else _HELD
            self._events.append((time.monotonic() + held, report.event))
        if report.warnings is not None:
            self._watcher.on_warnings(report.warnings)
        if report.summary is not None:
            self.outcome.summary = report.summary
        if report.files is not None:
            self.outcome.files = [Path(file) for file in report.files]

    def show_events(self, *, all_of_them: bool = False) -> None:
        """Show the events whose time has come."""
        while self._events and (all_of_them or time.monotonic() >= self._events[0][0]):
            self._watcher.on_event(self._events.popleft()[1])

    def must_end(self) -> bool:
        """Report processes that have failed, start vehicles again; return true if the run must end for one."""
        if self.outcome.summary is not None:
            return False
        self._processes.companions.report_lost()
        dead = [
            child
            for child in self._processes.children[1:]
            if child.ended not in (None, 0) and child.pid not in self._counted
        ]
        fatal = [self._is_fatal(child) for child in dead]  # each is reported
        return any(fatal)

    def _is_fatal(self, dead: Child) -> bool:
        self._counted.add(dead.pid)
        self._deaths[dead.name] += 1
        deaths, outcome = self._deaths[dead.name], self.outcome
        own = dead.position_error()
        if own and not self._respawn and self._tick == 0:
            outcome.fault, outcome.unusable = own, dead.ended == _UNUSABLE
            dead.drop_log()
            self._events.clear()
            self._is_dropping_events = True
            return True
        report = dead.exit_report()
        if self._respawn and deaths <= _LIVES:
            self._watcher.on_event(f"{report}: started again")
            self._processes.start_again(dead)
            return False
        if self._respawn:
            report += f"; for the {deaths}th time at tick {self._tick}, and it is not started again"
        self._watcher.on_event(report)
        outcome.fault = outcome.fault or report
        return self._respawn or self._tick == 0
