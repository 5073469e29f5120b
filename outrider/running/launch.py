"""A run as three operating-system processes or more: started together, watched, and ended together."""

import contextlib
import os
import queue
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import IO, Literal

import msgspec

from bus.access import ROUTER_FILE, new_certificates, new_credentials, write_credentials
from bus.certificates import new_authority
from bus.errors import BusError, PeerLost
from bus.keys import OPERATOR_NAME, SIMULATOR_NAME
from bus.registry import DRIVERS
from outrider.running.cores import can_be_kept_apart, keep_apart
from outrider.running.exit_reports import Report
from outrider.running.summary import Process, Summary
from sim.scenario.types import Scenario, Ugv

_PATIENCE = 10.0
"""How long a process may take to end when it was asked to [s]."""
_LAST_WORDS = 12
"""Lines of a child's standard error that are kept."""
_LAST_FRAME = 0.2
"""So long after the end of the simulator the page is still served [s], so that browsers show that the run is over."""
_SECRET = "OUTRIDER_SECRET"  # noqa: S105 - a variable's name
"""Where the simulator's process finds the run's secret."""
_PORTS = range(20_000, 32_000)
"""Of this machine, below those that systems give to clients."""
Transport = Literal["unix", "tcp", "tls"]
_LIVES = 3
"""A process that dies more often than this while the clock stands still is not started again."""


def _environment(secret: str) -> dict[str, str]:
    """A child's environment: ours, without our run's secret unless it is for it.

    A command line would show it to everybody.
    """
    ours = {name: value for name, value in os.environ.items() if name != _SECRET}
    return ours | ({_SECRET: secret} if secret else {})


class Child:
    """One process of the run, with its last words.

    Args:
        name: On the bus.
        arguments: Of the `outrider` command line.
        lines: Where its standard output goes, line by line; None is its end.
        files: Open files that it inherits, by their numbers.
        secret: Of the run: for the simulator alone.
    """

    def __init__(
        self,
        name: str,
        arguments: Sequence[str],
        lines: "queue.SimpleQueue[bytes | None] | None" = None,
        files: Sequence[int] = (),
        secret: str = "",
    ) -> None:
        self.name = name
        self._words: deque[str] = deque(maxlen=_LAST_WORDS)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "outrider", *arguments, "--leash"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL if lines is None else subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=files,
            env=_environment(secret),
            start_new_session=True,  # Ctrl-C reaches us alone; we end the children in order
        )
        self._readers = [
            threading.Thread(target=self._listen, args=(self._process.stderr,), daemon=True)
        ]
        if lines is not None:
            self._readers.append(
                threading.Thread(
                    target=self._pass_on, args=(self._process.stdout, lines), daemon=True
                )
            )
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
        how = (
            f"was killed by signal {-code}"
            if code is not None and code < 0
            else f"ended with exit code {code}"
        )
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


def free_port() -> int:
    """A port that nobody listens on now.

    Raises:
        BusError: If there is none.
    """
    for _ in range(100):
        port = secrets.choice(_PORTS)
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.bind(("127.0.0.1", port))
            return port
    raise BusError("no free port found for the run's router")


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
    """What failed on the way, for a person; empty where nothing did."""


class Watcher(msgspec.Struct, frozen=True, kw_only=True):
    """Who follows a run, and can end it."""

    on_tick: Callable[[int], None]
    """Called with the tick, some times a second."""
    on_event: Callable[[str], None]
    """Called with a line for a person."""
    stop: Callable[[], int]
    """How often somebody has asked for the end: once ends the run in order, twice at once."""


NOBODY = Watcher(on_tick=lambda _tick: None, on_event=lambda _line: None, stop=lambda: 0)


