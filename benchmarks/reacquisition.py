"""Search after lost sight, against waiting at the newest measurement: how long the UGV stays out of sight.

python benchmarks/reacquisition.py                          the table of docs/how-to/keep-sight.md, five minutes
python benchmarks/reacquisition.py --picture search.png     the table, and one flight with a search
python benchmarks/reacquisition.py --seeds 3                a quick check
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from markdown_tables import head
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.style import LIMIT, UAV, UGV, new_figure, plot_style, save
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario

BLACKOUTS = ["links.detections.blackout_interval=120", "links.detections.blackout_length=60"]
"""Blackouts in which the UGV leaves the sight of a waiting UAV."""
CASES = (
    ("`escort`, `evade`, blackouts", "escort", ["ugv.0.driver=evade", *BLACKOUTS]),
    ("`escort`, `wander`, blackouts", "escort", ["ugv.0.driver=wander", *BLACKOUTS]),
    ("`town`, blackouts", "town", BLACKOUTS),
    ("`town`, `wander`, buildings hide", "town", ["ugv.0.driver=wander"]),
)
"""Name, scenario and changes. Only `navigate` keeps the distance from buildings at which none hides the UGV."""
DURATION = "duration=600"
PICTURED = "links.detections.blackouts=[[5.0, 45.0]]"

BoolArray = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]


class Flown(NamedTuple):
    """Flights of one case."""

    lost: BoolArray
    """True out of sight. Shape (ticks, flights)."""
    error: float
    """Mean of e(t) [m²]."""
    certified: float
    """Share of certified ticks."""
    faults: int
    """Ticks certified out of sight, and broken certificates."""


def losses(lost: BoolArray) -> list[tuple[int, bool]]:
    """Return the ticks of each loss, and whether it ended before the flight. Argument as in `Flown`."""
    found = []
    for flight in lost.T:
        edges = np.flatnonzero(np.diff(np.concatenate(([0], flight.astype(np.int8), [0]))))
        found += [(int(b - a), bool(b < len(flight))) for a, b in edges.reshape(-1, 2)]
    return found


def flown(scenario: Scenario, seeds: int) -> Flown:
    """Fly a scenario with each seed."""
    loop = ClosedLoop(
        scenario, seeds, error=True, end_on_sight_lost=False, end_on_goals_reached=False
    )
    loop.begin(list(range(seeds)))
    (uav,) = loop.uavs
    counts = [loop.metrics(uav)["visibility_violations"]]
    for _ in range(scenario.ticks):
        loop.fly(1)
        counts.append(loop.metrics(uav)["visibility_violations"])
    metrics = loop.metrics(uav)
    loop.close()
    faults = metrics["certified_while_lost"] + metrics["certificate_broken"]
    return Flown(
        np.diff(counts, axis=0) > 0.0,
        float(metrics["mean_error"].mean()),
        float(metrics["certified"].mean()),
        int(faults.sum()),
    )


def _scenario(base: str, changes: Sequence[str], search: bool) -> Scenario:
    return load_scenario(
        base, overrides=[DURATION, *changes, f"uav.0.search={str(search).lower()}"]
    )


def table(seeds: int) -> Iterator[str]:
    """Yield the lines of the table."""
    yield head(
        f"case, {seeds} flights of 600 s | after lost sight | out of sight | losses | ended | mean loss [s] | "
        "longest loss [s] | mean e(t) [m²] | ticks certified | certificate wrong"
    )
    for name, base, changes in CASES:
        for search in (False, True):
            scenario = _scenario(base, changes, search)
            one = flown(scenario, seeds)
            found = losses(one.lost)
            lengths = [scenario.dt * ticks for ticks, _ in found] or [0.0]
            ended = sum(over for _, over in found)
            yield (
                f"| {name} | {'search' if search else 'wait'} | {100.0 * one.lost.mean():.1f} % | {len(found)} | "
                f"{ended} | {np.mean(lengths):.0f} | {max(lengths):.0f} | {one.error:.0f} | "
                f"{100.0 * one.certified:.1f} % | {one.faults} |"
            )


class Track(NamedTuple):
    """Pictured flight."""

    title: str
    scenario: Scenario
    places: FloatArray
    """Positions of UAV and UGV at each tick [m]. Shape (ticks, 2, 2)."""
    lost: BoolArray
    """True out of sight. Shape (ticks,)."""


def tracks(seed: int) -> Iterator[Track]:
    """Fly against `evade` with a blackout of 45 s, waiting and searching."""
    for search in (False, True):
        changes = [
            "ugv.0.driver=evade",
            "duration=300",
            PICTURED,
            f"uav.0.search={str(search).lower()}",
        ]
        scenario = load_scenario("escort", overrides=changes)
        loop = ClosedLoop(scenario, 1, end_on_sight_lost=False)
        loop.begin([seed])
        places = []
        for _ in range(scenario.ticks):
            places.append(loop.state.batch.vehicles["position"][0].copy())
            loop.fly(1)
        loop.close()
        found = np.array(places)
        away = np.linalg.norm(found[:, 0] - found[:, 1], axis=-1)
        lost = away >= scenario.visibility.radius
        yield Track("search" if search else "wait", scenario, found, lost)


def _draw_track(axes: Axes, track: Track) -> None:
    places, radius, area = track.places, track.scenario.visibility.radius, track.scenario.area
    for k, color, name in ((0, UAV[0], "UAV"), (1, UGV[0], "UGV")):
        axes.plot(*places[:, k].T, color=color, lw=1.2, label=name)
        axes.plot(*places[-1, k], "o", color=color, ms=5)
    hidden = np.where(track.lost[:, None], places[:, 1], np.nan)
    axes.plot(*hidden.T, color=LIMIT, lw=2.4, alpha=0.6, label="UGV out of sight")
    axes.add_patch(Circle(tuple(places[-1, 0]), radius, fill=False, color=UAV[0], lw=0.8, ls=":"))
    axes.set(
        title=track.title,
        xlabel="x [m]",
        ylabel="y [m]",
        xlim=(0.0, area.width),
        ylim=(0.0, area.height),
        aspect="equal",
    )


def draw(flights: Sequence[Track], path: Path) -> None:
    """Draw flights side by side into a PNG file."""
    with plot_style():
        figure = new_figure(1100, 600)
        for k, track in enumerate(flights):
            axes = figure.add_subplot(1, len(flights), k + 1)
            _draw_track(axes, track)
        axes.legend(loc="upper right")
        save(figure, path)


def main() -> None:
    """Print the table, and draw the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20, help="number of flights of each case")
    parser.add_argument("--picture", type=Path, help="file of the picture")
    parser.add_argument("--pictured-seed", type=int, default=3, help="seed of the pictured flight")
    given = parser.parse_args()
    if given.seeds < 1:
        parser.error(f"--seeds {given.seeds}: too small; allowed: at least 1")
    for line in table(given.seeds):
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()
    if given.picture:
        draw(list(tracks(given.pictured_seed)), given.picture)


if __name__ == "__main__":
    main()
