"""Work of `outrider ros2 import`, which needs only the extra of recordings."""

from pathlib import Path

import typer

from outrider.cli.console import ERR, print_json
from outrider.cli.stopping import stop_on_signals
from outrider.recording.reader import Damage
from outrider_ros2.bag_reader import import_bag


def import_recording(bag: Path, file: Path, *, json: bool) -> None:
    """Import the recording in a bag as an MCAP file."""
    damage, messages = Damage(), 0
    with stop_on_signals() as stop:
        for _ in import_bag(bag, file, damage):
            messages += 1
            if stop:
                break
    if stop:
        file.unlink(missing_ok=True)
        raise typer.Exit(stop.exit_code)
    if json:
        whole = {"whole": not damage.reason, "reason": damage.reason}
        print_json({"bag": str(bag), "file": str(file), "messages": messages} | whole)
    else:
        ERR.tell(
            f"{file}: {messages} messages{f', incomplete: {damage.reason}' if damage.reason else ''}"
        )