def launch(
    scenario: Scenario,
    source: str,
    overrides: Sequence[str],
    watcher: Watcher,
    *,
    out: Path | None,
    picture: bool = True,
    record: Path | None = None,
    realtime: float | None = None,
    deadline: float = 10.0,
    join_timeout: float = 120.0,
    respawn: bool = False,
    pin: bool = True,
    secured: bool = True,
    transport: Transport = "unix",
    page: socket.socket | None = None,
    secret: str = "",
) -> Outcome:
    """Fly a scenario as one process for the simulator and one for each vehicle, over Zenoh on a private socket.

    Each process has credentials of its own, made for this run alone and gone with it.

    Args:
        scenario: What is flown.
        source: The same as a name or file, for the simulator's process.
        overrides: The same as `--set` arguments.
        watcher: Who follows the run.
        out: Where the simulator writes.
        picture: Whether it draws.
        record: Where it records every tick.
        realtime: Simulated seconds per second of wall time; None: lockstep.
        deadline: How long it waits for the commands of one tick [s].
        join_timeout: How long it waits for the vehicles [s].
        respawn: Whether a vehicle's process that dies is started again.
        pin: Whether the UAVs keep to one half of the processor cores and the others to the other half, if there
            are few of them.
        secured: Whether there are credentials and access control; False only to measure what they cost.
        transport: `tcp` and `tls`, with certificates for passwords, use a port of this machine; only to measure
            what they cost.
        page: A socket that listens, on which the run is shown in the browser; None: it is not. The page's process
            is no part of the flight: where it fails, that is told, and the flight goes on.
        secret: Of the run, for the simulator's process alone; empty: none.

    Returns:
        The summary of what was flown, if anything was; and the fault that ended it early.
    """
    with _private_folder() as folder, _family() as pages, _family() as children:
        run = f"run-{os.getpid()}-{secrets.token_hex(4)}"
        crew = _Crew(scenario, folder, run, children, pin=pin, secured=secured, transport=transport)
        timing = ["--deadline", str(deadline), "--join-timeout", str(join_timeout)]
        pace = (["--realtime", str(realtime)] if realtime is not None else []) + (
            ["--respawn"] if respawn else []
        )
        settings = [argument for override in overrides for argument in ("--set", override)]
        output = (["--out", str(out)] if out else []) + ([] if picture else ["--no-picture"])
        output += ["--record", str(record)] if record else []
        crew.start_simulator(source, [*settings, *output, *timing, *pace], watcher, secret)
        if page is not None and not watcher.stop() and crew.simulator.ended is None:
            crew.show_on(page, pages, watcher)
        if not watcher.stop():
            crew.start_vehicles(watcher)
        outcome = _follow(crew, watcher, respawn=respawn)
        if any(shown.ended is None for shown in pages):
            time.sleep(_LAST_FRAME)
        if outcome.summary is not None:
            for child in children:
                child.wait(2.0 if outcome.summary.complete else 0.5)
            who = [Process(name=child.name, pid=child.pid) for child in children]
            outcome.summary = msgspec.structs.replace(outcome.summary, processes=who)
        return outcome


class _Crew:
    """The run's processes, the simulator's first.

    Args:
        scenario: What is flown.
        folder: The run's private folder.
        run: Its name.
        children: Where they are kept, so that they are ended whatever happens.
        pin: Whether they are given cores.
        secured: Whether they are given credentials.
        transport: How they reach each other.
    """

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        run: str,
        children: list[Child],
        *,
        pin: bool,
        secured: bool,
        transport: Transport,
    ) -> None:
        self.children = children
        self.lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        """What the simulator reports."""
        self._scenario, self._folder, self._run = scenario, folder, run
        self._pin = pin and can_be_kept_apart(len(scenario.vehicles))
        self._address: Path | tuple[str, int] = folder / "bus.sock"
        self._endpoint = f"unixsock-stream/{self._address}"
        if transport != "unix":
            self._address = ("127.0.0.1", free_port())
            self._endpoint = f"{transport}/127.0.0.1:{self._address[1]}"
        self._uavs = {uav.name for uav in scenario.uav}
        self._files: dict[str, Path] = {}
        self._page: Child | None = None
        if secured:
            names = [uav.name for uav in scenario.uav], [ugv.name for ugv in scenario.ugv]
            given = (
                new_certificates(new_authority(run), *names)
                if transport == "tls"
                else new_credentials(run, *names)
            )
            self._files = write_credentials(given, folder / "credentials")

    @property
    def simulator(self) -> Child:
        """The simulator's process."""
        return self.children[0]

    def _known_as(self, name: str) -> list[str]:
        return ["--credentials", str(self._files[name])] if self._files else []

    def start_simulator(
        self, source: str, settings: list[str], watcher: Watcher, secret: str
    ) -> None:
        """Start it and wait until its router listens: before that a client would only try in vain."""
        arguments = [
            "simulator",
            source,
            "--listen",
            self._endpoint,
            "--run",
            self._run,
            "--events",
        ]
        arguments += [*self._known_as(ROUTER_FILE), *settings, "--leash-folder", str(self._folder)]
        self.children.append(Child(SIMULATOR_NAME, arguments, self.lines, secret=secret))
        while not self._listens() and self.simulator.ended is None and not watcher.stop():
            time.sleep(0.02)

    def _listens(self) -> bool:
        if isinstance(self._address, Path):
            return self._address.exists()
        with contextlib.suppress(OSError), socket.create_connection(self._address, timeout=1.0):
            return True
        return False

    def show_on(self, page: socket.socket, pages: list[Child], watcher: Watcher) -> None:
        """Start the dashboard, and wait until it shows what comes: the first tick is part of it."""
        arguments = [
            "dashboard",
            "--connect",
            self._endpoint,
            "--run",
            self._run,
            *self._known_as(OPERATOR_NAME),
        ]
        arguments += ["--host", "127.0.0.1", "--listening", str(page.fileno())]
        arguments += ["--law", msgspec.json.encode(self._scenario.law).decode()]
        lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._page = Child("dashboard", arguments, lines, (page.fileno(),))
        pages.append(self._page)
        page.close()  # it is the child's now: where that ends, nobody else keeps a browser waiting
        limit = time.monotonic() + _PATIENCE
        while not watcher.stop() and self.simulator.ended is None and time.monotonic() < limit:
            with contextlib.suppress(queue.Empty):
                line = lines.get(timeout=0.1)
                if line is not None:
                    watcher.on_event(f"the run is shown at {line.decode().strip()}")
                return

    def lost_page(self) -> str:
        """Why the dashboard has ended before the run, told once; empty: it has not."""
        if self._page is None or self._page.ended is None:
            return ""
        page, self._page = self._page, None
        return f"{page.epitaph()}; the run goes on without its page"

    def _start(self, name: str) -> Child:
        common = [
            "--name",
            name,
            "--connect",
            self._endpoint,
            "--run",
            self._run,
            *self._known_as(name),
        ]
        custom = self._scenario.custom
        if name not in self._uavs:
            return Child(
                name, ["ugv", *common, *(["--policy", custom.policy] if custom.policy else [])]
            )
        own = [("--weighting", custom.weighting), ("--path", custom.path)]
        return Child(
            name,
            [
                "uav",
                *common,
                *(argument for option, value in own if value for argument in (option, value)),
            ],
        )

    def start_vehicles(self, watcher: Watcher) -> None:
        """Start a process for each, and say what one of the user's own needs to know."""
        for vehicle in self._scenario.vehicles:
            if isinstance(vehicle, Ugv) and DRIVERS[vehicle.driver].outside:
                known = " ".join(self._known_as(vehicle.name))
                watcher.on_event(
                    f"{vehicle.name} is yours: --connect {self._endpoint} --run {self._run} --name {vehicle.name} {known}"
                )
            else:
                self.children.append(self._start(vehicle.name))
        self._give_cores()

    def start_again(self, dead: Child) -> None:
        """Put a new process in the place of one that has ended."""
        place = self.children.index(dead)
        dead.close()
        self.children[place] = self._start(dead.name)
        self._give_cores()

    def _give_cores(self) -> None:
        if self._pin:
            keep_apart({child.pid: child.name in self._uavs for child in self.children})


