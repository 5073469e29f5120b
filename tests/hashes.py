"""Stored hashes of flights: `python tests/hashes.py` writes `hashes.json` anew, after a change that is meant to alter
results.

Results depend on the processor, the C library and the versions of Python, NumPy and numba: the file names those that it
was made with. Digests are by field, as the padding of records differs between processes.
"""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import binding

from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.running.flying import fly
from sim.env.patch import CoveragePatch
from sim.scenario.loading import load_scenario, scenario_names
from sim.server.recorder import platform_row

FILE = Path(__file__).with_name("hashes.json")
DURATION = 20.0
TICKS = 300
SEEDS = [3, 4, 5]
BATCHES: dict[str, tuple[str, list[str], dict[str, Any]]] = {
    "plane": (
        "escort",
        ["law.name=certified"],
        {"estimate": True, "gradient": True, "coverage_patch": CoveragePatch(9, 0.5)},
    ),
    "courtyard": ("courtyard", [], {}),
    "unknown": (
        "rescue-town",
        ["buildings.known=false", "building_field.0.street=6.0"],
        {"error": True},
    ),
}
"""Scenario, overrides and settings of each batch."""


def made_with() -> dict[str, str]:
    """Return the versions and the processor on which the last bits of results depend."""
    return {**platform_row(), "processor": binding.get_host_cpu_name()}


def trajectory(name: str) -> str:
    """Return the hash of a shipped scenario, flown in one process."""
    scenario = load_scenario(name, overrides=[f"duration={DURATION}"])
    return fly(scenario, scenario.seed)[1].trajectory_sha256


def _fields(state: Any, name: str) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the arrays of a state, and of a structured array those of its fields."""
    if hasattr(state, "_asdict"):
        for part, value in state._asdict().items():
            yield from _fields(value, f"{name}.{part}".lstrip("."))
    elif isinstance(state, np.ndarray):
        if state.dtype.names is None:
            yield name, state
        for field in state.dtype.names or ():
            yield from _fields(state[field], f"{name}.{field}")


def batch(name: str) -> dict[str, str]:
    """Return a digest of each field of a batch after some seconds."""
    scenario, overrides, settings = BATCHES[name]
    loop = ClosedLoop(load_scenario(scenario, overrides=overrides), len(SEEDS), **settings)
    loop.begin(SEEDS)
    loop.fly(TICKS)
    return {
        field: hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:16]
        for state in (loop.state, loop.pilots and loop.pilots.state)
        for field, values in _fields(state, "")
    }


def main() -> None:
    """Write the file."""
    found = {
        "made_with": made_with(),
        "trajectories": {name: trajectory(name) for name in scenario_names()},
        "batches": {name: batch(name) for name in BATCHES},
    }
    FILE.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
