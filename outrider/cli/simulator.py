"""`outrider simulator`: the process that knows the truth, with the router inside."""

import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated

import typer

from bus.keys import SIMULATOR_NAME, Party, Role
from outrider.cli import options
from outrider.cli.stopping import stop_on_signals


def command(
    scenario: Annotated[
        str,
        typer.Argument(
            help="A shipped scenario's name, or a TOML file.", envvar="OUTRIDER_SCENARIO"
        ),
    ] = "escort",
    listen: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Host the router, on this endpoint; {options.DEFAULT_ENDPOINT} by default."
        ),
    ] = None,
    connect: Annotated[
        str,
        typer.Option(
            help="Use the router at this endpoint instead of hosting one.",
            envvar="OUTRIDER_CONNECT",
        ),
    ] = "",
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    insecure: options.Insecure = False,
    seed: Annotated[
        int | None,
        typer.Option(
            help="Seed of all random numbers; the scenario's own by default.",
            min=0,
            max=2**53 - 1,
            envvar="OUTRIDER_SEED",
        ),
    ] = None,
    secret: options.Secret = "",
    duration: Annotated[
        float | None,
        typer.Option(
            help="Simulated time in s, instead of the scenario's.", envvar="OUTRIDER_DURATION"
        ),
    ] = None,
    law: options.LawName = None,
    driver: options.DriverName = None,
    network: options.NetworkName = "",
    changes: options.Set = None,
    realtime: options.RealTime = None,
    join_timeout: Annotated[
        float | None,
        typer.Option(
            help="Seconds to wait for vehicles, or a router that is away; the scenario's by default.",
            min=0.0,
            envvar="OUTRIDER_JOIN_TIMEOUT",
        ),
    ] = None,
    respawn: Annotated[
        bool,
        typer.Option("--respawn", help="Let the clock stand still until a lost vehicle is back."),
    ] = False,
    record: options.Record = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Folder for trajectory, picture and summary; none by default."
        ),
    ] = None,
    picture: Annotated[bool, typer.Option(help="Draw the picture too.")] = True,
    json: options.Json = False,
    child: options.Child = False,
) -> None:
    """Simulate a scenario for vehicles that join over Zenoh.

    It waits for them, flies with them, and sums the run up. In lockstep it goes as fast as they answer; with --realtime
    it keeps the wall clock. Where it hosts the router its credentials are the file with everybody's (router.json),
    where it uses another its own (simulator.json).

    Example: outrider simulator escort --listen tcp/127.0.0.1:17447 --out runs/mine
    """
    from bus.credentials import read_credentials
    from bus.joining import open_session
    from outrider.cli.console import (
        ERR,
        flight_progress,
        print_json,
        print_summary,
        print_warnings,
        tell_starting,
    )
    from outrider.running.assumptions import promise_warnings
    from outrider.running.exit_reports import Report, Reports
    from outrider.running.parent import Output, Start, read_start
    from outrider.running.resolve import resolve
    from outrider.running.summary import summarize
    from outrider.view.output import write_flight
    from sim.scenario.checks import scenario_warnings
    from sim.scenario.resolved import read_resolved
    from sim.server.flight import warm_up
    from sim.server.serving import Server

    if child:
        start = read_start()
        flown = read_resolved(Path(scenario))
    else:
        output = Output(folder=str(out or ""), picture=picture, record=str(record or ""))
        start = Start(output=output)
        flown, _ = resolve(
            scenario,
            seed=seed,
            duration=duration,
            law=law,
            driver=driver,
            network=network,
            realtime=realtime,
            join_timeout=join_timeout,
            respawn=respawn,
            changes=changes,
        )
    folder = Path(start.output.folder) if start.output.folder else None
    record = Path(start.output.record) if start.output.record else None
    endpoints = () if connect else tuple(listen or (options.DEFAULT_ENDPOINT,))
    # By which the router inside knows its clients, or the router elsewhere knows this one.
    given, credential = start.credentials, None
    if connect:
        credential = options.credential_of(credentials, Role.SIMULATOR, SIMULATOR_NAME)
    elif credentials is not None:
        given = read_credentials(credentials)
    options.check_endpoints(
        endpoints or (connect,), secured=given is not None or bool(connect), insecure=insecure
    )
    secured = given is not None or credential is not None
    # a parent has decided on the secret
    kept = start.secret if child else options.secret_of(secret, wanted=secured)
    reports = Reports(enabled=child)
    if not child:
        tell_starting()
    with ExitStack() as opened:
        # The router listens while the rest is compiled, so that vehicles need not wait to reach it.
        session = opened.enter_context(
            open_session(
                Party(role=Role.SIMULATOR, name=SIMULATOR_NAME),
                run,
                connect=connect,
                listen=endpoints,
                credential=credential,
                given=given,
                join_timeout=flown.run.join_timeout,
            )
        )
        warm_up(flown)
        promised = promise_warnings(flown)
        if child and promised:
            reports.write(Report(warnings=promised))  # of the scenario itself the parent has told
        if not child:
            print_warnings((*scenario_warnings(flown), *promised))
            where = (
                f"using the router at {connect}"
                if connect
                else f"listening on {', '.join(endpoints)}"
            )
            names = ", ".join(vehicle.name for vehicle in flown.vehicles)
            ERR.tell(f"{where}, run {run}: waiting for {names}")
            if endpoints and given is None:
                ERR.tell(
                    "no credentials: every process that reaches this endpoint may read and write everything"
                )
        # Not before: a signal ends the compiling at once.
        stop = opened.enter_context(stop_on_signals())
        recorder = None
        if record is not None:  # a file that cannot be written shows before anybody joins
            from outrider.recording.writer import FlightRecorder

            recorder = FlightRecorder(record, flown, flown.seed, secret=kept)
            opened.enter_context(closing(recorder))
        progress = reports if child else opened.enter_context(flight_progress(flown, "waiting"))

        def on_event(line: str) -> None:
            progress.say(line)
            if recorder is not None:
                recorder.event(line)

        server = Server(
            session,
            flown,
            flown.seed,
            secret=kept,
            on_event=on_event,
            stop=lambda: bool(stop),
            warn=promise_warnings,
        )
        if recorder is not None:
            recorder.vehicles = server.vehicles
        shown = 0.0

        def on_tick() -> None:
            nonlocal shown
            if recorder is not None:
                recorder.tick(server.flight)
            now = time.monotonic()
            if now - shown > 0.1 or server.flight.over:
                shown = now
                progress.show(server.flight.world.tick)

        try:
            server.fly(on_tick=on_tick)
        finally:
            seconds = time.perf_counter() - server.started
            flight, vehicles, late_ticks = server.flight, server.vehicles(), server.late_ticks
            # Also where the router was lost for good: what was flown is kept. Of a run that could not begin the
            # cause alone is told; only a vehicle that was started again and again has a report worth keeping.
            if flight.world.tick or (flown.run.respawn and flight.recorder.rows):
                summary = summarize(
                    flight,
                    seconds=seconds,
                    vehicles=vehicles,
                    realtime=flown.run.realtime or None,
                    late_ticks=late_ticks,
                    changes=server.changes,
                )
                # first of all, so that a full disk does not take it
                reports.write(Report(summary=summary))
                files: list[Path] = []
                try:
                    if folder is not None:
                        files += write_flight(flight, summary, folder, picture=start.output.picture)
                    files += [record] if record is not None else []
                    reports.write(Report(files=[str(file) for file in files]))
                finally:  # also where the disk is full
                    if json:
                        print_json(summary)
                    elif not child:
                        print_summary(summary, files)
    raise typer.Exit(stop.exit_code)
