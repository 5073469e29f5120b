"""Run in several operating-system processes, which are started, watched and ended together."""

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
from bus.errors import PeerLost, ScenarioError
from bus.keys import OBSERVER_NAME, OPERATOR_NAME, SIMULATOR_NAME
from bus.locator import UNIX, reachable
from bus.registry import DRIVERS
from outrider.running.child import Child
from outrider.running.companions import Beside, Companions
from outrider.running.exit_reports import Report
from outrider.running.listening import PRIVATE, Listening
from outrider.running.parent import Output, Start
from outrider.running.run_folder import run_folder
from outrider.running.summary import Process, Summary
from sim.scenario.resolved import as_toml
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav, Ugv

_EVENT_DELAY = 3.0
"""Delay of an event before the first tick [s]: it is dropped if a vehicle's error ends the run."""
_PATIENCE = 10.0
"""Longest wait for a process to exit after a request [s]."""
_UNUSABLE = 2
"""Exit code of a process that rejects the user's input."""
_MAX_RESTARTS = 3
"""Largest number of restarts of a process without progress of simulated time."""


@contextlib.contextmanager
def _ended_afterwards() -> Iterator[list[Child]]:
    """Yield a list of children, and end them all afterwards."""
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
    """Result of a run."""

    summary: Summary | None = None
    files: list[Path] = []
    fault: str = ""
    """Description of the failure; empty: none."""
    unusable: bool = False
    """True if the user's input cannot be flown."""


class Watcher(msgspec.Struct, frozen=True, kw_only=True):
    """Callbacks that follow a run and may end it."""

    on_tick: Callable[[int], None]
    """Called with the current tick, several times per second."""
    on_event: Callable[[str], None]
    """Called with a line for the user."""
    on_warnings: Callable[[Sequence[str]], None]
    """Called with warnings about assumptions of the scenario's certificates, one line each."""
    stop: Callable[[], int]
    """Return the number of requests to stop: 1 ends the run in order, 2 ends it at once."""
    companions: tuple[Beside, ...] = ()
    """Companions that run beside the run."""


def launch(
    scenario: Scenario,
    watcher: Watcher,
    output: Output,
    *,
    secret: str = "",
    listening: Listening = PRIVATE,
) -> Outcome:
    """Fly a scenario with one process for the simulator and one for each vehicle, over Zenoh on a private socket.

    Each process has its own credentials; unless given, they are made for this run and deleted afterwards. The simulator
    reads the scenario from the run's private folder. Vehicles never learn of this file, which holds goals and seed.

    Args:
        scenario: Scenario to fly, with all options applied.
        watcher: Callbacks that follow the run.
        output: Files to write.
        secret: Secret of the run, passed to the simulator's process only; empty: none.
        listening: Further endpoints of the router, and the credentials that it accepts.

    Returns:
        The summary, if any tick was flown, and the failure that ended the run early.
    """
    with run_folder() as folder, _ended_afterwards() as beside, _ended_afterwards() as children:
        logs = Path(output.folder, "logs") if output.folder else None
        processes = _Processes(scenario, folder, listening, children, watcher, logs)
        processes.start_simulator(output, secret)
        unready = processes.start_companions(beside)
        if unready is not None:
            fault = unready.error_line() or unready.exit_report()
            unready.drop_log()
            return Outcome(fault=fault, unusable=unready.ended == _UNUSABLE)
        if not watcher.stop():
            processes.tell_how_to_join()
            processes.start_vehicles()
        outcome = _follow(processes, watcher, respawn=scenario.run.respawn)
        processes.companions.await_end_shown()
        if outcome.summary is not None:
            for child in children:
                child.wait(2.0 if outcome.summary.complete else 0.5)
            if not watcher.stop() and not scenario.run.respawn:
                # A vehicle may have failed just before the end.
                failed = [child.exit_report() for child in children[1:] if child.ended]
                outcome.fault = outcome.fault or next(iter(failed), "")
            processes_flown = [Process(name=child.name, pid=child.pid) for child in children]
            outcome.summary = msgspec.structs.replace(outcome.summary, processes=processes_flown)
        return outcome


