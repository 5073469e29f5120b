"""Seeded faults: does the suite notice when the product is broken?

    python tests/acceptance/faults.py             every fault of faults.toml
    python tests/acceptance/faults.py gain jitter  the faults whose name contains one of the words

Each fault replaces a text in a copy of the project and runs the tests that should fail. Exit code 1 if one is missed.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SKIPPED = shutil.ignore_patterns(
    ".git", ".venv*", "site", "runs", "figures", "__pycache__", ".*_cache"
)


def is_caught(copy: Path, fault: dict[str, str | list[str]]) -> bool:
    """Return whether a test fails with this fault in the copy.

    Raises:
        ValueError: If the text to replace is not in the file exactly once.
    """
    file = copy / str(fault["file"])
    text = file.read_text(encoding="utf-8")
    if text.count(str(fault["old"])) != 1:
        raise ValueError(
            f"{fault['name']}: {fault['old']!r} is not in {fault['file']} exactly once"
        )
    file.write_text(text.replace(str(fault["old"]), str(fault["new"])), encoding="utf-8")
    try:
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-x",
            "-p",
            "no:cacheprovider",
            *fault["tests"],
        ]
        environment = os.environ | {"PYTHONPATH": f"{copy}{os.pathsep}{copy / 'extensions'}"}
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, check=False)
    finally:
        file.write_text(text, encoding="utf-8")
    return done.returncode == 1


def main(words: list[str]) -> int:
    """Try the faults whose name contains one of the words, or all; return the exit code."""
    faults = tomllib.loads((ROOT / "tests/acceptance/faults.toml").read_text(encoding="utf-8"))
    chosen = [f for f in faults["fault"] if not words or any(word in f["name"] for word in words)]
    missed = []
    with tempfile.TemporaryDirectory(prefix="outrider-faults-") as folder:
        copy = Path(folder) / "project"
        shutil.copytree(ROOT, copy, ignore=SKIPPED)
        for fault in chosen:
            started = time.monotonic()
            caught = is_caught(copy, fault)
            missed += [] if caught else [fault["name"]]
            state = "caught" if caught else "MISSED"
            print(f"{state}  {time.monotonic() - started:6.1f} s  {fault['name']}", flush=True)
    print(f"{len(chosen) - len(missed)} of {len(chosen)} faults caught; missed: {missed or 'none'}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
