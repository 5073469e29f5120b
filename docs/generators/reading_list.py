"""Reading list of docs/explanation/code.md: the files of one tick, with their sizes."""

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
MOST_LINES = 2500
"""Largest size of all files [lines]."""
FILES = {
    "sim/server/flight.py": "main loop, `Flight.fly_tick`: observations out, commands in, the world one tick further",
    "sim/server/perception.py": "observation of a vehicle, from the world and its links",
    "bus/messages/vehicle.py": "messages between the simulator and a vehicle",
    "agents/uav.py": "pilot of a UAV: converts an observation, calls the tick, answers with a command",
    "agents/uav_tick.py": "on-board software of a UAV in a tick, which pilots and batches call",
    "agents/laws/logarithmic.py": "one law: memory and command",
    "agents/laws/common.py": "the two terms of the laws, (6) to (17)",
    "agents/safety/control.py": "safety filter in a tick: its measurements, then its decision",
    "agents/safety/decision.py": "decision of the safety filter",
    "sim/engine/world_tick.py": "one tick of a world: sends commands over their links, moves the vehicles, senses",
}
"""Content of each file, in the order of a tick."""


def table() -> str:
    """Return the table of the files, with sizes rounded to 50 lines.

    Raises:
        ValueError: If the files have more than `MOST_LINES` lines.
    """
    sizes = {file: len((ROOT / file).read_text("utf-8").splitlines()) for file in FILES}
    if sum(sizes.values()) > MOST_LINES:
        raise ValueError(f"{sum(sizes.values())} lines: too long; allowed: {MOST_LINES}")
    rows = ["| file | lines, about | content |", "|---|--:|---|"]
    for file, content in FILES.items():
        lines = max(50, 50 * round(sizes[file] / 50))
        rows.append(f"| [{file}](../../{file}) | {lines} | {content} |")
    return "\n".join(rows)
