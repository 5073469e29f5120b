"""An hour of simulated time at full speed, with processes killed and frozen at random.

Does anything leak, drift or change?

Flies `outrider run --respawn` and prints what was done to it, how the memory of each process grew, and whether the
trajectory is the one of an undisturbed run in one process. Exit code 0 if it is and nothing is left behind.

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

from bus.credentials import read_credential
from bus.joining import open_session
from bus.keys import STATUS, Party, Role
from bus.messages.telemetry import Status
from outrider.running.flying import fly
from sim.scenario.loading import load_scenario

PAGE = os.sysconf("SC_PAGE_SIZE") / 2**20
"""MB."""
BLOWS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP)
"""The signals that strike a vehicle's process; kills come twice as often."""


def respawning(
    duration: float, folder: str, errors: "IO[bytes] | int"
) -> "subprocess.Popen[bytes]":
    """A run of `escort` that starts lost vehicles anew.

    Args:
        duration: Simulated time [s].
        folder: For its temporary files.
        errors: Takes its standard error.
    """
    arguments = ["run", "escort", "--duration", str(duration), "--respawn", "--no-files", "--json"]
    return subprocess.Popen(
        [sys.executable, "-m", "outrider", *arguments],
        stdout=subprocess.PIPE,
        stderr=errors,
        env=os.environ | {"TMPDIR": folder},
    )


def words(pid: int) -> list[str]:
    """A process' command line; empty if it has gone."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
    except (FileNotFoundError, ProcessLookupError):
        return []


def family(pid: int) -> dict[int, str]:
    """The run's processes: pid, and what each is."""
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
        child: said[said.index("outrider") + 1]
        for child, said in found.items()
        if "outrider" in said
    }


def memory(pid: int) -> float | None:
    """Memory of a process [MB]; None if it has gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * PAGE
    except (FileNotFoundError, ProcessLookupError):
        return None


class Tracks:
    """Memory of each process over simulated time."""

    def __init__(self) -> None:
        self._samples: dict[tuple[str, int], list[tuple[float, float]]] = {}

    @property
    def pids(self) -> set[int]:
        """Every process that was ever seen."""
        return {pid for _, pid in self._samples}

    def sample(self, run: int, seconds: float) -> None:
        """Look at all of them once."""
        for pid, kind in family(run).items():
            held = memory(pid)
            if held is not None:
                self._samples.setdefault((kind, pid), []).append((seconds, held))

    def lines(self) -> list[str]:
        """For each process that lived long enough: what it holds, and how fast that grows once it has settled."""
        told = []
        for (kind, pid), samples in self._samples.items():
            rows = np.array(samples)
            settled = rows[len(rows) // 4 :]
            if len(settled) < 8 or settled[-1, 0] - settled[0, 0] < 60.0:
                continue
            slope = float(np.polyfit(settled[:, 0], settled[:, 1], 1)[0]) * 3600.0
            span = settled[-1, 0] - settled[0, 0]
            told.append(
                f"{kind:10} {pid:8d}  {rows[-1, 1]:7.1f} MB  {slope:+8.2f} MB an hour of simulated time, over "
                f"{span:5.0f} s"
            )
        return told


def strike(run: int, rng: random.Random, blows: Sequence[signal.Signals] = BLOWS) -> str:
    """Do something to one of the vehicles' processes; what it was, "" if there is none or it has just gone."""
    victims = {pid: kind for pid, kind in family(run).items() if kind in ("uav", "ugv")}
    if not victims:
        return ""
    pid = rng.choice(sorted(victims))
    blow = rng.choice(blows)
    try:
        os.kill(pid, blow)
        if blow is signal.SIGSTOP:
            time.sleep(rng.uniform(0.2, 2.5))
            os.kill(pid, signal.SIGCONT)
    except ProcessLookupError:
        return ""
    return f"{blow.name} {victims[pid]}"


def watch(
    run: "subprocess.Popen[bytes]", rng: random.Random, every: float
) -> tuple[Tracks, list[str]]:
    """Follow a run to its end, and disturb it every few seconds of wall time."""
    said: list[str] = []
    while "--credentials" not in said:
        time.sleep(0.1)
        said = next(
            (words(pid) for pid, kind in family(run.pid).items() if kind == "simulator"), []
        )
    endpoint, name, known = (
        said[said.index(option) + 1] for option in ("--listen", "--run", "--credentials")
    )
    while not Path(endpoint.removeprefix("unixsock-stream/")).exists():
        time.sleep(0.1)
    tracks, blows, due = Tracks(), list[str](), time.monotonic() + 2.0 * every
    observer, credential = (
        Party(role=Role.OBSERVER, name="observer"),
        read_credential(Path(known).with_name("observer.json")),
    )
    with open_session(observer, name, connect=endpoint, credential=credential) as session:
        inbox, shown = session.inbox(STATUS), 0.0
        while run.poll() is None:
            received = inbox.receive(0.5)
            if received is None or not isinstance(received.message, Status):
                continue
            status = received.message
            now = time.monotonic()
            if now - shown > 1.0:
                shown = now
                tracks.sample(run.pid, status.time)
                sys.stderr.write(
                    f"\r{status.time:8.1f} s of {status.ticks * status.time / max(status.tick, 1):.0f} s, "
                    f"{len(blows)} blows "
                )
            if status.over:
                break
            if now > due and status.tick:
                due = now + rng.uniform(0.5, 1.5) * every
                blow = strike(run.pid, rng)
                if blow:
                    blows.append(f"{blow} at {status.time:.1f} s")
    sys.stderr.write("\n")
    return tracks, blows


def main() -> int:
    """Fly, disturb, and judge."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, default=3600.0, help="simulated time [s]")
    parser.add_argument("--seed", type=int, default=1, help="of the blows")
    parser.add_argument(
        "--every", type=float, default=3.0, help="wall time between two blows, on average [s]"
    )
    options = parser.parse_args()
    rng = random.Random(options.seed)
    with tempfile.TemporaryDirectory(prefix="o-") as folder:
        started = time.monotonic()
        with respawning(options.duration, folder, subprocess.DEVNULL) as run:
            tracks, blows = watch(run, rng, options.every)
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
        f"{len(blows)} blows: {'; '.join(blows)}",
        f"faults counted: {summary['faults']}",
        *tracks.lines(),
        f"trajectory: {'the same as undisturbed' if same else 'CHANGED'} ({summary['trajectory_sha256']})",
        f"left behind: {left or 'nothing'}, {sum(bool(words(pid)) for pid in tracks.pids)} processes",
    ]
    sys.stdout.write("\n".join(report) + "\n")
    return 0 if same and not left and run.returncode == 0 and blows else 1


if __name__ == "__main__":
    sys.exit(main())
