"""Altitude in a town: what the UAV covers and certifies, and how fast the UGV is, by altitude and law.

The UGV knows the buildings, as in the shipped scenario. In a second flight it does not, relies on the UAV's reports
and keeps 1 m instead of 1.5 m from all that it does not know; this flight gives the mission time.

python benchmarks/altitude_worth.py                         the table of docs/explanation/ground.md, ten minutes
python benchmarks/altitude_worth.py --picture altitude.png  the table and its plot
python benchmarks/altitude_worth.py --seeds 2               a quick check
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bus import registry
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.style import law_color, law_mark, new_figure, plot_style, save
from sim.scenario.loading import load_scenario

ALTITUDES = (6.0, 7.0, 8.0, 10.0, 12.0, 14.0, 16.0, 20.0, 24.0)
"""Altitudes at which the UAV stays [m]."""
LAWS = ("tracking", "logarithmic", "certified", "lookahead")
UNMAPPED = [
    "buildings.known=false",
    "ugv.0.building_clearance=1",
    "ground.sensing_range=2",
    "duration=900",
]
BOUNDS = ["uav.0.min_altitude=6", "uav.0.max_altitude=24", "altitude.law=fixed"]


class Row(NamedTuple):
    """Runs of one law at one altitude."""

    law: str
    altitude: float
    mean_error: float
    """Mean of e(t) over ticks and runs [m²]."""
    certified: float
    """Share of certified ticks."""
    in_sight: float
    """Share of ticks in sight."""
    mission_time: float
    """Mean of the runs that arrived without a map of the buildings [s]; NaN without any."""
    arrived: int
    """Number of these runs."""


def _flown(changes: Sequence[str], seeds: int) -> ClosedLoop:
    """Fly a town for each seed."""
    scenario = load_scenario("town", overrides=[*BOUNDS, *changes])
    loop = ClosedLoop(
        scenario, seeds, error=True, end_on_sight_lost=False, end_on_goals_reached=True
    )
    loop.begin(list(range(seeds)))
    loop.fly()
    return loop


def flown(law: str, altitude: float, seeds: int) -> Row:
    """Fly the towns with and without a map of the buildings."""
    changes = [f"law.name={law}", f"uav.0.initial_altitude={altitude}"]
    loop = _flown(changes, seeds)
    (metrics,) = (loop.metrics(uav) for uav in loop.uavs)
    loop.close()
    unmapped = _flown([*changes, *UNMAPPED], seeds)
    times = [unmapped.mission(k).mission_time for k in range(seeds)]
    unmapped.close()
    arrived = [time for time in times if time is not None]
    return Row(
        law,
        altitude,
        float(metrics["mean_error"].mean()),
        float(metrics["certified"].mean()),
        1.0 - float((metrics["visibility_violations"] / (metrics["ticks"] + 1.0)).mean()),
        float(np.mean(arrived)) if arrived else np.nan,
        len(arrived),
    )


def rows(seeds: int) -> Iterator[Row]:
    """Fly all laws at all altitudes, in the same towns."""
    for law in LAWS:
        for altitude in ALTITUDES:
            yield flown(law, altitude, seeds)


def _lines(axes: Axes, rows: Sequence[Row], field: str, scale: float, style: str = "-") -> None:
    """Plot one quantity against the altitude, one line per law."""
    for law in LAWS:
        own = [row for row in rows if row.law == law]
        axes.plot(
            [row.altitude for row in own],
            [scale * getattr(row, field) for row in own],
            marker=law_mark(law),
            ls=style,
            ms=5.0,
            color=law_color(law),
            label=law,
        )


def draw(rows: Sequence[Row], path: Path) -> None:
    """Plot mean e(t), certified ticks and mission times against the altitude."""
    with plot_style():
        save(_drawn(rows), path)


def _drawn(rows: Sequence[Row]) -> Figure:
    figure = new_figure(1500, 480)
    panels = figure.subplots(1, 3)
    _lines(panels[0], rows, "mean_error", 1.0)
    panels[0].set_title("Coverage error around the UGV")
    panels[0].set_ylabel("mean e(t) [m²]")
    _lines(panels[1], [row for row in rows if registry.LAWS[row.law].watched], "certified", 100.0)
    _lines(panels[1], rows, "in_sight", 100.0, ":")
    panels[1].set_title("Certified (solid) and in sight (dotted)")
    panels[1].set_ylabel("share of ticks [%]")
    _lines(panels[2], rows, "mission_time", 1.0)
    panels[2].set_title("Mission without a map of the buildings")
    panels[2].set_ylabel("mission time [s]")
    for axes in panels:
        axes.set_xlabel("altitude [m]")
    for axes, field in ((panels[0], "mean_error"), (panels[2], "mission_time")):
        axes.set_ylim(0.0, 1.15 * max(getattr(row, field) for row in rows))
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside upper center",
        ncols=len(LAWS),
        frameon=False,
    )
    return figure


def main() -> None:
    """Print the table and, if requested, plot it."""
    parser = argparse.ArgumentParser(description="Altitude in a town.")
    parser.add_argument("--seeds", type=int, default=20, help="Runs per row.")
    parser.add_argument("--picture", type=Path, help="Plot the result into this PNG.")
    given = parser.parse_args()
    sys.stdout.write(
        "| law | altitude [m] | mean e(t) [m²] | certified | in sight | arrived | mission time [s] |\n"
        "|---|---:|---:|---:|---:|---:|---:|\n"
    )
    found = []
    for row in rows(given.seeds):
        found.append(row)
        sys.stdout.write(
            f"| {row.law} | {row.altitude:g} | {row.mean_error:.1f} | {100.0 * row.certified:.1f} % "
            f"| {100.0 * row.in_sight:.1f} % | {row.arrived} of {given.seeds} | {row.mission_time:.1f} |\n"
        )
        sys.stdout.flush()
    if given.picture is not None:
        draw(found, given.picture)


if __name__ == "__main__":
    main()
