"""`outrider record`: recording of a run in progress, and repair of a damaged recording."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import TextColumn

from bus import plugins
from bus.errors import PeerLost, ScenarioError
from bus.keys import Role
from bus.session import Session
from outrider.cli import options
from outrider.cli.console import ERR, bar, print_json
from outrider.cli.joining import join
from outrider.cli.stopping import Stop, stop_on_signals
from outrider.cli.waiting import RouterTimer
from outrider.recording.observer import RunRecorder, RunSink
from outrider.running.resolve import resolve

_MCAP = "mcap"


Out = Annotated[
    Path | None,
    typer.Argument(help="File to write, such as run.mcap; an existing file is replaced."),
]
Repair = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Repair the recording of a killed process; record nothing."),
]
Format = Annotated[
    str,
    typer.Option(
        "--format",
        metavar="NAME",
        help="Set the format: mcap, or an extension's, such as ros2.",
    ),
]
Flown = Annotated[
    str,
    typer.Option(help="Store the run's scenario, so that the recording can be flown again."),
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
    """Record a run in progress to an MCAP file.

    The recorder only observes the run. It exits at the end of the run, or at Ctrl-C.

    `outrider run --record` records every tick. An observer of a fast run in lockstep may miss ticks, and reports their
    number. If the recording process is killed, the file can still be replayed. --repair writes all its complete
    records to a new file (.repaired.mcap) that every MCAP program opens.

    --format ros2 writes a bag into a new folder, for ros2 bag play and Foxglove; outrider ros2 import converts it to a
    recording. If the process is killed, the bag is lost.

    Example: outrider record run.mcap --connect tcp/127.0.0.1:17447 --credentials credentials/observer.json

    Example: outrider record bag --format ros2 --scenario escort

    Example: outrider record --repair run.mcap
    """
    if repair is not None:
        if form != _MCAP:
            raise typer.BadParameter("--repair needs an MCAP file; leave --format out")
        _repair(repair, out or repair.with_suffix(".repaired.mcap"), json=json)
        return
    if out is None:
        raise typer.BadParameter("OUT is missing; allowed: a file to write, such as run.mcap")
    sink = _sink(form, out)
    known = resolve(scenario, changes=changes)[0] if scenario else None
    with (
        stop_on_signals() as stop,
        join(Role.OBSERVER, run, connect, credentials) as session,
    ):
        recorder = RunRecorder(session, sink(out), known)
        if not ERR.is_terminal:  # on a terminal, the bar shows it
            ERR.tell(f"{out}: waiting for the run")
        try:
            lost = _follow(session, recorder, stop)
        finally:
            with ERR.status(f"closing {out}"):
                recorder.close()
    if json:
        facts = {"file": str(out), "bytes": options.size_of(out), "router_lost": lost}
        print_json(recorder.counts() | facts)
    else:
        ERR.tell(f"{out}: {recorder.description()}")
    if lost:
        raise PeerLost(f"the router at {connect} disconnected; all earlier ticks are in {out}")


def _sink(form: str, out: Path) -> Callable[[Path], RunSink]:
    """Return the writer of a format; writers of entry points `outrider.sinks` need a new path.

    Raises:
        ScenarioError: If the format is unknown, one of its libraries is missing, or the path exists.
    """
    if form == _MCAP:
        from outrider.recording.mcap_file import RecordingFile  # noqa: PLC0415 - the extra [record]

        return RecordingFile
    known = plugins.registered("sinks")
    if form not in known:
        allowed = ", ".join((_MCAP, *sorted(known)))
        raise ScenarioError(f"--format {form}: unknown format; allowed: {allowed}")
    sink: Callable[[Path], RunSink] = plugins.load(known[form])
    if extra := plugins.extra_of(known[form]):
        plugins.require(extra, f"--format {form}")
    if out.exists() or out.is_symlink():
        raise ScenarioError(f"{out}: exists already; allowed: the name of a new file or folder")
    return sink


def _follow(session: Session, recorder: RunRecorder, stop: Stop) -> bool:
    """Record until the run is over or a signal arrives; return true if the router disconnected."""
    counts = "{task.fields[seconds]:>7.1f} s simulated, {task.fields[missing]} ticks missing"
    router = RouterTimer(session)
    with bar(TextColumn(counts)) as progress:
        task = progress.add_task("waiting for the run", total=None, seconds=0.0, missing=0)
        while not stop and not recorder.over:
            recorder.record(0.2)
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
    from outrider.recording.repair import repair  # noqa: PLC0415 - the extra [record]

    saved = repair(killed, out)
    if json:
        print_json({"file": str(out), **asdict(saved)})
        return
    what = (
        f"{saved.reason}, {saved.lost_bytes} bytes lost"
        if saved.reason
        else "the file was undamaged"
    )
    ERR.tell(f"{out}: {saved.messages} messages of {killed} ({what})")
