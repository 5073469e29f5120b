"""A vehicle killed at a random time between the start of its process and the end of the run, with `--respawn`.

Repeats a short run, kills one vehicle's process at a random time, and prints the outcome. Exit code 0 if every run flew
the trajectory of an undisturbed one and nothing is left behind.

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

from soak import disturb_vehicle, respawning

from outrider.running.flying import fly
from sim.scenario.loading import load_scenario

_PATIENCE = 300.0
"""Time limit of a run [s]."""
KILLS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM)
"""The signals that end a process."""

Disturbance = Callable[["subprocess.Popen[bytes]"], str]


def flown(duration: float, disturb: Disturbance) -> tuple[str, dict[str, object], str, float]:
    """Return the disturbance of one run, its summary, its standard error, and its duration [s]."""
    started = time.monotonic()
    with (
        tempfile.TemporaryDirectory(prefix="o-") as folder,
        tempfile.TemporaryFile() as log_file,
        respawning(duration, folder, log_file) as run,
    ):
        done = disturb(run)
        out, _ = run.communicate(timeout=_PATIENCE)
        log_file.seek(0)
        log = log_file.read().decode(errors="replace")
        summary = json.loads(out) if out.strip() else {}
        summary["code"], summary["left"] = run.returncode, os.listdir(folder)
    return done, summary, log, time.monotonic() - started


def at(moment: float, rng: random.Random) -> Disturbance:
    """Kill one vehicle this long after the start of the run [s], or as soon as one exists."""

    def disturb(run: "subprocess.Popen[bytes]") -> str:
        time.sleep(moment)
        while run.poll() is None:
            if done := disturb_vehicle(run.pid, rng, KILLS):
                return done
            time.sleep(0.002)
        return ""

    return disturb


def main() -> int:
    """Kill vehicles, and compare the trajectories."""
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
        done, summary, log, seconds = flown(options.duration, at(moment, rng))
        if not done:
            span = min(span, seconds)  # the run had already ended
            continue
        struck += 1
        lost = log.partition("disconnected at tick ")[2].split()[:1]
        before = not lost or lost == ["0"]
        early += before
        fine = (
            summary.get("trajectory_sha256") == wanted
            and summary["code"] == 0
            and not summary["left"]
        )
        bad += not fine
        where = f"lost at tick {lost[0]}" if lost else "before the first tick, or after the last"
        sys.stdout.write(
            f"{struck:3d}  {moment:6.2f} s  {done:12}  {where:42}  {'the same' if fine else 'CHANGED'}\n"
        )
        if not fine:
            sys.stdout.write(f"{log}\n{summary}\n")
        sys.stdout.flush()
    sys.stdout.write(
        f"{struck} kills, {early} of them before the first tick or after the last: {struck - bad} with one hash\n"
    )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
