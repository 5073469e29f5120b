"""Bags of `outrider ros2 export` and `outrider record --format ros2` with third-party readers.

rosbags and mcap-ros2-support are installed into `.venv-bags`, and the real rclpy into the environment of
ros2_nodes.py, if Python 3.11 is available: make bridge-test ARGS=bags
"""

import csv
import json
import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from bridge_checks import Row, await_text, environment, json_of, output, report
from ros2_nodes import RCLPY, Run

FOREIGN = Path(__file__).resolve().parent / "foreign"

READERS = ("rosbags>=0.11,<0.12", "mcap-ros2-support>=0.5.7", "ruamel.yaml")
SCENARIO, DURATION = "minefield", 20
NOT_IN_WHEELS = "tf2_msgs"
"""A package without a wheel for rclpy."""


def flown(folder: Path) -> tuple[dict[str, Any], dict[str, list[list[str]]]]:
    """Record a flight; return its summary and each vehicle's position and velocity as in `trajectory.csv`, in hex."""
    summary = json_of(
        "run", SCENARIO, "--in-process", "--duration", DURATION, "--record", folder / "run.mcap",
        "--out", folder / "out", "--no-picture", "--json",
    )  # fmt: skip
    with (folder / "out" / "trajectory.csv").open() as file:
        rows = list(csv.DictReader(file))
    columns = ("x [m]", "y [m]", "vx [m/s]", "vy [m/s]")
    tracks = {
        name: [[float(row[f"{name}.{column}"]).hex() for column in columns] for row in rows]
        for name in ("uav_0", "ugv_0")
    }
    return summary, tracks


def read(bag: Path, python: Path) -> dict[str, Any]:
    """Return the findings of the readers about a bag."""
    found: dict[str, Any] = json.loads(output(python, FOREIGN / "bags_foreign_readers.py", bag))
    return found


def read_by_others(
    bag: Path, made: dict[str, Any], tracks: dict[str, list[list[str]]], python: Path
) -> Iterator[Row]:
    """Check all messages of all topics, and their values."""
    seen = read(bag, python)
    total = made["messages"]
    for reader in ("rosbags", "mcap-ros2-support"):
        counts, odometry = seen[reader]["counts"], seen[reader]["odometry"]
        wanted = {name: count for name, count in made["topics"].items() if count}
        yield Row(
            f"{reader} decodes every message",
            f"{sum(counts.values())} of {total} on {len(counts)} topics",
            counts == wanted,
        )
        same = odometry == tracks
        ticks = [len(rows) for rows in tracks.values()]
        yield Row(
            f"its odometry is trajectory.csv, as float64 ({reader})",
            f"{ticks} rows of x, y, vx, vy",
            same and min(ticks) > 20 * DURATION,
        )
    counted = seen["metadata"]["counts"]
    yield Row(
        "metadata.yaml counts what is there",
        f"{seen['metadata']['messages']} messages on {len(counted)} topics",
        counted == made["topics"] and seen["metadata"]["messages"] == total,
    )
    yield Row(
        "its qualities of service have rosbag2's fields, its types hashes",
        f"version {seen['metadata']['version']}, wrong: {seen['metadata']['wrong']}",
        not seen["metadata"]["wrong"],
    )
    statistics = seen["mcap-ros2-support"]["statistics"]
    yield Row("the MCAP's own statistics", f"{statistics} messages", statistics == total)


def rewritten(folder: Path, bag: Path, summary: dict[str, Any], tools: Path) -> Iterator[Row]:
    """Fly the bag again, unchanged and after rosbags-convert."""
    variants: dict[str, tuple[str, ...]] = {
        "as it is": (),
        "rosbags-convert to MCAP": ("--dst-storage", "mcap"),
        "rosbags-convert to MCAP, packed": (
            "--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "storage",
        ),
        "rosbags-convert to SQLite, and from there to MCAP": ("--dst-storage", "mcap"),
        "rosbags-convert, the records alone": (
            "--dst-storage", "mcap", "--include-topic", "/outrider/recording",
        ),
    }  # fmt: skip
    other = folder / "sqlite"
    convert = tools / "rosbags-convert"
    output(convert, "--src", bag, "--dst", other, "--dst-storage", "sqlite3")
    for number, (name, options) in enumerate(variants.items()):
        copy, source = bag, other if "SQLite" in name else bag
        if options:
            copy = folder / f"rewritten{number}"
            output(convert, "--src", source, "--dst", copy, *options)
        file = folder / f"again{number}.mcap"
        json_of("ros2", "import", copy, file, "--json")
        again = json_of("replay", file, "--refly", "--json")
        yield Row(
            f"replay --refly, {name}",
            f"{again['ticks']} ticks, {again['trajectory_sha256'][:16]}",
            again["same"] and again["trajectory_sha256"] == summary["trajectory_sha256"],
        )


