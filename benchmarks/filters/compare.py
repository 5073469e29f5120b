"""Our safety filter beside a backup barrier filter from the literature, with the same tasks, detections and bounds.

    python benchmarks/filters/compare.py --jobs 2           # in the project's environment; about 10 minutes
    python benchmarks/filters/compare.py --seeds 2 --duration 30 --jobs 2

Prints the table and writes results/filters.json and results/filters.md beside this file.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import groupby, product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import msgspec
from backup_filter import BackupFilter

from agents.process import Pilot
from agents.safety.safety_filter import SafetyFilter
from agents.uav import UavPilot
from agents.ugv import UgvPilot
from bus.messages.base import Vector
from bus.messages.vehicle import UavBriefing, UavCommand, UavObservation
from outrider.running.flying import InProcess
from outrider.running.summary import summarize
from sim.engine.briefing import briefing
from sim.scenario.loading import load_scenario
from sim.scenario.types import Scenario
from sim.server.flight import Flight

HERE = Path(__file__).resolve().parent

FILTERS: Mapping[str, Callable[[UavBriefing], Any] | None] = {
    "none": None,
    "ours": SafetyFilter,
    "backup, γ = 1": partial(BackupFilter, gamma=1.0),
    "backup, γ = 0.1": partial(BackupFilter, gamma=0.1),
}
"""Filters around the inner control; each receives the UAV's observations and nothing else."""

_QUIET = {"detections.noise": 0.0, "detections.dropout": 0.0}


def _blackouts(length: float, seed: int, duration: float) -> dict[str, object]:
    """Return blackouts with 10 s between them, at different times for each seed."""
    first, every = 8.0 + 0.5 * (seed % 20), length + 10.0
    starts = [first + k * every for k in range(int((duration - first) / every) + 1)]
    return {
        "links.detections.blackouts": [[start, length] for start in starts],
        "certificate.max_measurement_age": length + 1.0,
    }


NETWORKS: Mapping[str, Callable[[int, float], dict[str, object]]] = {
    "undegraded": lambda _seed, _duration: dict(_QUIET),
    "noise": lambda _seed, _duration: {"detections.noise": 0.3, "detections.dropout": 0.1},
    "blackouts of 5 s": lambda seed, duration: _QUIET | _blackouts(5.0, seed, duration),
    "blackouts of 10 s": lambda seed, duration: _QUIET | _blackouts(10.0, seed, duration),
    "commands 0.5 s late": lambda _seed, _duration: (
        _QUIET | {"links.commands.delay": 0.5, "command_timeout": 1.0}
    ),
}
DRIVERS = ("evade", "waypoints", "wander")
INNER = ("logarithmic", "outward")
"""Inner controls: the paper's law, and full thrust away from the UGV."""


class Case(msgspec.Struct, frozen=True):
    """Parameters of one run."""

    network: str
    inner: str
    filter: str
    driver: str
    seed: int
    duration: float


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one run."""

    case: Case
    ticks: int
    lost: bool
    max_distance: float
    mean_distance: float
    mean_error: float
    known: int
    """Certified or feasible ticks."""
    known_while_lost: int
    """Such ticks with the UGV out of sight."""
    interventions: int
    microseconds: float
    """Mean processor time of the filter per tick [µs]."""


class FilteredPilot(UavPilot):
    """Pilot with an inner control and a filter, whose calls are timed and whose decisions are counted.

    Args:
        briefing: Briefing of the UAV.
        make: Constructor of the filter; None: without a filter.
        outward: True for full thrust away from the UGV, instead of the law.
    """

    def __init__(
        self, briefing: UavBriefing, make: Callable[[UavBriefing], Any] | None, *, outward: bool
    ) -> None:
        super().__init__(briefing)
        self._around = None if make is None else make(briefing)
        self._outward = briefing.limits.max_acceleration or 0.0 if outward else 0.0
        self.known: list[bool] = []
        self.interventions = self.nanoseconds = 0

    def act(self, observation: UavObservation) -> UavCommand:
        """Return the inner control's command after the filter."""
        command = super().act(observation)
        wanted = command.acceleration
        if self._outward and command.report is not None:
            wanted = self._away(observation.position, command.report.estimate)
        if self._around is None:
            return msgspec.structs.replace(command, acceleration=wanted)
        began = time.thread_time_ns()
        self._around.see(observation)
        decision = self._around.filter(observation, wanted)
        self.nanoseconds += time.thread_time_ns() - began
        self.known.append(bool(decision.certified))
        self.interventions += decision.overridden
        return msgspec.structs.replace(command, acceleration=decision.acceleration)

    def _away(self, own: Vector, target: Vector) -> Vector:
        x, y = own[0] - target[0], own[1] - target[1]
        length = (x * x + y * y) ** 0.5
        if length <= 1e-9:
            return self._outward, 0.0
        return x / length * self._outward, y / length * self._outward


def scenario_of(case: Case) -> Scenario:
    """Return the shipped escort with the case's network and driver, under the law without a filter."""
    changes: dict[str, object] = {
        "law.name": "logarithmic",
        "ugv.0.driver": case.driver,
        "duration": case.duration,
        "area.cell": 0.5,
        "seed": case.seed,
    }
    return load_scenario(
        "escort", overrides=changes | NETWORKS[case.network](case.seed, case.duration)
    )


