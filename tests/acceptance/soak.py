"""An hour of simulated time at full speed, with processes killed and stopped at random.

Does anything leak, drift or change?

Flies `outrider run --respawn` and prints the disturbances, the growth of each process's memory, and whether the
trajectory equals that of an undisturbed run in one process. Exit code 0 if it does and nothing is left behind.

Example: python tests/acceptance/soak.py --duration 3600 --seed 1
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
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np

from outrider.running.flying import fly
from sim.scenario.loading import load_scenario

PAGE = os.sysconf("SC_PAGE_SIZE") / 2**20
"""Size of a memory page [MB]."""
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP)
"""The signals to a vehicle's process; kills come twice as often."""


def respawning(
    duration: float, folder: str, errors: "IO[bytes] | int"
) -> "subprocess.Popen[bytes]":
    """Start a run of `escort` that restarts lost vehicles.

    Args:
        duration: Simulated time [s].
        folder: Folder of its temporary files.
        errors: File for its standard error.
    """
    arguments = ["run", "escort", "--duration", str(duration), "--respawn", "--no-files", "--json"]
    return subprocess.Popen(
        [sys.executable, "-m", "outrider", *arguments],
        stdout=subprocess.PIPE,
        stderr=errors,
        env=os.environ | {"TMPDIR": folder},
    )


def words(pid: int) -> list[str]:
    """Return the command line of a process; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
    except (FileNotFoundError, ProcessLookupError):
        return []


def family(pid: int) -> dict[int, str]:
    """Return the kind of each process of the run by pid."""
    try:
        children = [
            int(child)
            for child in Path(f"/proc/{pid}/task/{pid}/children")
            .read_text(encoding="ascii")
            .split()
        ]
    except (FileNotFoundError, ProcessLookupError):
        return {}
    found = {child: words(child) for child in children}
    return {
        child: arguments[arguments.index("outrider") + 1]
        for child, arguments in found.items()
        if "outrider" in arguments
    }


def memory(pid: int) -> float | None:
    """Return the memory of a process [MB]; None if it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * PAGE
    except (FileNotFoundError, ProcessLookupError):
        return None


class Tracks:
    """Memory of each process over wall time."""

    def __init__(self) -> None:
        self._samples: dict[tuple[str, int], list[tuple[float, float]]] = {}

    @property
    def pids(self) -> set[int]:
        """Return all processes that were sampled."""
        return {pid for _, pid in self._samples}

    def sample(self, run: int, seconds: float) -> None:
        """Sample the memory of all processes once."""
        for pid, kind in family(run).items():
            used = memory(pid)
            if used is not None:
                self._samples.setdefault((kind, pid), []).append((seconds, used))

    def lines(self) -> list[str]:
        """Return memory and growth, after the initial phase, of each process that lived long enough."""
        report_lines = []
        for (kind, pid), samples in self._samples.items():
            rows = np.array(samples)
            settled = rows[len(rows) // 4 :]
            if len(settled) < 8 or settled[-1, 0] - settled[0, 0] < 20.0:
                continue
            span = settled[-1, 0] - settled[0, 0]
            growth = float(np.polyfit(settled[:, 0], settled[:, 1], 1)[0]) * span
            report_lines.append(
                f"{kind:10} {pid:8d}  {rows[-1, 1]:7.1f} MB  {growth:+8.2f} MB over {span:5.0f} s"
            )
        return report_lines


def disturb_vehicle(
    run: int, rng: random.Random, disturbances: Sequence[signal.Signals] = SIGNALS
) -> str:
    """Send a signal to one of the vehicles' processes; return its description, or "" if there is no process."""
    victims = {pid: kind for pid, kind in family(run).items() if kind in ("uav", "ugv")}
    if not victims:
        return ""
    pid = rng.choice(sorted(victims))
    disturbance = rng.choice(disturbances)
    try:
        os.kill(pid, disturbance)
        if disturbance is signal.SIGSTOP:
            time.sleep(rng.uniform(0.2, 2.5))
            os.kill(pid, signal.SIGCONT)
    except ProcessLookupError:
        return ""
    return f"{disturbance.name} {victims[pid]}"


def watch(
    run: "subprocess.Popen[bytes]", rng: random.Random, every: float
) -> tuple[Tracks, list[str]]:
    """Follow a run to its end, and disturb it every few seconds of wall time."""
    started = time.monotonic()
    tracks, disturbances, due = Tracks(), list[str](), started + 2.0 * every
    while run.poll() is None:
        time.sleep(0.5)
        now = time.monotonic()
        tracks.sample(run.pid, now - started)
        sys.stderr.write(f"\r{now - started:6.0f} s, {len(disturbances)} disturbances ")
        if now > due:
            due = now + rng.uniform(0.5, 1.5) * every
            disturbance = disturb_vehicle(run.pid, rng)
            if disturbance:
                disturbances.append(f"{disturbance} at {now - started:.1f} s")
    sys.stderr.write("\n")
    return tracks, disturbances


def main() -> int:
    """Fly, disturb, and compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, default=3600.0, help="simulated time [s]")
    parser.add_argument("--seed", type=int, default=1, help="of the disturbances")
    parser.add_argument(
        "--every",
        type=float,
        default=6.0,
        help="wall time between two disturbances, on average [s]",
    )
    options = parser.parse_args()
    rng = random.Random(options.seed)
    with tempfile.TemporaryDirectory(prefix="o-") as folder:
        started = time.monotonic()
        with respawning(options.duration, folder, subprocess.DEVNULL) as run:
            tracks, disturbances = watch(run, rng, options.every)
            out, _ = run.communicate(timeout=120)
        seconds = time.monotonic() - started
        left = os.listdir(folder)
    summary = json.loads(out)
    scenario = load_scenario("escort", overrides=[f"duration={options.duration}"])
    undisturbed = fly(scenario, scenario.seed)[1].trajectory_sha256
    same = summary["trajectory_sha256"] == undisturbed
    report = [
        f"{summary['ticks']} ticks, {options.duration:g} s of simulated time in {seconds:.0f} s, exit code "
        f"{run.returncode}",
        f"{len(disturbances)} disturbances: {'; '.join(disturbances)}",
        f"faults counted: {summary['faults']}",
        *tracks.lines(),
        f"trajectory: {'the same as undisturbed' if same else 'CHANGED'} ({summary['trajectory_sha256']})",
        f"left behind: {left or 'nothing'}, {sum(bool(words(pid)) for pid in tracks.pids)} processes",
    ]
    sys.stdout.write("\n".join(report) + "\n")
    return 0 if same and not left and run.returncode == 0 and disturbances else 1


if __name__ == "__main__":
    sys.exit(main())
