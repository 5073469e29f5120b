"""Benefit of the escort: speed and safety of a UGV among hazards, by law and network.

python benchmarks/mission_worth.py                         the table of docs/explanation/ground.md, ten minutes
python benchmarks/mission_worth.py --picture missions.png  the table and its plot
python benchmarks/mission_worth.py --seeds 3               a quick check
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bus.messages.links import LinkSettings
from bus.messages.telemetry import MissionResult
from bus.profiles import PROFILES
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.style import INK, LIMIT, UGV, law_color, new_figure, plot_style, save
from sim.scenario.loading import load_scenario
from sim.scenario.types import LinkTable, Scenario

MISSIONS = (("minefield", "cautious"), ("minefield", "bold"), ("rubble", "cautious"))
"""Scenarios and cautions; in `rubble` a bold UGV is slow enough to stop in time, with identical runs."""
NETWORKS = ("perfect", "satellite", "jammed")
"""Profiles of detections and radio."""
LAWS = ("tracking", "circle", "certified", "lookahead")
NO_ESCORT = "no escort"
AGES = {"perfect": 1.0, "satellite": 3.0, "jammed": 6.0}
"""Declared largest age of the newest detection [s]."""
MARKS = {"perfect": "o", "satellite": "D", "jammed": "s"}
LONGEST = 900.0
"""Longest duration of a run [s]."""


class Row(NamedTuple):
    """Missions of one law over one network."""

    scenario: str
    caution: str
    network: str
    law: str
    missions: list[MissionResult]
    lost: int
    """Runs with loss of sight."""


def _flown(scenario: Scenario, seeds: int) -> tuple[list[MissionResult], int]:
    loop = ClosedLoop(scenario, seeds, end_on_sight_lost=False, end_on_goals_reached=True)
    loop.begin(list(range(seeds)))
    loop.fly()
    found = [loop.mission(k) for k in range(seeds)]
    lost = [loop.metrics(uav)["visibility_violations"] > 0.0 for uav in loop.uavs]
    loop.close()
    return found, int(np.any(lost, axis=0).sum()) if lost else 0


def rows(seeds: int) -> Iterator[Row]:
    """Run all missions, with the same hazards for every law."""
    for name, caution in MISSIONS:
        plain = load_scenario(name)
        ugvs = tuple(msgspec.structs.replace(one, caution=caution) for one in plain.ugv)
        for network in NETWORKS:
            link: LinkSettings = PROFILES[network]
            links = LinkTable(detections=link, radio=link)
            for law in (NO_ESCORT, *LAWS):
                if law == NO_ESCORT and network != NETWORKS[0]:
                    continue
                flown = LAWS[0] if law == NO_ESCORT else law
                scenario = msgspec.structs.replace(
                    plain,
                    duration=LONGEST,
                    certificate=msgspec.structs.replace(
                        plain.certificate, max_measurement_age=AGES[network]
                    ),
                    ugv=ugvs,
                    links=links,
                    law=msgspec.structs.replace(plain.law, name=flown),
                    uav=() if law == NO_ESCORT else plain.uav,
                )
                yield Row(name, caution, network, law, *_flown(scenario, seeds))


def _mean(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):.1f}" if known else "–"


def _position(row: Row) -> tuple[float, str]:
    """Return a row's position on the axis of laws and networks, and its colour."""
    if row.law == NO_ESCORT:
        return 0.0, UGV[0]
    shift = 0.26 * (NETWORKS.index(row.network) - 1)
    return 1.0 + LAWS.index(row.law) + shift, law_color(row.law)


def _times(axes: Axes, rows: Sequence[Row]) -> None:
    """Plot the mission times of completed runs with their median, and the number of incomplete runs above."""
    for row in rows:
        x, color = _position(row)
        times = [one.mission_time for one in row.missions if one.mission_time is not None]
        filled = color if row.network == NETWORKS[0] else "white"
        mark = MARKS[row.network]
        axes.plot([x] * len(times), times, mark, ms=4.5, mec=color, mfc=filled, mew=0.9, alpha=0.75)
        if times:
            axes.plot([x - 0.11, x + 0.11], [np.median(times)] * 2, color=INK, lw=1.6, zorder=3)
        missing = len(row.missions) - len(times)
        if missing:
            axes.text(
                x,
                0.985,
                str(missing),
                color=LIMIT,
                ha="center",
                va="top",
                transform=axes.get_xaxis_transform(),
            )


