"""Work of `outrider replay`."""

import time
from pathlib import Path
from typing import Any

import msgspec
import typer
from rich.progress import TextColumn
from rich.text import Text

from outrider.cli.console import ERR, OUT, bar, print_json
from outrider.cli.stopping import stop_on_signals
from outrider.cli.summary_table import print_summary
from outrider.recording.reader import Recording, flight_of
from outrider.recording.refly import from_the_start, refly, restore
from outrider.running.summary import certificate_fields, summarize


def replay(
    file: Path, flight: int | None, *, again: bool, realtime: float | None, json: bool
) -> None:
    """Read a recording, and fly it again or print its summary.

    Raises:
        Exit: If a flight again differs from the recording, or a signal ended the playback.
        ScenarioError: If the recording cannot be read.
    """
    recording = flight_of(file, flight)
    if again:
        _refly(recording, json=json)
        return
    if realtime is not None:
        _play(recording, realtime)
    _print_recording(recording, json=json)


def _refly(recording: Recording, *, json: bool) -> None:
    """Fly the recorded commands again, and print the first difference."""
    with ERR.status("flying it again"):
        found = refly(recording)
    same = found.difference is None
    if json:
        facts: dict[str, Any] = {
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
        print_json(facts)
    else:
        differs = f"differs from {found.difference}"
        verdict = ("identical to the last bit", "green") if same else (differs, "red")
        OUT.tell(Text.assemble(f"{recording.path}: {found.ticks} ticks flown again, ", verdict))
        OUT.tell(f"  trajectory_sha256 {found.trajectory_sha256}")
        if found.note:
            OUT.tell(f"  {found.note}")
    if not same:
        raise typer.Exit(1)


def _play(recording: Recording, speed: float) -> None:
    """Play the recording at `speed` [simulated seconds per second]."""
    truths = recording.truths
    begin, end = truths[0].time, truths[-1].time
    columns = (
        TextColumn("{task.fields[seconds]:>7.1f} s", markup=False),
        TextColumn("{task.fields[state]}"),
    )
    with bar(*columns) as progress, stop_on_signals() as stop:
        task = progress.add_task("playing", total=max(end - begin, 1e-9), seconds=begin, state="")
        started, row = time.monotonic(), 0
        while not stop and row < len(truths):
            now = begin + (time.monotonic() - started) * speed
            while row < len(truths) and truths[row].time <= now:
                row += 1
            shown = truths[max(row - 1, 0)]
            pairs = [(escort.distance, escort.coverage_error) for escort in shown.escorts]
            state = "distance {:.2f} m, e = {:.1f} m²".format(*max(pairs)) if pairs else "no UAV"
            progress.update(task, completed=shown.time - begin, seconds=shown.time, state=state)
            time.sleep(0.05)
    if stop:
        raise typer.Exit(stop.exit_code)


def _print_recording(recording: Recording, *, json: bool) -> None:
    facts = _facts(recording)
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
            print_json({**msgspec.to_builtins(summary), **facts})
            return
        print_summary(summary, [])
    elif json:
        print_json(facts)
        return
    else:
        OUT.tell(
            f"{facts['scenario']}, seed {facts['seed']}: recorded by an observer, ticks {facts['first_tick']} to "
            f"{facts['last_tick']}"
        )
        OUT.tell(
            f"  distance: largest {facts['max_distance']:.3f} m, mean {facts['mean_distance']:.3f} m"
        )
    whole = "complete" if facts["whole"] else f"incomplete: {facts['reason']}"
    missing = f", {facts['missing_ticks']} ticks missing" if facts["missing_ticks"] else ""
    size = f"{facts['bytes'] / 1e6:.2f} MB, {facts['bytes_per_minute'] / 1e6:.2f} MB per simulated minute"
    OUT.tell(f"  {recording.path}: {size}, {whole}{missing}")


def _wall_time(recording: Recording) -> float:
    """Return the wall time of the flight [s], from the real-time factors of its status; 0: unknown."""
    factors, flown = recording.factors, recording.truths[-1].time - recording.truths[0].time
    return flown * sum(1.0 / factor for factor in factors) / len(factors) if factors else 0.0


def _facts(recording: Recording) -> dict[str, Any]:
    """Return the facts that every recording contains."""
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
