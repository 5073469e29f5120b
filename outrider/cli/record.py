"""`outrider record`: the record of a run in progress, and the repair of one that was killed."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import TextColumn

from bus import plugins
from bus.errors import PeerLost, ScenarioError
from bus.keys import Role
from outrider.cli import options
from outrider.cli.console import ERR, bar, print_json
from outrider.cli.stopping import Stop, stop_on_signals
from outrider.cli.waiting import RouterTimer
from outrider.running.resolve import resolve

if TYPE_CHECKING:
    from bus.session import Session
    from outrider.recording.observer import RunRecorder, RunSink

_MCAP = "mcap"


Out = Annotated[
    Path | None,
    typer.Argument(help="The file to write, such as run.mcap; one that is there is replaced."),
]
Repair = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Save what is whole of a killed recording; nothing is recorded."
    ),
]
Format = Annotated[
    str,
    typer.Option(
        "--format",
        metavar="NAME",
        help="Format: mcap, or that of an extension, such as ros2, which writes a bag into a new folder.",
    ),
]
Flown = Annotated[
    str,
    typer.Option(
        help="What is flown there, name or file: with it the flight can be drawn and flown again."
    ),
]


def command(
    out: Out = None,
    repair: Repair = None,
    form: Format = _MCAP,
    connect: options.Connect = options.DEFAULT_ENDPOINT,
    run: options.RunName = options.DEFAULT_RUN,
    credentials: options.CredentialFile = None,
    scenario: Flown = "",
    changes: options.Set = None,
    json: options.Json = False,
) -> None:
    """Record a run in progress into an MCAP file.

    It observes and disturbs nobody. Ends with the run, or at Ctrl-C.

    The run's own `--record` keeps every tick whatever happens; an observer of a fast run in lockstep may miss some, and
    says so. A recording whose process was killed can be replayed as it is; with --repair every whole record of it goes
    to a new file, FILE with the ending .repaired.mcap, that any program for MCAP opens.

    With --format ros2 the record is a bag that ros2 bag play and Foxglove take as it is; outrider ros2 import makes a
    recording of it. Of a killed one nothing stays.

    Example: outrider record run.mcap --connect tcp/127.0.0.1:17447 --credentials credentials/observer.json

    Example: outrider record bag --format ros2 --scenario escort

    Example: outrider record --repair run.mcap
    """
    if repair is not None:
        if form != _MCAP:
            raise typer.BadParameter("--repair mends MCAP files; leave --format out")
        _repair(repair, out or repair.with_suffix(".repaired.mcap"), json=json)
        return
    if out is None:
        raise typer.BadParameter("name the file to write, such as: outrider record run.mcap")
    from outrider.recording.observer import RunRecorder

    sink = _sink(form, out)
    known = resolve(scenario, changes=changes)[0] if scenario else None
    with (
        stop_on_signals() as stop,
        options.join(Role.OBSERVER, run, connect, credentials) as session,
    ):
        recorder = RunRecorder(session, sink(out), known)
        if not ERR.is_terminal:  # there the bar says it
            ERR.tell(f"{out}: waiting for the run")
        try:
            lost = _follow(session, recorder, stop)
        finally:
            with ERR.status(f"ending {out}"):
                recorder.close()
    if json:
        told = {"file": str(out), "bytes": options.size_of(out), "router_lost": lost}
        print_json(recorder.counts() | told)
    else:
        ERR.tell(f"{out}: {recorder.story()}")
    if lost:
        raise PeerLost(f"the router at {connect} has gone; what came before it went is in {out}")


def _sink(form: str, out: Path) -> "Callable[[Path], RunSink]":
    """Return the writer of a format; an entry point `outrider.sinks` writes a path that is not there.

    Raises:
        ScenarioError: If there is no such format, a library of it is missing, or the path is there.
    """
    if form == _MCAP:
        from outrider.recording.mcap_file import RecordingFile

        return RecordingFile
    known = plugins.registered("sinks")
    if form not in known:
        allowed = ", ".join((_MCAP, *sorted(known)))
        raise ScenarioError(f"--format {form}: no such format; allowed: {allowed}")
    sink: Callable[[Path], RunSink] = plugins.load(known[form])
    if extra := plugins.extra_of(known[form]):
        plugins.require(extra, f"--format {form}")
    if out.exists() or out.is_symlink():
        raise ScenarioError(f"{out}: is there already; allowed: the name of a new file or folder")
    return sink


def _follow(session: "Session", recorder: "RunRecorder", stop: Stop) -> bool:
    """Record until the run is over or somebody wants the end; whether it was the router that went."""
    told = "{task.fields[seconds]:>7.1f} s simulated, {task.fields[missing]} ticks missing"
    router = RouterTimer(session)
    with bar(TextColumn(told)) as progress:
        task = progress.add_task("waiting for the run", total=None, seconds=0.0, missing=0)
        while not stop and not recorder.over:
            recorder.take(0.2)
            progress.update(
                task,
                description="recording" if recorder.ticks else "waiting for the run",
                completed=recorder.newest_tick,
                total=recorder.ticks_of_run,
                seconds=recorder.newest_time,
                missing=recorder.missing_ticks,
            )
            if router.has_gone():
                return True
    return False


def _repair(killed: Path, out: Path, *, json: bool) -> None:
    from outrider.recording.repair import repair

    saved = repair(killed, out)
    if json:
        print_json({"file": str(out), **asdict(saved)})
        return
    what = (
        f"{saved.reason}, {saved.lost_bytes} bytes lost"
        if saved.reason
        else "nothing was wrong with it"
    )
    ERR.tell(f"{out}: {saved.messages} messages of {killed} ({what})")
