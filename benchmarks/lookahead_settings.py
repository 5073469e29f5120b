"""Benefit and cost on one core of the horizon and the number of candidates of the law `lookahead`.

python benchmarks/lookahead_settings.py --flights 6
"""

import argparse
import sys
import time
from collections.abc import Sequence

import msgspec
from markdown_tables import head
from rich.console import Console
from rich.progress import track

from bus.law_parameters import law_parameters
from bus.messages.scenario import Law
from outrider.closed_loop.closed_loop import ClosedLoop
from sim.scenario.loading import load_scenario

DRIVERS = ("waypoints", "wander", "evade")
FIRST_SEED = 501
"""First seed of the law's development runs; docs/how-to/learning.md uses others."""
LAWS = (
    Law(name="logarithmic"),
    Law(name="certified"),
    *(
        Law(name="lookahead", parameters={"candidates": 1, "horizon": horizon})
        for horizon in (15.0,)
    ),
    *(
        Law(name="lookahead", parameters={"horizon": horizon})
        for horizon in (0.5, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0)
    ),
    *(
        Law(name="lookahead", parameters={"candidates": candidates})
        for candidates in (20, 100, 300, 2000)
    ),
)


def fly(law: Law, driver: str, seeds: Sequence[int]) -> tuple[float, float]:
    """Return the mean of e(t) over these runs of `escort` [m²], and the processor time per tick, world included [s]."""
    scenario = msgspec.structs.replace(load_scenario("escort"), law=law)
    loop = ClosedLoop(
        scenario,
        len(seeds),
        pilots={"ugv_0": driver},
        error=True,
        end_on_sight_lost=False,
        threads=1,
    )
    loop.begin(seeds)
    began = time.process_time()
    loop.fly()
    spent = time.process_time() - began
    found = loop.metrics("uav_0")
    loop.close()
    if found["visibility_violations"].any():
        raise SystemExit(f"{law.name} loses sight of a UGV with the driver {driver!r}")
    return float(found["mean_error"].mean()), spent / float(found["ticks"].sum())


def main() -> None:
    """Simulate all runs, and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--flights", type=int, default=6, help="Runs per law and driver.")
    given = parser.parse_args()
    seeds = range(FIRST_SEED, FIRST_SEED + given.flights)
    drivers = " | ".join(f"`{driver}`" for driver in DRIVERS)
    lines = [head(f"law | horizon [s] | candidates | {drivers} | µs per tick")]
    console = Console(file=sys.stderr)
    for law in track(LAWS, "simulating", console=console):
        flown = [fly(law, driver, seeds) for driver in DRIVERS]
        own = law_parameters(law)
        numbers = (f"{own.horizon:g} | {own.candidates}") if law.name == "lookahead" else "- | -"
        errors = " | ".join(f"{error:.1f}" for error, _ in flown)
        spent = 1e6 * min(tick for _, tick in flown)
        lines.append(f"| {law.name} | {numbers} | {errors} | {spent:.0f} |")
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