def fly(case: Case) -> Result:
    """Simulate one run in this process, with the project's own world and pilots."""
    scenario = scenario_of(case)
    pilots: dict[str, Pilot] = {}
    for vehicle in scenario.vehicles:
        own = briefing(scenario, vehicle.name, case.seed)
        if isinstance(own, UavBriefing):
            uav = pilots[vehicle.name] = FilteredPilot(
                own, FILTERS[case.filter], outward=case.inner == "outward"
            )
        else:
            pilots[vehicle.name] = UgvPilot(own)
    flight = Flight(scenario, case.seed)
    began = time.perf_counter()
    flight.fly(InProcess(pilots))
    summary = summarize(flight, seconds=time.perf_counter() - began)
    distances = flight.recorder.escorts[: len(uav.known), 0, 0]
    return Result(
        case=case,
        ticks=flight.world.tick,
        lost=bool(summary.visibility_violations > 0),
        max_distance=summary.max_distance,
        mean_distance=summary.mean_distance,
        mean_error=summary.mean_error,
        known=sum(uav.known),
        known_while_lost=sum(
            known and d >= scenario.visibility.radius
            for known, d in zip(uav.known, distances.tolist(), strict=True)
        ),
        interventions=uav.interventions,
        microseconds=uav.nanoseconds / 1000.0 / max(1, len(uav.known)),
    )


def cases(seeds: int, duration: float) -> Iterator[Case]:
    """Yield all runs, ordered by rows of the table."""
    for values in product(NETWORKS, INNER, FILTERS, DRIVERS, range(7, 7 + seeds)):
        case = Case(*values, duration)
        if (case.inner, case.filter) != ("outward", "none"):  # loses sight after eight seconds
            yield case


COLUMNS = (
    "network",
    "inner control",
    "filter",
    "runs with loss of sight",
    "largest distance [m]",
    "known to be safe",
    "known to be safe, but lost [ticks]",
    "overridden",
    "mean e(t) [m²]",
    "mean distance [m]",
    "µs per tick",
)


def rows(results: Sequence[Result]) -> Iterator[list[str]]:
    """Yield one row per network, inner control and filter, over all drivers and seeds."""
    for key, group in groupby(results, lambda r: (r.case.network, r.case.inner, r.case.filter)):
        found = list(group)
        ticks, watched = sum(r.ticks for r in found), key[2] != "none"
        yield [
            *key,
            f"{sum(r.lost for r in found)} of {len(found)}",
            f"{max(r.max_distance for r in found):.3f}",
            f"{100.0 * sum(r.known for r in found) / ticks:.2f} %" if watched else "",
            str(sum(r.known_while_lost for r in found)) if watched else "",
            f"{100.0 * sum(r.interventions for r in found) / ticks:.1f} %" if watched else "",
            f"{sum(r.mean_error * r.ticks for r in found) / ticks:.1f}",
            f"{sum(r.mean_distance * r.ticks for r in found) / ticks:.2f}",
            f"{sorted(r.microseconds for r in found)[len(found) // 2]:.0f}" if watched else "",
        ]


def table(lines: Iterable[Sequence[str]]) -> str:
    """Return the table in Markdown."""
    head = [COLUMNS, ["---"] * 3 + ["--:"] * (len(COLUMNS) - 3)]
    return "".join("| " + " | ".join(line) + " |\n" for line in [*head, *lines])


def main() -> None:
    """Run all cases, print the table, and write it with the numbers of every run."""
    parser = argparse.ArgumentParser(
        description="Our safety filter beside a backup barrier filter, on the same tasks."
    )
    parser.add_argument(
        "--seeds",
        type=int,
        default=20,
        help="Runs per driver, network, inner control and filter.",
    )
    parser.add_argument("--duration", type=float, default=60.0, help="Duration of a run [s].")
    parser.add_argument(
        "--jobs", type=int, default=1, help="Number of processes; times per tick refer to one core."
    )
    parser.add_argument(
        "--out", type=Path, default=HERE / "results", help="Folder for filters.json and filters.md."
    )
    given = parser.parse_args()
    if given.seeds < 1 or given.jobs < 1 or not given.duration > 0.0:
        parser.error(
            "--seeds, --jobs, --duration: out of range; allowed: 1 or more, 1 or more, above 0 s"
        )
    wanted, began = list(cases(given.seeds, given.duration)), time.monotonic()
    for name in FILTERS:  # compile before anything is timed
        fly(Case("undegraded", "outward", name, "evade", seed=1, duration=5.0))
    results: list[Result] = []
    with ProcessPoolExecutor(given.jobs, mp_context=get_context("spawn")) as pool:
        for n, result in enumerate(pool.map(fly, wanted, chunksize=5), 1):
            results.append(result)
            if n % 50 == 0 or n == len(wanted):
                sys.stderr.write(f"\r{n} of {len(wanted)} runs, {time.monotonic() - began:.0f} s")
                sys.stderr.flush()
    text = table(rows(results))
    sys.stdout.write(f"\n{text}")
    given.out.mkdir(parents=True, exist_ok=True)
    given.out.joinpath("filters.md").write_text(text, encoding="utf-8")
    report = msgspec.json.encode({"cores": os.cpu_count(), "jobs": given.jobs, "flights": results})
    given.out.joinpath("filters.json").write_bytes(msgspec.json.format(report, indent=1) + b"\n")


if __name__ == "__main__":
    main()
