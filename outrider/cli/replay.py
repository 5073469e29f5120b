"""`outrider replay`: what a recording tells, and whether it flies the same again."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer
from rich.progress import TextColumn
from rich.text import Text

from outrider.cli.console import ERR, OUT, bar, print_json, print_summary
from outrider.cli.main import call_command
from outrider.cli.options import Companions, FlightNumber, Json
from outrider.cli.stopping import stop_on_signals
from outrider.running.companions import parse_companion
from outrider.running.summary import certificate_fields, summarize

if TYPE_CHECKING:
    from outrider.recording.reader import Recording


def command(
    file: Annotated[
        Path,
        typer.Argument(help="A recording, also one whose process was killed."),
    ],
    refly: Annotated[
        bool,
        typer.Option(
            "--refly",
            help="Fly the recorded commands through the simulator again and compare every tick.",
        ),
    ] = False,
    realtime: Annotated[
        float | None,
        typer.Option(
            "--realtime",
            metavar="F",
            help="Play it, F simulated seconds a second; Ctrl-C ends it.",
            min=0.01,
            max=1e6,
        ),
    ] = None,
    companions: Companions = None,
    flight: FlightNumber = None,
    json: Json = False,
) -> None:
    """Tell the numbers of a recorded run, or fly it again.

    It says whether the file is whole. With --refly the recorded commands go through the same simulator again, without
    pilots: exit code 0 where every position, velocity and applied command is the same to the last bit, 1 at the first
    that is not, which is named.

    Example: outrider replay run.mcap --refly
    """
    if companions and (refly or json):
        raise typer.BadParameter("--with plays, --refly and --json tell; leave one out")
    if companions:
        _play_with(companions, file, flight, realtime)
        return
    from outrider.recording.reader import flight_of

    recording = flight_of(file, flight)
    if refly:
        _refly(recording, json=json)
        return
    if realtime is not None:
        _play(recording, realtime)
    _tell(recording, json=json)


def _refly(recording: "Recording", *, json: bool) -> None:

    from outrider.recording.refly import refly

    with ERR.status("flying it again"):
        found = refly(recording)
    same = found.difference is None
    if json:
        told: dict[str, Any] = {
            "file": str(recording.path),
            "same": same,
            "ticks": found.ticks,
            "trajectory_sha256": found.trajectory_sha256,
            "recorded_sha256": found.recorded_sha256,
            "difference": found.difference,
            "note": found.note,
            **certificate_fields(recording.certificates),
            "mission": recording.mission,
        }
        print_json(told)
    else:
        differs = f"differs from {found.difference}"
        verdict = ("the same to the last bit", "green") if same else (differs, "red")
        OUT.tell(Text.assemble(f"{recording.path}: {found.ticks} ticks flown again, ", verdict))
        OUT.tell(f"  trajectory_sha256 {found.trajectory_sha256}")
        if found.note:
            OUT.tell(f"  {found.note}")
    if not same:
        raise typer.Exit(1)


def _play_with(asked: list[str], file: Path, flight: int | None, realtime: float | None) -> None:

    if len(asked) > 1:
        raise typer.BadParameter("--with: one companion plays a recording")
    name, words, companion = parse_companion(asked[0])
    if not companion.replays:
        raise typer.BadParameter(f"--with {name}: it plays no recordings")
    given = {"--replay": file.absolute(), "--flight": flight, "--realtime": realtime}
    told = [
        word
        for option, value in given.items()
        if value is not None
        for word in (option, str(value))
    ]
    call_command(name, [*told, *words])


def _play(recording: "Recording", speed: float) -> None:
    """Let simulated time pass at this speed."""
    truths = recording.truths
    begin, end = truths[0].time, truths[-1].time
    columns = (
        TextColumn("{task.fields[seconds]:>7.1f} s", markup=False),
        TextColumn("{task.fields[told]}"),
    )
    with bar(*columns) as progress, stop_on_signals() as stop:
        task = progress.add_task("playing", total=max(end - begin, 1e-9), seconds=begin, told="")
        started, row = time.monotonic(), 0
        while not stop and row < len(truths):
            now = begin + (time.monotonic() - started) * speed
            while row < len(truths) and truths[row].time <= now:
                row += 1
            shown = truths[max(row - 1, 0)]
            pairs = [(escort.distance, escort.coverage_error) for escort in shown.escorts]
            told = "distance {:.2f} m, e = {:.1f} m²".format(*max(pairs)) if pairs else "no UAV"
            progress.update(task, completed=shown.time - begin, seconds=shown.time, told=told)
            time.sleep(0.05)
    if stop:
        raise typer.Exit(stop.exit_code)


def _tell(recording: "Recording", *, json: bool) -> None:
    from outrider.recording.refly import from_the_start, restore

    told = _facts(recording)
    if recording.head.scenario is not None and from_the_start(recording):
        seconds = _wall_time(recording)
        restored = restore(recording)
        summary = msgspec.structs.replace(
            summarize(restored, seconds=seconds),
            platform=recording.head.platform,
            links=recording.links,
            **certificate_fields(recording.certificates),
            mission=recording.mission,
        )
        if json:
            print_json({**msgspec.to_builtins(summary), **told})
            return
        print_summary(summary, [])
    elif json:
        print_json(told)
        return
    else:
        OUT.tell(
            f"{told['scenario']}, seed {told['seed']}: recorded by an observer, ticks {told['first_tick']} to "
            f"{told['last_tick']}"
        )
        OUT.tell(
            f"  distance: largest {told['max_distance']:.3f} m, mean {told['mean_distance']:.3f} m"
        )
    whole = "whole" if told["whole"] else f"not whole: {told['reason']}"
    missing = f", {told['missing_ticks']} ticks missing" if told["missing_ticks"] else ""
    size = f"{told['bytes'] / 1e6:.2f} MB, {told['bytes_per_minute'] / 1e6:.2f} MB per simulated minute"
    OUT.tell(f"  {recording.path}: {size}, {whole}{missing}")


def _wall_time(recording: "Recording") -> float:
    """Returns the time that the flight took [s], from the speeds that its status told; 0: not known."""
    factors, flown = recording.factors, recording.truths[-1].time - recording.truths[0].time
    return flown * sum(1.0 / factor for factor in factors) / len(factors) if factors else 0.0


def _facts(recording: "Recording") -> dict[str, Any]:
    """Returns the facts that any recording tells."""
    truths, damage = recording.truths, recording.damage
    distances = [escort.distance for truth in truths for escort in truth.escorts]
    minutes = (truths[-1].time - truths[0].time) / 60.0
    return {
        "file": str(recording.path),
        "flight": recording.number,
        "scenario": recording.head.name,
        "seed": recording.head.seed,
        "recorded_with": recording.head.outrider,
        "first_tick": truths[0].tick,
        "last_tick": truths[-1].tick,
        "missing_ticks": recording.missing_ticks,
        "max_distance": max(distances, default=None),
        "mean_distance": sum(distances) / len(distances) if distances else None,
        "whole": not damage.reason,
        "reason": damage.reason,
        "bytes": damage.size,
        "bytes_per_minute": damage.size / minutes if minutes > 0.0 else 0.0,
    }
