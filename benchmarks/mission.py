"""What the escort is worth: how fast and how safely a UGV gets through hazards, by law and network.

python benchmarks/mission.py            the table of docs/explanation/ground.md, some minutes
python benchmarks/mission.py --seeds 3  a quick look
"""

import argparse
import sys
from collections.abc import Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from bus.messages import LinkSettings
from bus.profiles import PROFILES
from outrider.envs.closed_loop import ClosedLoop
from sim.engine.mission import Mission, mission_of
from sim.scenario.loading import load_scenario
from sim.scenario.types import LinkTable, Scenario

SCENARIOS = ("minefield", "rubble")
NETWORKS = ("perfect", "jammed")
LAWS = ("tracking", "circle", "logarithmic", "certified")
NOBODY = "no escort"


class Row(NamedTuple):
    """The missions of one law over one network."""

    scenario: str
    caution: str
    network: str
    law: str
    missions: list[Mission]


def _flown(scenario: Scenario, seeds: int) -> list[Mission]:
    loop = ClosedLoop(scenario, seeds, end_on_sight_lost=False, end_on_goals_reached=True)
    loop.begin(list(range(seeds)))
    loop.fly()
    tables, state = loop.tables.batch, loop.state.batch
    found = [
        mission_of(tables.mission, state.ground, state.mission, k, scenario.dt)
        for k in range(seeds)
    ]
    loop.close()
    return found


def rows(seeds: int) -> Iterator[Row]:
    """Fly all of it, with the same hazards for every law."""
    for name in SCENARIOS:
        plain = load_scenario(name)
        for caution in ("cautious", "bold"):
            ugvs = tuple(msgspec.structs.replace(one, caution=caution) for one in plain.ugv)
            for network in NETWORKS:
                link: LinkSettings = PROFILES[network]
                links = LinkTable(detections=link, radio=link)
                for law in (NOBODY, *LAWS):
                    if law == NOBODY and network != NETWORKS[0]:
                        continue
                    flown = LAWS[0] if law == NOBODY else law
                    scenario = msgspec.structs.replace(
                        plain,
                        duration=900.0,
                        ugv=ugvs,
                        links=links,
                        law=msgspec.structs.replace(plain.law, name=flown),
                        uav=() if law == NOBODY else plain.uav,
                    )
                    yield Row(name, caution, network, law, _flown(scenario, seeds))


def _mean(values: list[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):.1f}" if known else "–"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="What the escort is worth.")
    parser.add_argument("--seeds", type=int, default=20, help="flights of each row")
    seeds = parser.parse_args().seeds
    sys.stdout.write(
        "| scenario | UGV | network | law | arrived | mission time [s] | hit a flight | on the way | known before "
        "[s] | seen ahead | stood still [s] |\n|---|---|---|---|---|---|---|---|---|---|---|\n"
    )
    for row in rows(seeds):
        m = row.missions
        sys.stdout.write(
            f"| {row.scenario} | {row.caution} | {row.network} | {row.law} "
            f"| {sum(one.arrived for one in m)} of {len(m)} "
            f"| {_mean([one.mission_time for one in m])} "
            f"| {np.mean([one.hazards_hit for one in m]):.2f} "
            f"| {np.mean([one.hazards_on_way for one in m]):.1f} "
            f"| {_mean([one.warned_before for one in m])} "
            f"| {100.0 * np.mean([one.seen_ahead or 0.0 for one in m]):.0f} % "
            f"| {np.mean([one.still_time for one in m]):.1f} |\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