def _hits(axes: Axes, rows: Sequence[Row]) -> None:
    """Plot the share of runs that hit a hazard."""
    for row in rows:
        x, color = _position(row)
        share = 100.0 * float(np.mean([one.hazards_hit > 0 for one in row.missions]))
        hatch = {"perfect": "", "satellite": "....", "jammed": "////"}[row.network]
        face = color if row.network == NETWORKS[0] else "white"
        axes.bar(x, share, width=0.22, color=face, edgecolor=color, hatch=hatch, lw=0.9)
        if share == 0.0:
            axes.text(x, 1.5, "0", color=color, ha="center", va="bottom")


def draw(rows: Sequence[Row], path: Path) -> None:
    """Plot mission times of a cautious UGV, and hits of a bold one."""
    with plot_style():
        save(_drawn(rows), path)


def _drawn(rows: Sequence[Row]) -> Figure:
    figure = new_figure(1500, 560)
    names = [law.replace(" ", "\n") for law in (NO_ESCORT, *LAWS)]
    for axes, (scenario, caution) in zip(figure.subplots(1, len(MISSIONS)), MISSIONS, strict=True):
        shown = [row for row in rows if (row.scenario, row.caution) == (scenario, caution)]
        axes.set_title(f"{scenario.capitalize()}, {caution} UGV")
        axes.set_xticks(range(len(names)), names)
        axes.tick_params(axis="x", length=0.0, labelsize="small")
        if caution == "bold":
            _hits(axes, shown)
            axes.set_ylabel("runs with a hit [%]")
            axes.set_ylim(0.0, 105.0)
        else:
            _times(axes, shown)
            axes.set_ylabel("mission time [s]")
            axes.margins(y=0.1)
            axes.set_ylim(bottom=0.0)
    marks = [
        Line2D(
            [], [], ls="", marker=MARKS[network], mec=INK, mfc="white" if n else INK, label=network
        )
        for n, network in enumerate(NETWORKS)
    ]
    marks.append(Line2D([], [], color=INK, lw=1.6, label="median"))
    timed = [one for row in rows if row.caution != "bold" for one in row.missions]
    if any(one.mission_time is None for one in timed):
        missing = "runs that did not arrive"
        marks.append(Line2D([], [], ls="", marker="$n$", mec=LIMIT, mfc=LIMIT, label=missing))
    figure.legend(handles=marks, loc="outside upper center", ncols=len(marks), frameon=False)
    return figure


def main() -> None:
    """Print the table and, if requested, plot it."""
    parser = argparse.ArgumentParser(description="Benefit of the escort.")
    parser.add_argument("--seeds", type=int, default=20, help="Runs per row.")
    parser.add_argument("--picture", type=Path, help="Plot the result into this PNG.")
    given = parser.parse_args()
    sys.stdout.write(
        "| scenario | UGV | network | law | arrived | mission time [s] | runs with a hit | on the path "
        "| warning time [s] | reported | stationary [s] | sight lost |\n" + "|---" * 12 + "|\n"
    )
    flown = []
    for row in rows(given.seeds):
        m = row.missions
        flown.append(row)
        sys.stdout.write(
            f"| {row.scenario} | {row.caution} | {row.network} | {row.law} "
            f"| {sum(one.arrived for one in m)} of {len(m)} "
            f"| {_mean([one.mission_time for one in m])} "
            f"| {sum(one.hazards_hit > 0 for one in m)} "
            f"| {np.mean([one.hazards_on_path for one in m]):.1f} "
            f"| {_mean([one.mean_warning_time for one in m])} "
            f"| {100.0 * np.mean([one.reported_share or 0.0 for one in m]):.0f} % "
            f"| {np.mean([one.stationary_time for one in m]):.1f} "
            f"| {'–' if row.law == NO_ESCORT else row.lost} |\n"
        )
        sys.stdout.flush()
    if given.picture is not None:
        draw(flown, given.picture)


if __name__ == "__main__":
    main()