def _is_outside(vehicle: Uav | Ugv) -> bool:
    """Return true if the user starts this vehicle's process."""
    return isinstance(vehicle, Ugv) and DRIVERS[vehicle.driver].outside


class _Processes:
    """Processes of the run; the simulator's is the first.

    Args:
        scenario: Scenario to fly.
        folder: Private folder of the run.
        listening: Endpoints for parties that the user starts.
        children: List that receives the processes; the caller ends all of them.
        watcher: Callbacks that receive the processes' warnings.
        logs: Folder for each process's standard error; None: not kept.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        listening: Listening,
        children: list[Child],
        watcher: Watcher,
        logs: Path | None,
    ) -> None:
        self.children = children
        self._watcher = watcher
        self._logs = logs
        self.lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        """Reports of the simulator, one line each."""
        self._scenario, self._folder, self._listening = scenario, folder, listening
        self._endpoint = f"{UNIX}/{folder / 'bus.sock'}"
        self._uavs = [uav.name for uav in scenario.uav]
        self.companions = Companions(watcher.on_event)
        ugvs = [ugv.name for ugv in scenario.ugv]
        own = [vehicle.name for vehicle in scenario.vehicles if _is_outside(vehicle)]
        self._credentials = listening.given or new_credentials(
            f"run-{os.getpid()}-{secrets.token_hex(4)}", self._uavs, ugvs
        )
        self._run = self._credentials.run
        self._files = {
            name: folder / f"{name}.json" for name in (OPERATOR_NAME, OBSERVER_NAME, *own)
        }
        """Credential files of parties that are not children of this process."""
        for name, path in self._files.items():
            write_credential(self._credentials.of(name), path)

    @property
    def simulator(self) -> Child:
        """The simulator's process."""
        return self.children[0]

    def _log(self, name: str) -> Path | None:
        return self._logs / f"{name}.log" if self._logs is not None else None

    def _joining(self) -> list[str]:
        """Return the options with the router's endpoint and the run's name."""
        return ["--connect", self._endpoint, "--run", self._run]

    def _joining_as(self, name: str, endpoint: str = "") -> str:
        """Return the options of a party that the user starts."""
        where = endpoint or self._endpoint
        return self._listening.joining(where, self._run, self._files[name])

    def tell_how_to_join(self) -> None:
        """Report how operators and observers join the run, and which command drives a UGV."""
        for endpoint in self._listening.endpoints:
            there = reachable(endpoint)
            line = f"listening on {endpoint}; operators join with {self._joining_as(OPERATOR_NAME, there)}"
            observer = self._joining_as(OBSERVER_NAME, there).rpartition(" ")[2]
            self._watcher.on_event(f"{line}, observers with {observer}")
        for ugv in self._scenario.ugv:
            if DRIVERS[ugv.driver].operated:
                known = self._joining_as(OPERATOR_NAME)
                self._watcher.on_event(
                    f"drive {ugv.name}: outrider drive {known} --name {ugv.name}"
                )

    def start_simulator(self, output: Output, secret: str) -> None:
        """Start the simulator; clients wait until its router listens."""
        file = self._folder / "scenario.toml"
        file.write_text(as_toml(self._scenario), encoding="utf-8")
        arguments = ["simulator", str(file), "--run", self._run]
        for endpoint in (self._endpoint, *self._listening.endpoints):
            arguments += ["--listen", endpoint]
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
        """Start the companions and wait until they are ready; return the first that fails."""
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
            Start(
                credential=self._credentials.of(OPERATOR_NAME),
                law=self._scenario.law,
                scenario=as_toml(self._scenario),
            ),
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
        """Start a process for each vehicle; print the join options of a vehicle that the user starts."""
        for vehicle in self._scenario.vehicles:
            if _is_outside(vehicle):
                known = self._joining_as(
                    vehicle.name, next(map(reachable, self._listening.endpoints), "")
                )
                self._watcher.on_event(
                    f"start {vehicle.name} yourself with {known} --name {vehicle.name}"
                )
            else:
                self.children.append(self._start(vehicle.name))

    def start_again(self, dead: Child) -> None:
        """Replace a process that has exited by a new one."""
        index = self.children.index(dead)
        dead.close()
        self.children[index] = self._start(dead.name)


