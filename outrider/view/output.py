"""Output files of a run: trajectory, coverage, picture, scenario and summary."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from bus.files import create_unused, write_whole, writing
from outrider.running.summary import Summary
from sim.scenario.resolved import as_toml

if TYPE_CHECKING:
    from sim.server.flight import Flight

TRAJECTORY = "trajectory.csv"
PICTURE = "flight.png"
COVERAGE = "coverage.npy"
SUMMARY = "summary.json"
SCENARIO = "scenario.toml"
"""Scenario that was flown, with all options applied."""


@contextmanager
def output_folder(given: Path | None, scenario: str) -> Iterator[Path]:
    """Create the folder of a run before the flight, so that a failure shows early; remove it afterwards if it is empty.

    Args:
        given: The user's folder; None: a new one in `runs`, named by time and scenario.
        scenario: Name of the scenario.

    Raises:
        OSError: If the folder cannot be created.
    """
    stamp = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    wanted = given or Path("runs") / f"{stamp}-{scenario or 'scenario'}"
    new = [one for one in (wanted, *wanted.parents) if not one.exists()]
    if given is None:
        folder = create_unused(wanted, folder=True)
        new = [folder, *(one for one in new if one != wanted)]
    else:
        folder = given
        folder.mkdir(parents=True, exist_ok=True)
    try:
        yield folder
    finally:
        with suppress(OSError):  # folders with content stay
            for one in new:
                one.rmdir()


def write_summary(summary: Summary, folder: Path) -> Path:
    """Write the summary as JSON; with a secret, the file is readable by its owner only."""
    path = folder / SUMMARY
    content = msgspec.json.format(msgspec.json.encode(summary), indent=2) + b"\n"
    write_whole(path, content, private=bool(summary.secret))
    return path


def write_flight(
    flight: "Flight", summary: Summary, folder: Path, *, picture: bool = True
) -> list[Path]:
    """Write the output files of a flight.

    Args:
        flight: Flight with its record.
        summary: Summary of the flight.
        folder: Folder for the files; created if missing. Files of an earlier run are replaced.
        picture: True: draw the picture.

    Returns:
        The files.

    Raises:
        OSError: If a file cannot be written; all other files are written nevertheless.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scenario = msgspec.structs.replace(flight.scenario, seed=flight.seed)
    # Smallest files first, so that a full disk loses as few as possible.
    work: dict[str, Callable[[Path], object]] = {
        SUMMARY: lambda path: write_summary(summary, path.parent),
        SCENARIO: lambda path: path.write_text(as_toml(scenario), encoding="utf-8"),
        COVERAGE: lambda path: np.save(path, flight.world.coverage),
        TRAJECTORY: flight.recorder.write,
    }
    if picture:
        from outrider.view.flight_picture import draw_flight  # noqa: PLC0415 - matplotlib is slow to load

        work[PICTURE] = lambda path: draw_flight(flight, path)
    files: list[Path] = []
    faults: list[OSError] = []
    for name, write in work.items():
        path = folder / name
        try:
            with writing(path):
                write(path)
            files.append(path)
        except OSError as error:
            faults.append(error)
    if faults:
        raise faults[0]
    return files
