"""Tools for the tests of the bridges: environments of third-party programs, processes, and a table of findings."""

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
"""The root of the repository."""


class Row(NamedTuple):
    """A finding of a check."""

    what: str
    value: object
    holds: bool


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """Return a port of this machine on which no process listens."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def environment(name: str, packages: Sequence[object], python: str = sys.executable) -> Path:
    """Create the environment `.venv-NAME` on the first call; return its folder of programs."""
    folder = ROOT / f".venv-{name}"
    if not (folder / ".bridge").exists():
        subprocess.run([python, "-m", "venv", folder], check=True)
        quiet = ["-m", "pip", "install", "--quiet", "--quiet", "--disable-pip-version-check"]
        subprocess.run([folder / "bin" / "python", *quiet, *map(str, packages)], check=True)
        (folder / ".bridge").touch()
    return folder / "bin"


def outrider(*words: object) -> list[str]:
    """Return the command line of an outrider command."""
    return [sys.executable, "-m", "outrider", *map(str, words)]


def called(
    *words: object,
    patience: float = 300.0,
    **settings: Any,
) -> "subprocess.CompletedProcess[str]":
    """Run a program and return its result, for `patience` [s] at most."""
    return subprocess.run(
        [str(word) for word in words],
        capture_output=True,
        text=True,
        check=False,
        timeout=patience,
        **settings,
    )


def output(
    *words: object,
    **settings: Any,
) -> str:
    """Return the standard output of a program.

    Raises:
        SystemExit: If it fails.
    """
    done = called(*words, **settings)
    if done.returncode:
        raise SystemExit(f"{words[:4]}: {done.stdout[-1500:]} {done.stderr[-1500:]}")
    return done.stdout


def json_of(*words: object) -> dict[str, Any]:
    """Return the JSON output of an outrider command."""
    found: dict[str, Any] = json.loads(output(*outrider(*words)))
    return found


@contextmanager
def started(
    log: Path,
    words: Sequence[object],
    **settings: Any,
) -> Iterator["subprocess.Popen[str]"]:
    """Run a process in the background; terminate it at the end, or kill it.

    Args:
        log: File for standard error; standard output goes to the same name with `.out`.
        words: The command.
        settings: Further arguments of `subprocess.Popen`, such as `cwd`.
    """
    with log.open("w") as file, log.with_suffix(".out").open("w") as out:
        process = subprocess.Popen(
            [str(word) for word in words], stdout=out, stderr=file, text=True, **settings
        )
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def report(findings: Callable[[Path], Iterator[Row]], about: str | None) -> int:
    """Print all findings as rows of a table; return the exit code, 1 if one does not hold.

    Args:
        findings: Yields the findings in a temporary folder, which is also the working directory.
        about: The help text of the program, which has no arguments.
    """
    argparse.ArgumentParser(description=about).parse_args()
    good = True
    with tempfile.TemporaryDirectory() as scratch:
        os.chdir(scratch)
        for found in findings(Path(scratch)):
            good = good and found.holds
            mark = "holds" if found.holds else "DOES NOT HOLD"
            print(f"| {found.what} | {found.value} | {mark} |", flush=True)
    return 0 if good else 1


def await_text(file: Path, text: str, patience: float = 120.0) -> None:
    """Wait until a log contains a text.

    Raises:
        SystemExit: If the text does not appear in time.
    """
    limit = time.monotonic() + patience
    while text not in file.read_text():
        if time.monotonic() > limit:
            raise SystemExit(f"{file.name} never said {text!r}: {file.read_text()[-500:]}")
        time.sleep(0.1)
