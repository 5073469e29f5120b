"""Speed of our environment and of other packages, each in its own virtual environment.

python benchmarks/peers/peers.py
"""

import argparse
import os
import platform
import signal
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
from peer_processes import Failed, in_one_line, run
from peer_report import OURS, Failure, Report, Row, markdown, worlds_in_words, write
from peer_venvs import provide
from rich.console import Console
from rich.markdown import Markdown

HERE = Path(__file__).resolve().parent
PEERS: dict[str, tuple[str, ...]] = {
    OURS: (),
    "coverage_control": ("coverage_control>=1.3,<2",),
    "jaxmarl": ("jaxmarl>=0.2,<0.3",),
    "mpe2": ("mpe2>=1.1,<2",),
    "vmas": ("vmas>=1.5,<2", "torch>=2.5,<2.14"),
}
"""Each file in `runners/`, and what pip installs for it; ours runs in the interpreter that runs this."""

ERR = Console(stderr=True)


def measure(
    name: str, python: Path, given: argparse.Namespace, *, cwd: Path = HERE
) -> tuple[list[Row], list[Failure]]:
    """Run a peer's measurements.

    Args:
        name: The runner.
        python: The interpreter in which it runs.
        given: Has `seconds` and `repeats`.
        cwd: The folder that has `runners/`.

    Returns:
        What it has measured, and what it could not measure.
    """
    rows: list[Row] = []
    failures: list[Failure] = []

    def read(line: str) -> None:
        if not line.startswith("{"):
            return  # a greeting of the package
        found: dict[str, Any] = msgspec.json.decode(line)
        if "error" in found:
            what = f"{found['name']} {found['variant']}, {worlds_in_words(found['worlds'])}"
            why = in_one_line(found["error"])
            failures.append(Failure(what=what, reason=why))
            _tell(f"  {what}: {why}", failed=True)
            return
        row = msgspec.convert(found | {"peer": name}, Row)
        rows.append(row)
        _tell(f"  {row.label}, {worlds_in_words(row.worlds)}: {row.steps_per_second:,.0f}/s")

    command = [str(python), "-m", f"runners.{name}"]
    command += ["--seconds", str(given.seconds), "--repeats", str(given.repeats)]
    deadline = 300.0 + 60.0 * given.seconds * given.repeats
    try:
        run(command, cwd=cwd, deadline=deadline, on_line=read)
        if not rows and not failures:
            failures.append(Failure(what=name, reason="its runner printed nothing"))
    except (Failed, msgspec.MsgspecError) as error:
        failures.append(Failure(what=name, reason=in_one_line(str(error))))
    return rows, failures


def compare(given: argparse.Namespace) -> Report:
    """Install and measure one peer after the other, never two at a time."""
    rows: list[Row] = []
    failures: list[Failure] = []
    names = given.only or list(PEERS)
    for number, name in enumerate(names, start=1):
        at = f"[{number}/{len(names)}] {name}"
        try:
            with ERR.status(f"{at}: installing"):
                python = (
                    Path(sys.executable)
                    if name == OURS
                    else provide(given.venvs / name, PEERS[name], cuda=given.cuda)
                )
        except Failed as error:
            failures.append(Failure(what=name, reason=str(error)))
            _tell(f"{at}: {error}", failed=True)
            continue
        _tell(at)
        with ERR.status(f"{at}: measuring"):
            found, failed = measure(name, python, given)
        rows += found
        failures += failed
    return Report(
        date=datetime.now(UTC).date().isoformat(),
        cpu=_cpu(),
        cores=len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 1,
        python=platform.python_version(),
        seconds=given.seconds,
        repeats=given.repeats,
        rows=rows,
        failures=failures,
    )


def _tell(line: str, *, failed: bool = False) -> None:
    ERR.print(line, style="red" if failed else None, markup=False, highlight=False, soft_wrap=True)


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _arguments(words: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="peers.py", description="Speed of our environment and of other packages."
    )
    parser.add_argument(
        "--only", nargs="+", metavar="NAME", choices=PEERS, help=f"Only these: {', '.join(PEERS)}."
    )
    parser.add_argument(
        "--repeats",
        type=int,
        default=3,
        help="Measurements per row; the median counts (%(default)s).",
    )
    parser.add_argument(
        "--seconds", type=float, default=3.0, help="Duration of a measurement [s] (%(default)s)."
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=HERE / "results",
        help="Folder for the results (results/ beside this file).",
    )
    parser.add_argument(
        "--venvs",
        type=Path,
        default=HERE.parents[1] / ".venv-peers",
        help="Folder for the environments (.venv-peers/ in the project).",
    )
    parser.add_argument(
        "--cuda", action="store_true", help="Accept torch's CUDA build if pip finds no other."
    )
    parser.add_argument(
        "--json", action="store_true", help="Print the results as one JSON object on stdout."
    )
    given = parser.parse_args(words)
    if given.repeats < 1 or not given.seconds > 0.0:
        parser.error("--repeats, --seconds: out of range; allowed: above 0")
    given.out, given.venvs = given.out.resolve(), given.venvs.resolve()
    return given


def main(words: list[str] | None = None) -> int:
    """Compare, write and show the results; return 1 if nothing was measured."""
    given = _arguments(words)
    # also end started processes
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        report = compare(given)
    except KeyboardInterrupt:
        ERR.print("stopped; no results written", style="red")
        return 130
    write(report, given.out)
    if given.json:
        sys.stdout.write(msgspec.json.format(msgspec.json.encode(report), indent=2).decode() + "\n")
    else:
        Console().print(Markdown(markdown(report)))
    return 0 if report.rows else 1


if __name__ == "__main__":
    sys.exit(main())
