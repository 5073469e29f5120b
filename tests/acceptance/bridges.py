"""The bridges with third-party programs: one program per bridge, each with environments of its own.

`make bridge-test`, or `python tests/acceptance/bridges.py NAME ...`; without names all bridges, one after the other.
Each prints its findings as rows of a table; the exit code is 1 if one does not hold.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
EXTENSIONS = FOLDER.parents[1] / "extensions"
BRIDGES = {
    "ros2": "outrider_ros2/tests/acceptance/ros2_nodes.py",
    "paths": "outrider_ros2/tests/acceptance/ros2_paths.py",
    "bags": "outrider_ros2/tests/acceptance/ros2_bags.py",
    "mavlink": "outrider_mavlink/tests/acceptance/mavlink_programs.py",
    "fmi": "outrider_fmi/tests/acceptance/fmi_programs.py",
}
"""Programs in `extensions`, in the order of execution."""


def main(wanted: list[str]) -> int:
    """Run the programs; return the number of failures."""
    failed = 0
    # Compile first: on a new machine the processes of a run would otherwise time out waiting for one another.
    words = ["run", "--in-process", "--duration", "1", "--no-files"]
    subprocess.run([sys.executable, "-m", "outrider", *words], check=True, capture_output=True)
    for name in wanted:
        began = time.monotonic()
        print(f"\n## {name}\n\n| what | found | |\n|---|---|---|", flush=True)
        paths = (str(FOLDER), os.environ.get("PYTHONPATH", ""))  # for bridge_checks
        environ = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
        program = [sys.executable, EXTENSIONS / BRIDGES[name]]
        code = subprocess.run(program, check=False, env=environ).returncode
        failed += code != 0
        word = "holds" if code == 0 else f"FAILS (exit code {code})"
        print(f"\n{name}: {word}, {time.monotonic() - began:.0f} s", flush=True)
    return failed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bridges", nargs="*", metavar="NAME", help=f"of {', '.join(BRIDGES)}")
    asked = parser.parse_args().bridges
    if unknown := [name for name in asked if name not in BRIDGES]:
        parser.error(f"no bridge {unknown[0]!r}; there are {', '.join(BRIDGES)}")
    sys.exit(1 if main(asked or list(BRIDGES)) else 0)