def read_by_rclpy(
    folder: Path, bag: Path, made: dict[str, Any], tracks: dict[str, list[list[str]]], python: Path
) -> Iterator[Row]:
    """Check that the real rclpy reads all payloads."""
    interpreter = shutil.which("python3.11")
    if interpreter is None:
        yield Row("rclpy", "not tried: its wheels need Python 3.11", True)
        return
    rclpy = environment("ros2-rclpy", RCLPY, interpreter)
    payloads = folder / "payloads.pickle"
    output(python, FOREIGN / "bags_foreign_readers.py", bag, payloads)
    found = json.loads(output(rclpy / "python", FOREIGN / "bags_rclpy_reader.py", payloads))
    left = sum(made["topics"][name] for name in ("/tf", "/tf_static"))
    yield Row(
        "rclpy deserialises every payload",
        f"{found['read']} of {made['messages']}; no wheel: {found['untried']}",
        found["read"] == made["messages"] - left and found["untried"] == [NOT_IN_WHEELS],
    )
    same = found["odometry"] == tracks
    yield Row("its odometry is trajectory.csv, as float64 (rclpy)", same, same)


def live(folder: Path, python: Path) -> Iterator[Row]:
    """Record a run in lockstep, over processes with credentials, directly into a bag."""
    with ExitStack() as stack:
        run = Run(stack, folder, "escort", "--duration", DURATION)
        recorder = run.join(
            "record", "observer", "record", folder / "live", "--format", "ros2", "--scenario", "escort",
            "--set", f"duration={DURATION}", "--json",
        )  # fmt: skip
        await_text(folder / "record.log", "waiting for the run")
        run.join("uav", "uav_0", "uav")
        run.join("ugv", "ugv_0", "ugv")
        run.simulator.wait(120.0)
        recorder.wait(120.0)
        summary, recorded = run.json_of("simulator"), run.json_of("record")
    json_of("ros2", "import", folder / "live", folder / "live.mcap", "--json")
    again = json_of("replay", folder / "live.mcap", "--refly", "--json")
    yield Row(
        "record --format ros2, a live run in lockstep",
        f"{recorded['ticks']} ticks, {recorded['missing_ticks']} missing; "
        f"{summary['ticks_per_second']:.0f} ticks/s; {again['trajectory_sha256'][:16]}",
        again["same"] and again["trajectory_sha256"] == summary["trajectory_sha256"],
    )
    seen = read(folder / "live", python)
    counts = seen["metadata"]["counts"]
    whole = all(
        {name: count for name, count in counts.items() if count} == seen[reader]["counts"]
        for reader in ("rosbags", "mcap-ros2-support")
    )
    yield Row(
        "both readers read all of it",
        f"{seen['metadata']['messages']} messages, {counts['/uav_0/odom']} odometries",
        whole and counts["/uav_0/odom"] == recorded["ticks"],
    )


def findings(folder: Path) -> Iterator[Row]:
    """Run all checks."""
    tools = environment("bags", READERS)
    python, bag = tools / "python", folder / "bag"
    summary, tracks = flown(folder)
    made = json_of("ros2", "export", folder / "run.mcap", bag, "--json")
    yield from read_by_others(bag, made, tracks, python)
    yield from rewritten(folder, bag, summary, tools)
    yield from read_by_rclpy(folder, bag, made, tracks, python)
    (folder / "live-run").mkdir()
    yield from live(folder / "live-run", python)


if __name__ == "__main__":
    sys.exit(report(findings, __doc__))
