"""Benefit of a team: coverage, objects found, mission time and unguarded time by UAVs, over three networks.

python benchmarks/team_worth.py                              the table of docs/explanation/teams.md
python benchmarks/team_worth.py scouts                       the scenario `scouts` only, ten minutes
python benchmarks/team_worth.py --picture teams.png          the table and its plot
python benchmarks/team_worth.py --rows rows.jsonl            keep the flights in a file, and fly only missing ones
python benchmarks/team_worth.py --seeds 2 --duration 60      a quick check
"""

import argparse
import sys
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import fmean

import msgspec
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bus.messages.links import LinkSettings
from bus.messages.team import Team
from bus.profiles import PROFILES
from outrider.experiments.intervals import mean_interval
from outrider.running.flying import fly
from outrider.style import INK, MUTED, UAV, new_figure, plot_style, save
from sim.scenario.checks import check_scenario
from sim.scenario.loading import load_scenario
from sim.scenario.types import LinkTable, Scenario
from sim.server.flight import Flight

NETWORKS = ("perfect", "wifi-poor", "jammed")
"""Profiles of the detections, of the radio to the UGV and of the messages between the UAVs."""
AGES = {"perfect": 1.0, "wifi-poor": 2.0, "jammed": 6.0}
"""Declared largest age of the newest detection [s]."""
UAVS = (1, 2, 3)
ALONE, TEAM = "each guards", "guard and scouts"
TASKS = {"scouts": NETWORKS, "rescue": NETWORKS, "minefield": NETWORKS[:1]}
"""Scenarios and their networks."""
DURATIONS = {"rescue": 240.0}
"""Durations of flights that differ from the scenario's [s]."""
TITLES = {
    "mean_error": "mean coverage error e(t) [m²]",
    "found": "objects found, of 8",
    "unguarded": "time without a certified UAV [%]",
}
PANELS = (("scouts", "mean_error"), ("rescue", "found"), ("scouts", "unguarded"))
"""Scenario and quantity of each plot; a scenario that was not flown has none."""
_SPACING = 1.2
"""Distance between two UAVs at the start [m]."""
_FIRST_SEED = 1
_MARKS = {"perfect": "o", "wifi-poor": "D", "jammed": "s"}


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one flight."""

    key: int
    """Hash of the scenario with its seed, to recognize a flight that was kept."""
    scenario: str
    network: str
    mode: str
    uavs: int
    seed: int
    mean_error: float | None
    """Mean coverage error [m²]."""
    unguarded: float
    """Share of the ticks without a certified UAV; in a team, without a certified guard [%]."""
    out_of_sight: int
    """Ticks in which no UAV saw the UGV."""
    found: int
    mission_time: float | None
    """[s]; None: the UGV has not arrived."""


def flown(name: str, network: str, mode: str, uavs: int, duration: float | None) -> Scenario:
    """Return a scenario with some UAVs, individually guarded or in a team, over a network."""
    changes = {"law.name": "lookahead", "law.parameters.candidates": 150, "area.cell": 0.5}
    changes |= {"detections.truncation": 3.0, "certificate.max_measurement_age": AGES[network]}
    plain = load_scenario(name, overrides=changes)
    first, link = plain.uav[0], PROFILES[network]
    (x, y), teamed = first.position, mode == TEAM
    team = None
    if teamed:  # a fast UGV leaves a shorter time to return
        team = Team(silence=2.0 if plain.ugv[0].max_speed <= 0.2 else 1.0)
    links = LinkTable(detections=link, radio=link, team=link if teamed else LinkSettings())
    members = tuple(
        msgspec.structs.replace(first, name=f"uav_{k}", position=(x + _SPACING * k, y))
        for k in range(uavs)
    )
    scenario = msgspec.structs.replace(plain, team=team, links=links, uav=members)
    duration = DURATIONS.get(name) if duration is None else duration
    if duration is not None:
        scenario = msgspec.structs.replace(scenario, duration=duration)
    return check_scenario(scenario)


def _fly(key: int, scenario: Scenario, names: tuple[str, str, str], seed: int) -> Row:
    ticks = guarded = 0

    def see(flight: Flight) -> None:
        nonlocal ticks, guarded
        ticks += 1
        guarded += None in flight.answers.reasons().values()
        if flight.world.mission is not None and flight.world.mission.arrived:
            flight.stop()

    _, summary = fly(scenario, seed, on_tick=see)
    share = summary.team.team_certified_share if summary.team else guarded / ticks
    name, network, mode = names
    return Row(
        key=key,
        scenario=name,
        network=network,
        mode=mode,
        uavs=len(scenario.uav),
        seed=seed,
        mean_error=summary.mean_error,
        unguarded=100.0 * (1.0 - share),
        out_of_sight=summary.team.team_out_of_sight
        if summary.team
        else summary.visibility_violations,
        found=summary.mission.found if summary.mission else 0,
        mission_time=summary.mission.mission_time if summary.mission else None,
    )


def rows(
    names: Sequence[str], seeds: int, duration: float | None, kept: Path | None
) -> Iterator[Row]:
    """Yield the results of all flights; a file keeps them."""
    lines = kept.read_bytes().splitlines() if kept is not None and kept.exists() else []
    known = {row.key: row for row in (msgspec.json.decode(line, type=Row) for line in lines)}
    for name in names:
        networks = TASKS[name]
        for seed in range(_FIRST_SEED, _FIRST_SEED + seeds):
            for network in networks:
                for mode, uavs in ((ALONE, 1), *((m, n) for n in UAVS[1:] for m in (ALONE, TEAM))):
                    scenario = flown(name, network, mode, uavs, duration)
                    key = zlib.crc32(msgspec.msgpack.encode((scenario, seed)))
                    row = known.get(key)
                    if row is None:
                        row = _fly(key, scenario, (name, network, mode), seed)
                        if kept is not None:
                            with kept.open("ab") as file:
                                file.write(msgspec.json.encode(row) + b"\n")
                    yield row


def _interval(values: Sequence[float | None], digits: int = 1) -> str:
    known = [value for value in values if value is not None]
    if not known:
        return "–"
    mean, low, _ = mean_interval(known)
    text = (
        f"{mean:.{digits}f}" if len(known) == 1 else f"{mean:.{digits}f} ± {mean - low:.{digits}f}"
    )
    return text if len(known) == len(values) else f"{text} ({len(known)} of {len(values)})"


def _group(rows: Sequence[Row], name: str, network: str, mode: str, uavs: int) -> list[Row]:
    """Return the rows of a point; a single UAV guards in both modes."""
    wanted = (name, network, ALONE if uavs == 1 else mode, uavs)
    return [one for one in rows if (one.scenario, one.network, one.mode, one.uavs) == wanted]


def table(rows: Sequence[Row]) -> str:
    """Return the table of all points, in Markdown."""
    head = (
        "| scenario | network | UAVs | | mean e(t) [m²] | objects found | mission time [s] | unguarded [%] "
        "| out of sight [ticks] |\n|---|---|---:|---|---:|---:|---:|---:|---:|\n"
    )
    lines = []
    for name, networks in TASKS.items():
        for network in networks:
            for uavs in UAVS:
                for mode in (ALONE, TEAM) if uavs > 1 else (ALONE,):
                    group = _group(rows, name, network, mode, uavs)
                    if not group:
                        continue
                    found = _interval([one.found for one in group]) if name == "rescue" else ""
                    timed = name != "scouts"
                    times = _interval([one.mission_time for one in group], 0) if timed else ""
                    lines.append(
                        f"| `{name}` | `{network}` | {uavs} | {mode if uavs > 1 else 'guards'} "
                        f"| {_interval([one.mean_error for one in group])} | {found} | {times} "
                        f"| {_interval([one.unguarded for one in group], 2)} "
                        f"| {fmean(one.out_of_sight for one in group):.1f} |\n"
                    )
    return head + "".join(lines)


def _plot(axes: Axes, rows: Sequence[Row], name: str, quantity: str) -> None:
    """Plot means with their intervals against the number of UAVs."""
    for shift, network in zip((-0.07, 0.0, 0.07), NETWORKS, strict=True):
        for mode, color in ((ALONE, MUTED), (TEAM, UAV[0])):
            points = []
            for uavs in UAVS:
                group = _group(rows, name, network, mode, uavs)
                if len(group) > 1:
                    values = [float(getattr(one, quantity) or 0.0) for one in group]
                    points.append((uavs + shift, *mean_interval(values)))
            if points:
                x, mean, low, high = zip(*points, strict=True)
                error = [
                    [m - v for m, v in zip(mean, low, strict=True)],
                    [v - m for m, v in zip(mean, high, strict=True)],
                ]
                axes.errorbar(
                    x, mean, error, color=color, marker=_MARKS[network], ms=5, lw=1.1, capsize=2,
                    mfc=color if network == NETWORKS[0] else "white",
                )  # fmt: skip
    axes.set_title(f"{name.capitalize()}: {TITLES[quantity]}", fontsize="medium")
    axes.set_xlabel("number of UAVs")
    axes.set_xticks(UAVS)
    axes.set_xlim(UAVS[0] - 0.3, UAVS[-1] + 0.3)
    # less than a percent is the time until the first certificate, and no difference to look at
    axes.set_ylim(0.0, max(1.0, axes.get_ylim()[1]))
    axes.set_ylabel(TITLES[quantity].split(",")[0])


def draw(rows: Sequence[Row], path: Path) -> None:
    """Plot coverage error, objects found and unguarded time."""
    with plot_style():
        save(_drawn(rows), path)


def _drawn(rows: Sequence[Row]) -> Figure:
    figure = new_figure(1500, 560)
    flown = {one.scenario for one in rows if one.seed > _FIRST_SEED}
    panels = [(name, quantity) for name, quantity in PANELS if name in flown]
    for axes, (name, quantity) in zip(figure.subplots(1, len(panels)), panels, strict=True):
        _plot(axes, rows, name, quantity)
    keys = [Line2D([], [], color=color, lw=2.0, label=mode)
            for mode, color in ((ALONE, MUTED), (TEAM, UAV[0]))]  # fmt: skip
    keys += [
        Line2D([], [], ls="", marker=_MARKS[one], mec=INK, mfc="white" if k else INK, label=one)
        for k, one in enumerate(NETWORKS)
    ]
    figure.legend(handles=keys, loc="outside upper center", ncols=len(keys), frameon=False)
    return figure


def main() -> None:
    """Print the table and, if requested, plot it."""
    parser = argparse.ArgumentParser(description="Benefit of a team.")
    parser.add_argument(
        "scenarios", nargs="*", default=[*TASKS], metavar="SCENARIO", help="Default: all."
    )
    parser.add_argument("--seeds", type=int, default=6, help="Flights per row.")
    parser.add_argument("--duration", type=float, help="Duration of each flight [s].")
    parser.add_argument("--rows", type=Path, help="Keep the flights in this file.")
    parser.add_argument("--picture", type=Path, help="Plot the result into this PNG.")
    given = parser.parse_args()
    found = []
    for row in rows(given.scenarios, given.seeds, given.duration, given.rows):
        found.append(row)
        sys.stderr.write(f"{row.scenario} {row.network} {row.mode} {row.uavs} {row.seed}\n")
    sys.stdout.write(table(found))
    if given.picture is not None:
        draw(found, given.picture)


if __name__ == "__main__":
    main()
