"""A recorded trajectory as a script: what a UGV did in an earlier run, to be driven again."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from bus.errors import ScenarioError
from bus.messages import ScriptStep

if TYPE_CHECKING:
    from sim.scenario import Scenario, Ugv


def with_tracks(scenario: Scenario, *, file: str) -> Scenario:
    """The scenario with the scripts of those UGVs that have a `track`.

    Raises:
        ScenarioError: If a track cannot be read, or has nothing of the UGV.
    """
    ugvs = tuple(_with_track(ugv, k, file) if ugv.track else ugv for k, ugv in enumerate(scenario.ugv))
    return scenario if ugvs == scenario.ugv else msgspec.structs.replace(scenario, ugv=ugvs)


def _with_track(ugv: Ugv, k: int, file: str) -> Ugv:
    where = f"{file}: ugv.{k}.track = {ugv.track!r}"
    columns = (f"{ugv.name}.vx [m/s]", f"{ugv.name}.vy [m/s]")
    try:
        with Path(ugv.track).open(newline="", encoding="utf-8") as table:
            rows = [(float(row["time [s]"]), float(row[columns[0]]), float(row[columns[1]])) for row in csv.DictReader(table)]
    except OSError as error:
        raise ScenarioError(f"{where}: cannot be read: {error.strerror or error}; allowed: a run's trajectory.csv") from error
    except (KeyError, ValueError, TypeError, UnicodeDecodeError, csv.Error) as error:
        wrong = f"has no column {error}" if isinstance(error, KeyError) else f"not a trajectory: {error}"
        raise ScenarioError(f"{where}: {wrong}; allowed: the trajectory.csv of a run with {ugv.name}") from error
    if len(rows) < 2:
        raise ScenarioError(f"{where}: is too short; allowed: two ticks or more")
    # The velocity of a tick is what was wanted at the one before.
    steps = [ScriptStep(time=rows[n][0], velocity=rows[n + 1][1:]) for n in range(len(rows) - 1)]
    return msgspec.structs.replace(ugv, script=tuple(steps))
