"""Table of extensions/outrider_networks/README.md.

python benchmarks/exceedance_table.py [RUNS]: 100,000 by default, some minutes.

The table compares computed exceedance probabilities of declared bounds with frequencies in runs over the compiled link
itself. Detections and packets are sent as in a run. The trajectory protocol is simulated packet by packet, without
windows or chains of states.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bus.messages.links import LinkSettings
from bus.profiles import PROFILES
from bus.ticks import ticks_within
from outrider.experiments.intervals import wilson_interval
from outrider_networks.link_runs import Probability
from outrider_networks.probabilities import (
    age_exceedance,
    command_interval_exceedance,
    smallest_age,
    smallest_command_interval,
)
from sim.channel.description import link_parameters
from sim.channel.link_records import ARRIVED
from sim.channel.links import exchange, new_links
from sim.channel.recorded import RecordedLink, pack
from sim.compiling.compile import IntArray, compiled
from sim.compiling.records import RecordArray
from sim.models.randomness import DETECTION_CHANCE, uniform

DT, TICKS, SEED = 0.05, 1200, 1
RECORDINGS = Path(__file__).resolve().parent.parent / "examples" / "networks"
REPEATS = 6
RISK = 0.01
SURE = 0.99
"""Level of the confidence intervals."""


Traces = tuple[RecordedLink, ...]


@compiled
def _begin(links: RecordArray, fresh: RecordArray, seed: int, run: int) -> None:
    """Reset a link that has carried no message yet, with the key of a run."""
    links[0, 0] = fresh[0, 0]
    links[0, 0].key[0], links[0, 0].key[1] = np.uint64(seed), np.uint64(run)


@compiled
def _too_old(
    links: RecordArray,
    packets: RecordArray,
    traces: IntArray,
    seed: int,
    runs: int,
    ticks: int,
    period: int,
    dropout: float,
    age: int,
) -> int:
    """Count the runs in which the newest detection becomes older than `age` [ticks]."""
    count, fresh, stamps = 0, links.copy(), np.zeros(1)
    for run in range(runs):
        _begin(links, fresh, seed, run)
        newest, key = -1, (np.uint64(~seed), np.uint64(run))
        for tick in range(ticks):
            found = tick % period == 0 and uniform(key, DETECTION_CHANCE, tick, 0) >= dropout
            stamps[0] = tick
            for k in range(exchange(links, packets, 0, traces, tick, stamps[: int(found)])):
                newest = max(newest, int(packets[0, 0, ARRIVED, k].stamp))
            if newest >= 0 and tick - newest > age:
                count += 1
                break
    return count


@compiled
def _interrupted(
    links: RecordArray,
    packets: RecordArray,
    traces: IntArray,
    seed: int,
    runs: int,
    ticks: int,
    delay: int,
    repeats: int,
    interval: int,
) -> int:
    """Count the runs in which no trajectory starts within `interval` [ticks] after the last start."""
    count, fresh, stamps = 0, links.copy(), np.zeros(1)
    parents, lowest = np.zeros(ticks, dtype=np.int64), np.zeros(ticks, dtype=np.int64)
    known = np.zeros(ticks, dtype=np.bool_)
    for run in range(runs):
        _begin(links, fresh, seed, run)
        known[:] = False
        chain, flown, started = 0, -1, delay - 1
        for tick in range(ticks):
            due = tick - 1 - delay
            if due >= chain and flown != due:  # it did not start in the previous tick
                chain = tick
            parents[tick] = flown if tick == chain else tick - 1
            lowest[tick] = max(chain, tick - repeats + 1)
            stamps[0] = tick
            for k in range(exchange(links, packets, 0, traces, tick, stamps)):
                packet = packets[0, 0, ARRIVED, k].sent_at
                for trajectory in range(lowest[packet], packet + 1):
                    known[trajectory] = True
            due = tick - delay
            if due >= 0 and known[due] and parents[due] == flown:
                flown, started = due, tick
            elif tick - started >= interval:
                count += 1
                break
    return count


def ages_exceeded(
    settings: LinkSettings,
    *,
    dt: float,
    period_ticks: int,
    dropout: float,
    ticks: int,
    age: float,
    runs: int,
    traces: Traces = (),
) -> int:
    """Count the runs that exceed the age; arguments as of `age_exceedance`."""
    limit = ticks_within(age, dt)
    link = new_links([link_parameters(settings, dt, traces=traces)])
    return int(_too_old(*link, SEED, runs, ticks, period_ticks, dropout, limit))


def command_intervals_exceeded(
    settings: LinkSettings,
    *,
    dt: float,
    delay_ticks: int,
    repeats: int,
    ticks: int,
    max_command_interval: float,
    runs: int,
    traces: Traces = (),
) -> int:
    """Count the runs that exceed the command interval; arguments as of `command_interval_exceedance`."""
    limit = ticks_within(max_command_interval, dt)
    link = new_links([link_parameters(settings, dt, traces=traces)])
    return int(_interrupted(*link, SEED, runs, ticks, delay_ticks, repeats, limit))


def agrees(probability: Probability, count: int, runs: int) -> bool:
    """Return true if an exact probability is within the interval, or a bound is not below it."""
    low, high = wilson_interval(count, runs, SURE)
    return probability.value is None or (
        low <= probability.value <= high if probability.exact else low <= probability.value
    )


def _row(name: str, number: float, probability: Probability, count: int, runs: int) -> str:
    """Return a row of the table."""
    low, high = wilson_interval(count, runs, SURE)
    value = "–" if probability.value is None else f"{probability.value:.5f}"
    kind = "exact" if probability.exact else "bound"
    frequency = f"{count / runs:.5f} | {low:.5f} to {high:.5f}"
    agreement = "yes" if agrees(probability, count, runs) else "**no**"
    return f"| {name} | {number:g} | {value} | {kind} | {frequency} | {agreement} |"


OWN = {
    "30 % lost": LinkSettings(loss=0.3),
    "10 % lost, bursts of 0.5 s": LinkSettings(
        delay=0.1, loss=0.1, burst_length=0.5, burst_interval=10.0, burst_loss=0.9
    ),
    "5 % lost, planned blackouts": LinkSettings(
        delay=0.1, loss=0.05, blackouts=((20.0, 1.0), (40.0, 0.5))
    ),
    "10 % lost, random blackouts": LinkSettings(
        loss=0.1, blackout_interval=30.0, blackout_length=0.52
    ),
    "10 % lost, jitter to 0.4 s": LinkSettings(
        delay=0.1, loss=0.1, jitter=0.1, jitter_shape="exponential", max_jitter=0.3
    ),
}


def _links() -> Iterator[tuple[str, LinkSettings, Traces]]:
    for name, settings in {**PROFILES, **OWN}.items():
        yield name, settings, ()
    for path in sorted(RECORDINGS.glob("*.csv")):
        recorded = pack(path.name, path.read_bytes())
        yield f"recorded, {path.stem}", LinkSettings(trace=path.name), (recorded,)


def rows(runs: int) -> Iterator[str]:
    """Yield rows for each link, with bounds exceeded in about one run of a hundred."""
    for name, settings, traces in _links():
        shared = {"dt": DT, "ticks": TICKS, "traces": traces}
        detections = shared | {"period_ticks": 1, "dropout": 0.1}
        age = smallest_age(settings, **detections, risk=RISK).value
        if age is not None:
            count = ages_exceeded(settings, **detections, age=age, runs=runs)
            probability = age_exceedance(settings, **detections, age=age)
            yield _row(f"{name}: age", age, probability, count, runs)
        delay = max(2, link_parameters(settings, DT, traces=traces).longest)
        packets = shared | {"delay_ticks": delay, "repeats": REPEATS}
        interval = smallest_command_interval(settings, **packets, risk=RISK).value
        if interval is not None:
            bound = {"max_command_interval": interval}
            count = command_intervals_exceeded(settings, **packets, **bound, runs=runs)
            probability = command_interval_exceedance(settings, **packets, **bound)
            row = f"{name}: command interval, τ_c {delay * DT:g} s"
            yield _row(row, interval, probability, count, runs)


def main() -> None:
    """Print probabilities beside the frequencies in simulated runs, as a table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument(
        "runs", type=int, nargs="?", default=100_000, help="Number of runs (%(default)s)."
    )
    runs = parser.parse_args().runs
    if runs < 1:
        parser.error(f"runs = {runs}: too few; allowed: 1 or more")
    sys.stdout.write(
        "| link, declared bound | [s] | probability | | frequency | 99 % interval | agrees |\n"
    )
    sys.stdout.write("|---|--:|--:|---|--:|--:|---|\n")
    for row in rows(runs):
        sys.stdout.write(f"{row}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
