"""`outrider simulator`: the process that knows the truth, with the router inside."""

import time
from pathlib import Path
from typing import Annotated

import typer

from outrider.cli.options import (
    DEFAULT_ENDPOINT,
    DEFAULT_RUN,
    Duration,
    Json,
    LawName,
    Leash,
    RunName,
    ScenarioName,
    Seed,
    Set,
)


def command(
    scenario: ScenarioName = "escort",
    listen: Annotated[list[str] | None, typer.Option(help=f"Endpoint to listen on; {DEFAULT_ENDPOINT} by default.")] = None,
    run: RunName = DEFAULT_RUN,
    seed: Seed = None,
    duration: Duration = None,
    law: LawName = None,
    changes: Set = None,
    deadline: Annotated[float, typer.Option(help="Seconds to wait for the commands of one tick.", min=0.01)] = 10.0,
    join_timeout: Annotated[float, typer.Option(help="Seconds to wait for all vehicles.", min=0.0)] = 30.0,
    out: Annotated[Path | None, typer.Option(help="Folder for trajectory, picture and summary; none by default.")] = None,
    picture: Annotated[bool, typer.Option(help="Draw the picture too.")] = True,
    json: Json = False,
    events: Annotated[bool, typer.Option(hidden=True, help="Report on stdout as JSON lines, for a parent process.")] = False,
    leash: Leash = False,
    leash_folder: Annotated[Path | None, typer.Option(hidden=True, help="Removed when the parent has gone.")] = None,
) -> None:
    """Simulate: wait for the scenario's vehicles, fly it with them in lockstep, and sum it up.

    Example: outrider simulator escort --listen tcp/127.0.0.1:17447 --out runs/mine
    """
    from bus.keys import SIMULATOR_NAME, Party, Role
    from bus.session import open_session
    from outrider.cli.console import ERR, flight_progress, print_json, print_summary, print_warnings
    from outrider.cli.options import scenario_of
    from outrider.cli.stopping import stop_on_signals
    from outrider.leash import hold
    from outrider.output import write_flight
    from outrider.reports import Reports
    from outrider.summary import summarize
    from sim.compile import compiling
    from sim.flight import warm_up
    from sim.scenario_checks import scenario_warnings
    from sim.server import Server

    if leash:
        hold(leash_folder)
    flown, _ = scenario_of(scenario, seed=seed, duration=duration, law=law, changes=changes)
    with compiling():
        warm_up(flown)
    endpoints = tuple(listen or (DEFAULT_ENDPOINT,))
    reports = Reports(enabled=events)
    if not events:
        print_warnings(scenario_warnings(flown))
        ERR.print(f"listening on {', '.join(endpoints)}, run {run}: waiting for {', '.join(v.name for v in flown.vehicles)}")
    with stop_on_signals() as stop:
        party = Party(role=Role.SIMULATOR, name=SIMULATOR_NAME)
        with (
            open_session(party, run, listen=endpoints) as session,
            reports.progress() if events else flight_progress(flown, "waiting") as progress,
        ):
            server = Server(
                session,
                flown,
                flown.seed,
                deadline=deadline,
                join_timeout=join_timeout,
                on_event=progress.say,
                stop=lambda: bool(stop),
            )
            shown = 0.0

            def on_tick() -> None:
                nonlocal shown
                now = time.monotonic()
                if now - shown > 0.1 or flight.over:
                    shown = now
                    progress.show(flight.world.tick)

            flight = server.flight
            server.fly(on_tick=on_tick)
            seconds = time.perf_counter() - server.started
    if not flight.recorder.rows:
        raise typer.Exit(stop.exit_code)
    summary = summarize(flight, seconds=seconds)
    reports.summary(summary)  # first of all, so that a full disk does not take it
    files = write_flight(flight, summary, out, picture=picture) if out else []
    reports.files(files)
    if json:
        print_json(summary)
    elif not events:
        print_summary(summary, files)
    raise typer.Exit(stop.exit_code)
