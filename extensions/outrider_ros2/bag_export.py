"""Work of `outrider ros2 export`."""

from pathlib import Path

import typer

from outrider.cli.console import ERR, print_json, share_progress
from outrider.cli.options import size_of
from outrider.cli.stopping import stop_on_signals
from outrider.recording.reader import flight_of
from outrider_ros2.ros_bag import RosBag, check_target, copy_flight


def export_recording(file: Path, bag: Path, flight: int | None, *, json: bool) -> None:
    """Export one flight of a recording as a bag."""
    check_target(bag)  # before a long recording is read
    recording = flight_of(file, flight)
    with (
        stop_on_signals() as stop,
        RosBag(bag) as written,
        share_progress("writing the bag") as show,
    ):
        for seconds in copy_flight(recording, written):
            show("writing the bag", seconds / max(recording.truths[-1].time, 1e-9))
            if stop:
                raise typer.Exit(stop.exit_code)
    size, messages = size_of(bag), sum(written.topics.values())
    found = {"file": str(file), "flight": recording.number, "bag": str(bag), "bytes": size}
    if json:
        print_json(found | {"messages": messages, "topics": written.topics})
    else:
        topics = len(written.topics)
        ERR.tell(f"{bag}: {messages} messages on {topics} topics, {size / 1e6:.2f} MB")
