"""A vehicle killed at any moment, from its process' start to the run's end: does `--respawn` fly the same bits?

Flies a short run again and again, kills one vehicle's process of each at a random moment, and prints what became
of it. Exit code 0 if every run flew the trajectory of an undisturbed one and nothing is left behind.

Example: python tests/acceptance/kill.py --kills 40 --seed 1
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

from soak import respawning, strike

from outrider.running.flying import fly
from sim.scenario.loading import load_scenario

_PATIENCE = 300.0
"""A run that has not ended after so long [s] is stuck."""
KILLS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM)
"""The blows of which a process dies."""

Blow = Callable[["subprocess.Popen[bytes]"], str]


def flown(duration: float, blow: Blow) -> tuple[str, dict[str, object], str, float]:
    """One run, disturbed: what was done to it, its summary, its standard error, and how long it took [s]."""
    started = time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="o-") as folder,
        tempfile.TemporaryFile() as said,
        respawning(duration, folder, said) as run,
    ):
        done = blow(run)
        out, _ = run.communicate(timeout=_PATIENCE)
        said.seek(0)
        told = said.read().decode(errors="replace")
        summary = json.loads(out) if out.strip() else {}
        summary["code"], summary["left"] = run.returncode, os.listdir(folder)
    return done, summary, told, time.monotonic() - started


def at(moment: float, rng: random.Random) -> Blow:
    """Kill one vehicle so long after the run's start [s], or as soon as there is one."""

    def blow(run: "subprocess.Popen[bytes]") -> str:
        time.sleep(moment)
        while run.poll() is None:
            if done := strike(run.pid, rng, KILLS):
                return done
            time.sleep(0.002)
        return ""

    return blow


def main() -> int:
    """Fly, kill, and judge."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--kills", type=int, default=40, help="how many vehicles are killed, one in each run"
    )
    parser.add_argument("--duration", type=float, default=200.0, help="simulated time of a run [s]")
    parser.add_argument("--seed", type=int, default=1, help="of victims and moments")
    options = parser.parse_args()
    rng = random.Random(options.seed)
    scenario = load_scenario("escort", overrides=[f"duration={options.duration}"])
    wanted = fly(scenario, scenario.seed)[1].trajectory_sha256
    span = flown(options.duration, lambda _run: "")[3]
    struck = bad = early = 0
    while struck < options.kills:
        moment = rng.uniform(0.0, span)
        done, summary, told, seconds = flown(options.duration, at(moment, rng))
        if not done:
            span = min(span, seconds)  # it was over before
            continue
        struck += 1
        lost = told.partition("disconnected at tick ")[2].split()[:1]
        before = not lost or lost == ["0"]
        early += before
        fine = (
            summary.get("trajectory_sha256") == wanted
            and summary["code"] == 0
            and not summary["left"]
        )
        bad += not fine
        where = f"lost at tick {lost[0]}" if lost else "nobody had met it, or the flight was over"
        sys.stdout.write(
            f"{struck:3d}  {moment:6.2f} s  {done:12}  {where:42}  {'the same' if fine else 'CHANGED'}\n"
        )
        if not fine:
            sys.stdout.write(f"{told}\n{summary}\n")
        sys.stdout.flush()
    sys.stdout.write(
        f"{struck} kills, {early} of them before the first tick or after the last: {struck - bad} with one hash\n"
    )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
