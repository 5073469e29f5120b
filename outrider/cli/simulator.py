"""`outrider simulator`: process that simulates the world and hosts the router."""

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from bus.credentials import Credential, CredentialSet, read_credentials
from bus.joining import open_session
from bus.keys import SIMULATOR_NAME, Party, Role
from bus.messages.base import MAX_SEED
from outrider.cli import options
from outrider.cli.console import (
    ERR,
    FlightProgress,
    flight_progress,
    print_json,
    print_warnings,
)
from outrider.cli.joining import credential_of
from outrider.cli.run_secret import secret_of
from outrider.cli.standard_files import print_starting
from outrider.cli.stopping import stop_on_signals
from outrider.cli.summary_table import print_summary
from outrider.running.assumptions import assumption_warnings
from outrider.running.exit_reports import Report, Reports
from outrider.running.parent import Output, read_start
from outrider.running.resolve import resolve
from outrider.running.summary import Summary, summarize
from outrider.view.output import write_flight
from sim.scenario.checks import scenario_warnings
from sim.scenario.resolved import read_resolved
from sim.scenario.types import Scenario
from sim.server.serving import Server
from sim.server.warming import warm_up

if TYPE_CHECKING:
    from outrider.recording.writer import FlightRecorder

ServedScenario = Annotated[
    str,
    typer.Argument(help="Name of a shipped scenario, or a TOML file.", envvar="OUTRIDER_SCENARIO"),
]
Listen = Annotated[
    list[str] | None,
    typer.Option(help=f"Host the router on this endpoint; default: {options.DEFAULT_ENDPOINT}."),
]
OtherRouter = Annotated[
    str,
    typer.Option(
        help="Connect to the router at this endpoint instead of hosting one.",
        envvar="OUTRIDER_CONNECT",
    ),
]
ServedSeed = Annotated[
    int | None,
    typer.Option(
        help="Set the seed of all random numbers; default: the scenario's.",
        min=0,
        max=MAX_SEED,
        envvar="OUTRIDER_SEED",
    ),
]
ServedDuration = Annotated[
    float | None,
    typer.Option(
        help="Set the simulated time in s; default: the scenario's.", envvar="OUTRIDER_DURATION"
    ),
]
ServedJoinTimeout = Annotated[
    float | None,
    typer.Option(
        help="Wait this many seconds for vehicles or router; default: the scenario's.",
        min=0.0,
        envvar="OUTRIDER_JOIN_TIMEOUT",
    ),
]
Respawn = Annotated[
    bool, typer.Option("--respawn", help="Pause the simulation until a lost vehicle reconnects.")
]
Out = Annotated[
    Path | None,
    typer.Option(metavar="FOLDER", help="Write trajectory, picture and summary to this folder."),
]


class _Job(NamedTuple):
    """Run to simulate."""

    scenario: Scenario
    run: str
    connect: str
    """Endpoint of another process's router; empty: this process hosts the router."""
    listen: tuple[str, ...]
    credential: Credential | None
    """Credential of this process for another process's router."""
    given: CredentialSet | None
    """Credentials of all clients of this process's router."""
    secret: str
    output: Output


class _Terminal:
    """Reports to the terminal: warnings and progress on standard error, the summary on standard output."""

    def __init__(self, job: _Job, *, json: bool) -> None:
        self._job, self._json = job, json
        self.exit_code = 0
        """1 if a vehicle's process was missing at the end."""

    def missing(self, names: list[str]) -> None:
        """Report the vehicles whose process was missing at the end."""
        self.exit_code = 1
        print_warnings([f"{', '.join(names)}: missing at the end of the run"])

    def begin(self, warnings: tuple[str, ...]) -> None:
        """Print the warnings and the awaited vehicles."""
        job = self._job
        print_warnings((*scenario_warnings(job.scenario), *warnings))
        names = ", ".join(vehicle.name for vehicle in job.scenario.vehicles)
        where = f"listening on {', '.join(job.listen)}"
        if job.connect:
            where = f"using the router at {job.connect}"
        ERR.tell(f"{where}, run {job.run}: waiting for {names}")
        if job.listen and job.given is None:
            ERR.tell(
                "no credentials: every process that reaches this endpoint can read and write everything"
            )

    def progress(self) -> "AbstractContextManager[FlightProgress | _Parent]":
        """Return a progress bar."""
        return flight_progress(self._job.scenario, "waiting")

    def flown(self, summary: Summary) -> None:
        """Do nothing: the summary is printed together with the files."""

    def end(self, summary: Summary, files: list[Path]) -> None:
        """Print the summary and the files."""
        if self._json:
            print_json(summary)
        else:
            print_summary(summary, files)