def _follow(processes: _Processes, watcher: Watcher, *, respawn: bool) -> Outcome:
    """Follow the run until the simulator's process exits."""
    simulator, followed = processes.simulator, _Followed(processes, watcher, respawn=respawn)
    outcome, asked = followed.outcome, False
    while True:
        if watcher.stop() > 1:
            raise KeyboardInterrupt  # a second request does not wait for a summary
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
        refusal = simulator.error_line() if simulator.ended == _UNUSABLE else ""
        raise ScenarioError(refusal) if refusal else PeerLost(simulator.exit_report())
    if simulator.ended not in (0, None) and not watcher.stop() and not outcome.fault:
        outcome.fault = simulator.stderr_tail() or simulator.exit_report()
    return outcome


class _Followed:
    """State of the run as its parent process follows it.

    Args:
        processes: Processes of the run.
        watcher: Callbacks that receive ticks, events and warnings.
        respawn: True: restart a vehicle's process if it fails.
    """

    def __init__(self, processes: _Processes, watcher: Watcher, *, respawn: bool) -> None:
        self.outcome = Outcome()
        self._processes, self._watcher, self._respawn = processes, watcher, respawn
        self._tick = 0
        self._deaths = Counter[str]()
        """Failures of each vehicle's process since the newest tick."""
        self._counted: set[int] = set()
        self._events: deque[tuple[float, str]] = deque()
        """Pending events, each with the time at which it is shown."""
        self._is_dropping_events = False

    def read(self, line: bytes) -> None:
        """Process one report of the simulator."""
        report = msgspec.json.decode(line, type=Report)
        if report.tick is not None:
            if report.tick > self._tick:
                self._deaths.clear()
            self._tick = report.tick
            self._watcher.on_tick(report.tick)
        if report.event is not None and not self._is_dropping_events:
            delay = 0.0 if self._tick else _EVENT_DELAY
            self._events.append((time.monotonic() + delay, report.event))
        if report.warnings is not None:
            self._watcher.on_warnings(report.warnings)
        if report.summary is not None:
            self.outcome.summary = report.summary
        if report.files is not None:
            self.outcome.files = [Path(file) for file in report.files]

    def show_events(self, *, all_of_them: bool = False) -> None:
        """Show the events that are due."""
        while self._events and (all_of_them or time.monotonic() >= self._events[0][0]):
            self._watcher.on_event(self._events.popleft()[1])

    def must_end(self) -> bool:
        """Report failed processes and restart vehicles; return true if a failure must end the run."""
        if self.outcome.summary is not None:
            return False
        self._processes.companions.report()
        dead = [
            child
            for child in self._processes.children[1:]
            if child.ended not in (None, 0) and child.pid not in self._counted
        ]
        fatal = [self._is_fatal(child) for child in dead]  # a list, so that each is reported
        return any(fatal)

    def _is_fatal(self, dead: Child) -> bool:
        self._counted.add(dead.pid)
        self._deaths[dead.name] += 1
        deaths, outcome = self._deaths[dead.name], self.outcome
        own = dead.error_line()
        if own and not self._respawn and self._tick == 0:
            outcome.fault, outcome.unusable = own, dead.ended == _UNUSABLE
            dead.drop_log()
            self._events.clear()
            self._is_dropping_events = True
            return True
        report = dead.exit_report()
        if self._respawn and deaths <= _MAX_RESTARTS:
            self._watcher.on_event(f"{report}; restarted")
            self._processes.start_again(dead)
            return False
        if self._respawn:
            report += f"; failure {deaths} at tick {self._tick}, so it is not restarted"
        self._watcher.on_event(report)
        outcome.fault = outcome.fault or report
        return self._respawn or self._tick == 0
