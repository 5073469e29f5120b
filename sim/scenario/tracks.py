"""Recorded trajectories as scripts: a UGV repeats its trajectory from an earlier run."""

import csv
from io import TextIOWrapper
from itertools import islice
from pathlib import Path

import msgspec

from bus.errors import ScenarioError
from bus.files import open_regular
from bus.messages.scenario import ScriptStep
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Ugv

_MOST_BYTES = 32 << 20
"""Maximum size of a trajectory file [bytes]: more than an hour of two vehicles."""
_MOST_ROWS = 250_000


def with_tracks(scenario: Scenario, *, file: str) -> Scenario:
    """Return the scenario with scripts for all UGVs that have a `trajectory` and no script yet.

    Raises:
        ScenarioError: If a trajectory cannot be read, or does not contain the UGV.
    """
    ugvs = tuple(
        _with_track(ugv, k, file) if ugv.trajectory and not ugv.script else ugv
        for k, ugv in enumerate(scenario.ugv)
    )
    return scenario if ugvs == scenario.ugv else msgspec.structs.replace(scenario, ugv=ugvs)


def _with_track(ugv: Ugv, k: int, file: str) -> Ugv:
    where = f"{file}: ugv.{k}.trajectory = {ugv.trajectory!r}"
    columns = (f"{ugv.name}.vx [m/s]", f"{ugv.name}.vy [m/s]")
    try:
        with TextIOWrapper(
            open_regular(Path(ugv.trajectory), _MOST_BYTES), newline="", encoding="utf-8"
        ) as table:
            read = islice(csv.DictReader(table), _MOST_ROWS + 1)
            rows = [
                (float(row["time [s]"]), float(row[columns[0]]), float(row[columns[1]]))
                for row in read
            ]
    except OSError as error:
        raise ScenarioError(
            f"{where}: cannot be read: {error.strerror or error}; allowed: a run's trajectory.csv"
        ) from error
    except (KeyError, ValueError, TypeError, UnicodeDecodeError, csv.Error) as error:
        wrong = (
            f"has no column {error}"
            if isinstance(error, KeyError)
            else f"not a trajectory: {error}"
        )
        raise ScenarioError(
            f"{where}: {wrong}; allowed: the trajectory.csv of a run with {ugv.name}"
        ) from error
    if len(rows) > _MOST_ROWS:
        raise ScenarioError(f"{where}: too long; allowed: {_MOST_ROWS:,} ticks at most")
    if len(rows) < 2:
        raise ScenarioError(f"{where}: too short; allowed: two ticks or more")
    # The velocity of a tick was the desired one in the previous tick.
    steps = [ScriptStep(time=rows[n][0], velocity=rows[n + 1][1:]) for n in range(len(rows) - 1)]
    return msgspec.structs.replace(ugv, script=tuple(steps))
