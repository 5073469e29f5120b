"""`outrider run`: flight of a scenario, in several processes or in one."""

import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bus.errors import PeerLost, ScenarioError
from bus.registry import DRIVERS
from outrider.cli import options
from outrider.cli.stopping import Stop, stop_on_signals

MOST_PROCESSES = 20
"""Default limit of a run's processes."""

if TYPE_CHECKING:
    from outrider.cli.console import FlightProgress
    from outrider.running.companions import Beside
    from outrider.running.launch import Outcome
    from outrider.running.parent import Output
    from sim.scenario.types import Scenario


InProcess = Annotated[
    bool, typer.Option("--in-process", help="Fly everything in this process, without a bus.")
]
Respawn = Annotated[
    bool,
    typer.Option(
        "--respawn",
        help="Restart a vehicle's process if it exits; lockstep waits for it.",
    ),
]
AllowProcesses = Annotated[
    int,
    typer.Option("--allow-processes", metavar="N", help="Allow up to N processes.", min=1),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Write trajectory, picture and summary to this folder; default: new, in runs/.",
    ),
]
Files = Annotated[bool, typer.Option(help="Write the files of the run.")]
Picture = Annotated[bool, typer.Option(help="Draw the picture.")]


def command(
    scenario: options.ScenarioName = "escort",
    seed: options.Seed = None,
    secret: options.Secret = "",
    duration: options.Duration = None,
    law: options.LawName = None,
    driver: options.DriverName = None,
    uav_policy: options.FlownPolicy = "",
    changes: options.Set = None,
    network: options.NetworkName = "",
    allow_code: options.AllowCode = False,
    in_process: InProcess = False,
    record: options.Record = None,
    realtime: options.RealTime = None,
    companions: options.Companions = None,
    respawn: Respawn = False,
    allow_processes: AllowProcesses = MOST_PROCESSES,
    out: Out = None,
    files: Files = True,
    picture: Picture = True,
    json: options.Json = False,
) -> None:
    """Fly a scenario, with one process for the simulator and one per vehicle.

    The processes communicate over Zenoh. The run ends with a table of metrics, a picture and the trajectory. Ctrl-C
    ends the run early and keeps its results. If a vehicle's process exits, the vehicle brakes and the run continues;
    with --respawn, the process is restarted and flies on. --with dashboard shows the run on a page.

    Example: outrider run escort --seed 3 --law switching
    """
    # imported here, so that the help starts without a compiler
    from outrider.cli.console import print_warnings
    from outrider.running.companions import pace_with, parse_companion
    from outrider.running.parent import Output
    from outrider.running.resolve import resolve
    from outrider.running.user_code import check_code, check_own_functions
    from outrider.view.output import output_folder
    from sim.scenario.checks import scenario_warnings

    asked, beside = realtime, tuple(parse_companion(text) for text in companions or ())
    realtime = pace_with(beside) if realtime is None else realtime
    flown, named = resolve(
        scenario,
        seed=seed,
        duration=duration,
        law=law,
        driver=driver,
        uav_policy=uav_policy,
        network=network,
        realtime=realtime,
        changes=options.with_respawn(changes, respawn=respawn),
    )
    has_external = any(DRIVERS[ugv.driver].outside for ugv in flown.ugv)
    _check_processes(flown, 0 if in_process else allow_processes)
    _check_in_process(in_process, bool(asked or respawn or companions), has_external)
    run_secret = options.secret_of(secret, wanted=has_external)
    check_code(flown, named, source=scenario, allowed=allow_code)
    print_warnings((*scenario_warnings(flown), *check_own_functions(flown)))
    _check_recording(record)
    place = output_folder(out, flown.name) if files else nullcontext()
    with place as folder, stop_on_signals() as stop:
        output = Output(folder=str(folder or ""), picture=picture, record=str(record or ""))
        if in_process:
            outcome = _fly_here(flown, run_secret, folder, picture, record, stop)
        else:
            outcome = _fly_apart(flown, run_secret, output, beside, stop)
        _report(outcome, folder, json=json)
    _end(outcome, stop)


def _check_recording(record: Path | None) -> None:
    """Report a missing extra here, not in a child."""
    if record is not None:
        import outrider.recording.writer  # noqa: F401


