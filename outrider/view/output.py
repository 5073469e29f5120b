"""The files of a run: the trajectory, the picture and the summary."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from bus.files import write_whole, writing
from outrider.running.summary import Summary
from sim.scenario.resolved import as_toml

if TYPE_CHECKING:
    from sim.server.flight import Flight

TRAJECTORY = "trajectory.csv"
PICTURE = "flight.png"
COVERAGE = "coverage.npy"
SUMMARY = "summary.json"
SCENARIO = "scenario.toml"
"""The scenario that was flown, with all options applied."""


def default_folder(scenario: str) -> Path:
    """A folder that no run before has used, named by time and scenario."""
    stamp = datetime.now().astimezone().strftime("%Y%m%d-%H%M%S")
    folder = Path("runs") / f"{stamp}-{scenario or 'scenario'}"
    taken = 1
    while folder.exists():
        taken += 1
        folder = Path("runs") / f"{stamp}-{scenario or 'scenario'}-{taken}"
    return folder


@contextmanager
def making(folder: Path | None) -> Iterator[None]:
    """Make a folder before the flight: if it cannot be made it shows. With nothing in it in the end it goes again.

    Raises:
        OSError: If it cannot be made.
    """
    wanted = [] if folder is None else [folder, *folder.parents]
    new = [one for one in wanted if not one.exists()]
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):  # one that holds something stays, and so do those that it is in
            for one in new:
                one.rmdir()


def write_summary(summary: Summary, folder: Path) -> Path:
    """Write the summary as JSON; where it tells a secret, for the file's owner alone."""
    path = folder / SUMMARY
    content = msgspec.json.format(msgspec.json.encode(summary), indent=2) + b"\n"
    write_whole(path, content, private=bool(summary.secret))
    return path


def write_flight(
    flight: "Flight", summary: Summary, folder: Path, *, picture: bool = True
) -> list[Path]:
    """Write all there is of a flight.

    Args:
        flight: What was flown.
        summary: Its summary.
        folder: Is made if it is not there; files of an earlier run in it are replaced.
        picture: Whether to draw it.

    Returns:
        The files.

    Raises:
        OSError: If a file cannot be written; all that can be are there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scenario = msgspec.structs.replace(flight.scenario, seed=flight.seed)
    work: dict[
        str, Callable[[Path], object]
    ] = {  # the smallest first: what is there when the disk is full is there
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