class _Parent(Reports):
    """Reports to `outrider run`, which has printed the scenario's warnings already."""

    exit_code = 0
    """`outrider run` reports ended vehicles itself."""

    def missing(self, names: list[str]) -> None:
        """Do nothing: `outrider run` has started the vehicles, and reports those that have ended."""

    def begin(self, warnings: tuple[str, ...]) -> None:
        """Write the warnings about certificates."""
        if warnings:
            self.write(Report(warnings=warnings))

    def progress(self) -> "AbstractContextManager[FlightProgress | _Parent]":
        """Return this object, which reports progress."""
        return nullcontext(self)

    def flown(self, summary: Summary) -> None:
        """Write the summary before any file, so that a full disk cannot lose it."""
        self.write(Report(summary=summary))

    def end(self, _summary: Summary, files: list[Path]) -> None:
        """Write the names of the files."""
        self.write(Report(files=[str(file) for file in files]))


def command(
    scenario: ServedScenario = "escort",
    listen: Listen = None,
    connect: OtherRouter = "",
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    insecure: options.Insecure = False,
    seed: ServedSeed = None,
    secret: options.Secret = "",
    duration: ServedDuration = None,
    law: options.LawName = None,
    driver: options.DriverName = None,
    network: options.NetworkName = "",
    changes: options.Set = None,
    realtime: options.RealTime = None,
    join_timeout: ServedJoinTimeout = None,
    respawn: Respawn = False,
    record: options.Record = None,
    out: Out = None,
    json: options.Json = False,
    child: options.Child = False,
) -> None:
    """Simulate a scenario for vehicles that join over Zenoh.

    The simulator waits for the vehicles, flies the scenario and prints a summary. In lockstep, it runs as fast as the
    vehicles answer; with --realtime, it follows the wall clock. Its credentials are router.json if it hosts the router,
    and simulator.json if it connects to another router. The exit code is 1 if a vehicle's process is missing at the
    end.

    Example: outrider simulator escort --listen tcp/127.0.0.1:17447 --out runs/mine
    """
    if child:
        start = read_start()
        flown = read_resolved(Path(scenario))
        job = _Job(
            flown, run, "", tuple(listen or ()), None, start.credentials, start.secret, start.output
        )
        raise typer.Exit(_simulate(job, _Parent()))
    flown, _ = resolve(
        scenario,
        seed=seed,
        duration=duration,
        law=law,
        driver=driver,
        network=network,
        realtime=realtime,
        join_timeout=join_timeout,
        changes=options.with_respawn(changes, respawn=respawn),
    )
    given, credential = None, None
    if connect:
        credential = credential_of(credentials, Role.SIMULATOR, SIMULATOR_NAME)
    elif credentials is not None:
        given = read_credentials(credentials)
    endpoints = () if connect else tuple(listen or (options.DEFAULT_ENDPOINT,))
    secured = given is not None or credential is not None
    options.check_endpoints(
        endpoints or (connect,), secured=secured or bool(connect), insecure=insecure
    )
    run_secret = secret_of(secret, wanted=secured)
    output = Output(folder=str(out or ""), record=str(record or ""))
    job = _Job(flown, run, connect, endpoints, credential, given, run_secret, output)
    print_starting()
    raise typer.Exit(_simulate(job, _Terminal(job, json=json)))