def _follow(crew: _Crew, watcher: Watcher, *, respawn: bool) -> Outcome:
    """Until the simulator's process has ended, whoever made it end."""
    simulator, outcome, asked = crew.simulator, Outcome(), False
    tick, deaths, mourned = 0, Counter[str](), set[int]()

    def read(line: bytes) -> None:
        nonlocal tick
        report = msgspec.json.decode(line, type=Report)
        if report.tick is not None:
            if report.tick > tick:
                deaths.clear()
            tick = report.tick
            watcher.on_tick(report.tick)
        if report.event is not None:
            watcher.on_event(report.event)
        if report.summary is not None:
            outcome.summary = report.summary
        if report.files is not None:
            outcome.files = [Path(file) for file in report.files]

    def bury(dead: Child) -> bool:
        """A vehicle's process has failed; whether the run must end for it."""
        mourned.add(dead.pid)
        deaths[dead.name] += 1
        again = respawn and deaths[dead.name] <= _LIVES
        epitaph = dead.epitaph()
        if respawn and not again:
            epitaph += (
                f"; for the {deaths[dead.name]}th time at tick {tick}, and it is not started again"
            )
        watcher.on_event(epitaph + (": started again" if again else ""))
        if again:
            crew.start_again(dead)
        else:
            outcome.fault = outcome.fault or epitaph
        return not again and (respawn or tick == 0)

    while True:
        if watcher.stop() and not asked:
            asked = True
            simulator.ask_to_end()
        if watcher.stop() > 1:
            raise BusError("killed before the end")
        if not asked and outcome.summary is None:
            if lost := crew.lost_page():
                watcher.on_event(lost)
            dead = [
                child
                for child in crew.children[1:]
                if child.ended not in (None, 0) and child.pid not in mourned
            ]
            for child in dead:
                if bury(child):
                    asked = True
                    simulator.ask_to_end()
        with contextlib.suppress(queue.Empty):
            line = crew.lines.get(timeout=0.1)
            if line is None:
                break
            read(line)
    simulator.wait(_PATIENCE)
    if outcome.summary is None and not outcome.fault and not watcher.stop():
        raise PeerLost(simulator.epitaph())
    if simulator.ended not in (0, None) and not watcher.stop() and not outcome.fault:
        outcome.fault = simulator.last_words() or simulator.epitaph()
    return outcome
