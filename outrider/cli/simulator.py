"""`outrider simulator`: the process that knows the truth, with the router inside."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from bus.credentials import Credential, CredentialSet, read_credentials
from bus.joining import open_session
from bus.keys import SIMULATOR_NAME, Party, Role
from outrider.cli import options
from outrider.cli.console import (
    ERR,
    FlightProgress,
    flight_progress,
    print_json,
    print_summary,
    print_warnings,
    tell_starting,
)
from outrider.cli.stopping import stop_on_signals
from outrider.running.assumptions import assumption_warnings
from outrider.running.exit_reports import Report, Reports
from outrider.running.parent import Output, read_start
from outrider.running.resolve import resolve
from outrider.running.summary import Summary, summarize
from outrider.view.output import write_flight
from sim.scenario.checks import scenario_warnings
from sim.scenario.resolved import read_resolved
from sim.scenario.types import Scenario
from sim.server.flight import warm_up
from sim.server.serving import Server

if TYPE_CHECKING:
    from outrider.recording.writer import FlightRecorder

ServedScenario = Annotated[
    str,
    typer.Argument(help="A shipped scenario's name, or a TOML file.", envvar="OUTRIDER_SCENARIO"),
]
Listen = Annotated[
    list[str] | None,
    typer.Option(help=f"Host the router, on this endpoint; {options.DEFAULT_ENDPOINT} by default."),
]
OtherRouter = Annotated[
    str,
    typer.Option(
        help="Use the router at this endpoint instead of hosting one.", envvar="OUTRIDER_CONNECT"
    ),
]
ServedSeed = Annotated[
    int | None,
    typer.Option(
        help="Seed of all random numbers; the scenario's own by default.",
        min=0,
        max=2**53 - 1,
        envvar="OUTRIDER_SEED",
    ),
]
ServedDuration = Annotated[
    float | None,
    typer.Option(
        help="Simulated time in s, instead of the scenario's.", envvar="OUTRIDER_DURATION"
    ),
]
ServedJoinTimeout = Annotated[
    float | None,
    typer.Option(
        help="Seconds to wait for vehicles, or a router that is away; the scenario's by default.",
        min=0.0,
        envvar="OUTRIDER_JOIN_TIMEOUT",
    ),
]
Respawn = Annotated[
    bool, typer.Option("--respawn", help="Pause the simulation until a lost vehicle reconnects.")
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER", help="Folder for trajectory, picture and summary; none by default."
    ),
]


class _Job(NamedTuple):
    """The run to simulate."""

    scenario: Scenario
    run: str
    connect: str
    """Endpoint of the router elsewhere; empty: this process hosts one."""
    listen: tuple[str, ...]
    credential: Credential | None
    """Credential by which the router elsewhere knows this process."""
    given: CredentialSet | None
    """Credentials by which the router in this process knows its clients."""
    secret: str
    output: Output


class _Terminal:
    """Reports to a person: warnings and progress on standard error, the summary on standard output."""

    def __init__(self, job: _Job, *, json: bool) -> None:
        self._job, self._json = job, json

    def begin(self, warnings: tuple[str, ...]) -> None:
        """Print the warnings, and what the simulator waits for."""
        job = self._job
        print_warnings((*scenario_warnings(job.scenario), *warnings))
        names = ", ".join(vehicle.name for vehicle in job.scenario.vehicles)
        where = f"listening on {', '.join(job.listen)}"
        if job.connect:
            where = f"using the router at {job.connect}"
        ERR.tell(f"{where}, run {job.run}: waiting for {names}")
        if job.listen and job.given is None:
            ERR.tell(
                "no credentials: every process that reaches this endpoint may read and write everything"
            )

    def progress(self) -> "AbstractContextManager[FlightProgress | _Parent]":
        """Return a bar."""
        return flight_progress(self._job.scenario, "waiting")

    def flown(self, summary: Summary) -> None:
        """Wait for the files: they are printed with it."""

    def end(self, summary: Summary, files: list[Path]) -> None:
        """Print the summary and the files."""
        if self._json:
            print_json(summary)
        else:
            print_summary(summary, files)


class _Parent(Reports):
    """Reports to `outrider run`, which has printed the scenario's own warnings."""

    def begin(self, warnings: tuple[str, ...]) -> None:
        """Write what stands in the way of a certificate."""
        if warnings:
            self.write(Report(warnings=warnings))

    def progress(self) -> "AbstractContextManager[FlightProgress | _Parent]":
        """Return this."""
        return nullcontext(self)

    def flown(self, summary: Summary) -> None:
        """Write the summary first of all, so that a full disk does not take it."""
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

    It waits for them, flies with them, and sums the run up. In lockstep it goes as fast as they answer; with --realtime
    it keeps the wall clock. Where it hosts the router its credentials are the file with everybody's (router.json),
    where it uses another its own (simulator.json).

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
        realtime=realtime,
        join_timeout=join_timeout,
        respawn=respawn,
        changes=changes,
    )
    given, credential = None, None
    if connect:
        credential = options.credential_of(credentials, Role.SIMULATOR, SIMULATOR_NAME)
    elif credentials is not None:
        given = read_credentials(credentials)
    endpoints = () if connect else tuple(listen or (options.DEFAULT_ENDPOINT,))
    secured = given is not None or credential is not None
    options.check_endpoints(
        endpoints or (connect,), secured=secured or bool(connect), insecure=insecure
    )
    kept = options.secret_of(secret, wanted=secured)
    output = Output(folder=str(out or ""), record=str(record or ""))
    job = _Job(flown, run, connect, endpoints, credential, given, kept, output)
    tell_starting()
    raise typer.Exit(_simulate(job, _Terminal(job, json=json)))


def _simulate(job: _Job, audience: _Terminal | _Parent) -> int:
    """Wait for the vehicles and fly; return the exit code."""
    flown = job.scenario
    with ExitStack() as opened:
        # The router listens while the rest is compiled, so that vehicles need not wait to reach it.
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
        # Not before: a signal ends the compiling at once.
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
        try:
            server.fly(on_tick=_follower(server, recorder, progress))
        finally:
            _end(job, server, audience)
    return stop.exit_code


@contextmanager
def _recorder(job: _Job) -> "Iterator[FlightRecorder | None]":
    """Open the recording, if one is wanted: a file that cannot be written shows before any vehicle joins."""
    if not job.output.record:
        yield None
        return
    from outrider.recording.writer import FlightRecorder

    file = Path(job.output.record)
    with closing(FlightRecorder(file, job.scenario, job.scenario.seed, secret=job.secret)) as one:
        yield one


def _follower(
    server: Server, recorder: "FlightRecorder | None", progress: FlightProgress | _Parent
) -> Callable[[], None]:
    """Return what records each tick, and shows ten a second."""
    shown = 0.0

    def on_tick() -> None:
        nonlocal shown
        if recorder is not None:
            recorder.tick(server.flight)
        now = time.monotonic()
        if now - shown > 0.1 or server.flight.over:
            shown = now
            progress.show(server.flight.world.tick)

    return on_tick


def _end(job: _Job, server: Server, audience: _Terminal | _Parent) -> None:
    """Sum up and write what was flown, also where the router was lost for good.

    Of a run that could not begin the cause alone is reported; only a vehicle that was restarted again and again has a
    summary worth keeping.
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
    )
    audience.flown(summary)
    files: list[Path] = []
    try:
        if job.output.folder:
            folder = Path(job.output.folder)
            files += write_flight(flight, summary, folder, picture=job.output.picture)
        files += [Path(job.output.record)] if job.output.record else []
    finally:  # also where the disk is full
        audience.end(summary, files)