def _simulate(job: _Job, audience: _Terminal | _Parent) -> int:
    """Wait for the vehicles and fly the scenario; return the exit code."""
    flown = job.scenario
    with ExitStack() as opened:
        # The router listens before the compilation, so that vehicles can connect meanwhile.
        session = opened.enter_context(
            open_session(
                Party(role=Role.SIMULATOR, name=SIMULATOR_NAME),
                job.run,
                connect=job.connect,
                listen=job.listen,
                credential=job.credential,
                given=job.given,
                join_timeout=flown.run.join_timeout,
            )
        )
        warm_up(flown)
        audience.begin(assumption_warnings(flown))
        # Not earlier: a signal must end the compilation at once.
        stop = opened.enter_context(stop_on_signals())
        recorder = opened.enter_context(_recorder(job))
        progress = opened.enter_context(audience.progress())

        def on_event(line: str) -> None:
            progress.say(line)
            if recorder is not None:
                recorder.event(line)

        server = Server(
            session,
            flown,
            flown.seed,
            secret=job.secret,
            on_event=on_event,
            stop=lambda: bool(stop),
            warn=assumption_warnings,
        )
        if recorder is not None:
            recorder.vehicles = server.vehicles
        follow = _Follower(server, recorder, progress)
        try:
            server.fly(on_tick=follow.tick)
        finally:
            _end(job, server, audience)
    if follow.missing:
        audience.missing(follow.missing)
    return stop.exit_code or audience.exit_code


@contextmanager
def _recorder(job: _Job) -> "Iterator[FlightRecorder | None]":
    """Open the recording, if any, before vehicles join: an unwritable file fails early."""
    if not job.output.record:
        yield None
        return
    from outrider.recording.writer import FlightRecorder  # noqa: PLC0415 - the extra [record]

    file = Path(job.output.record)
    with closing(FlightRecorder(file, job.scenario, job.scenario.seed, secret=job.secret)) as one:
        yield one


class _Follower:
    """Follower of a flight: records each tick and shows ten ticks per second."""

    def __init__(
        self,
        server: Server,
        recorder: "FlightRecorder | None",
        progress: FlightProgress | _Parent,
    ) -> None:
        self._server, self._recorder, self._progress = server, recorder, progress
        self._shown = 0.0
        self.missing: list[str] = []
        """Vehicles whose process was missing at the last tick."""

    def tick(self) -> None:
        """Record a tick."""
        server = self._server
        if self._recorder is not None:
            self._recorder.tick(server.flight)
        now = time.monotonic()
        if now - self._shown > 0.1 or server.flight.over:
            self._shown = now
            self._progress.show(server.flight.world.tick)
        if server.flight.over:
            self.missing = [name for name, one in server.vehicles().items() if not one.present]


def _end(job: _Job, server: Server, audience: _Terminal | _Parent) -> None:
    """Write the summary and the files of the run, even after the router was lost.

    A run without a tick has no summary, unless a vehicle was restarted repeatedly.
    """
    seconds = time.perf_counter() - server.started
    flight, respawn = server.flight, job.scenario.run.respawn
    if not (flight.world.tick or (respawn and flight.recorder.rows)):
        return
    summary = summarize(
        flight,
        seconds=seconds,
        vehicles=server.vehicles(),
        realtime=job.scenario.run.realtime or None,
        late_ticks=server.late_ticks,
        changes=server.changes,
        telemetry_faults=server.telemetry_faults,
    )
    audience.flown(summary)
    files: list[Path] = []
    try:
        if job.output.folder:
            folder = Path(job.output.folder)
            files += write_flight(flight, summary, folder, picture=job.output.picture)
        files += [Path(job.output.record)] if job.output.record else []
    finally:  # even if the disk is full
        audience.end(summary, files)