def _check_in_process(in_process: bool, has_options: bool, has_external: bool) -> None:
    """Raise `typer.BadParameter` if a run in one process has an option that needs several."""
    needed = "several processes required; leave --in-process out"
    if in_process and has_options:
        raise typer.BadParameter(f"--realtime, --respawn, --with: {needed}")
    if in_process and has_external:
        raise typer.BadParameter(f"--driver external: {needed}")


def _report(outcome: "Outcome", folder: Path | None, *, json: bool) -> None:
    """Write and print the summary, if there is one."""
    from outrider.cli.console import print_json, print_summary
    from outrider.view.output import write_summary

    if outcome.summary is None:
        return
    if folder is not None:
        try:
            write_summary(outcome.summary, folder)
        except OSError as error:  # the summary is printed nevertheless
            outcome.fault = outcome.fault or f"{error.filename}: {error.strerror}"
    if json:
        print_json(outcome.summary)
    else:
        print_summary(outcome.summary, outcome.files)


def _fly_apart(
    flown: "Scenario", secret: str, output: "Output", beside: "tuple[Beside, ...]", stop: Stop
) -> "Outcome":
    from outrider.cli.console import flight_progress, print_warnings
    from outrider.running.launch import Watcher, launch

    with flight_progress(flown, "starting (the first start compiles)") as progress:
        watcher = Watcher(
            on_tick=progress.show,
            on_event=progress.say,
            on_warnings=print_warnings,
            stop=lambda: stop.count,
            companions=beside,
        )
        return launch(flown, watcher, output, secret=secret)


def _check_processes(flown: "Scenario", allowed: int) -> None:
    """Check the number of processes against its limit; 0: the run starts none.

    Raises:
        ScenarioError: If the run needs more processes.
    """
    outside = sum(DRIVERS[ugv.driver].outside for ugv in flown.ugv)
    wanted = 1 + len(flown.vehicles) - outside
    if 0 < allowed < wanted:
        raise ScenarioError(
            f"{flown.name}: needs {wanted} processes; allowed: {allowed}; add --allow-processes {wanted} or "
            "--in-process"
        )


def _fly_here(
    flown: "Scenario",
    secret: str,
    folder: Path | None,
    picture: bool,
    record: Path | None,
    stop: Stop,
) -> "Outcome":
    from outrider.cli.console import flight_progress, print_warnings
    from outrider.running.assumptions import assumption_warnings
    from outrider.running.flying import fly
    from outrider.running.launch import Outcome
    from outrider.running.warming import warm_up_flight
    from outrider.view.output import write_flight
    from sim.server.flight import Flight

    print_warnings(assumption_warnings(flown))
    shown = 0.0
    recorder = None
    if record is not None:
        from outrider.recording.writer import FlightRecorder

        recorder = FlightRecorder(record, flown, flown.seed, secret=secret)

    def follow(flight: Flight, progress: "FlightProgress") -> None:
        nonlocal shown
        if recorder is not None:
            recorder.tick(flight)
        if stop:
            flight.stop()
        now = time.monotonic()
        if now - shown > 0.1 or flight.over:
            shown = now
            progress.show(flight.world.tick)

    with flight_progress(flown, "compiling") as progress:
        warm_up_flight(flown)
        flight, summary = fly(
            flown, flown.seed, secret=secret, on_tick=lambda flight: follow(flight, progress)
        )
    outcome = Outcome(summary=summary)
    if recorder is not None and record is not None:
        try:
            recorder.close()
            outcome.files.append(record)
        except OSError as error:
            outcome.fault = f"{error.filename or record}: {error.strerror or error}"
    if folder is not None:
        try:
            outcome.files += write_flight(flight, summary, folder, picture=picture)
        except OSError as error:
            outcome.fault = f"{error.filename or folder}: {error.strerror or error}"
    return outcome


def _end(outcome: "Outcome", stop: Stop) -> None:
    from outrider.cli.console import ERR

    if stop:
        if outcome.summary is None:
            ERR.tell("outrider: interrupted before the first tick; there are no results")
        raise typer.Exit(stop.exit_code)
    if outcome.fault:
        unusable = outcome.unusable and outcome.summary is None
        raise (ScenarioError if unusable else PeerLost)(outcome.fault)
