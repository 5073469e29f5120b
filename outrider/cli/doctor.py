"""`outrider doctor`: check of this machine's software and hardware."""

import platform
import resource
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, version
from shutil import which
from typing import Literal, NamedTuple

import typer
from rich.text import Text

from bus.plugins import extras, install_command, missing, packages
from outrider.cli.console import print_json, print_table
from outrider.cli.options import Json
from sim.compiling.threads import cores

State = Literal["ok", "missing", "wrong"]


class Finding(NamedTuple):
    """Row of the table."""

    what: str
    state: State
    """`missing`: some commands need it; `wrong`: no run can fly."""
    details: str


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "firefox", "microsoft-edge", "open")


def _python() -> Iterator[Finding]:
    version = platform.python_version()
    good = sys.version_info >= (3, 11)
    yield Finding("Python", "ok" if good else "wrong", f"{version}; Outrider needs 3.11 or newer")


def _packages() -> Iterator[Finding]:
    names = ("outrider", "eclipse-zenoh", "numpy", "numba", "filterpy", "pettingzoo")
    found, lacking = [], []
    for name in names:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            lacking.append(name)
    if lacking:
        yield Finding("packages", "wrong", f"not installed: {', '.join(lacking)}")
    else:
        yield Finding("packages", "ok", ", ".join(found))


def _cache() -> Iterator[Finding]:
    from sim.compiling.compile import compile_cache  # noqa: PLC0415 - numba, which may be missing

    folder, fault = compile_cache()
    if folder is None:
        details = f"{fault}: every process compiles again; set OUTRIDER_CACHE to a writable folder"
        yield Finding("compile cache", "missing", details)
        return
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    details = f"{folder}, {size / 1e6:.0f} MB"
    if fault or not size:
        details += f"; {fault or 'empty'}: the next run compiles"
    yield Finding("compile cache", "ok", details)


def _extras() -> Iterator[Finding]:
    for extra in extras():
        if missing(extra):
            yield Finding(f"[{extra}]", "missing", f"{install_command(extra)} in the clone")
        else:
            yield Finding(f"[{extra}]", "ok", ", ".join(packages(extra)))


def _ports() -> Iterator[Finding]:
    for port, what in ((17447, "router"), (8080, "page")):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError as error:
                details = f"{error.strerror}; choose another for the {what} with --listen or --port"
                yield Finding(f"port {port}", "missing", details)
            else:
                yield Finding(f"port {port}", "ok", f"free, for the {what}")


def _docker() -> Iterator[Finding]:
    def ask(*words: str) -> str | None:
        try:
            done = subprocess.run(
                ("docker", *words),  # noqa: S607 - the user's docker
                capture_output=True,
                text=True,
                timeout=10,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    engine = ask("info", "--format", "{{.ServerVersion}}")
    compose = ask("compose", "version", "--short")
    if engine and compose:
        yield Finding("Docker", "ok", f"engine {engine}, compose {compose}")
    else:
        lacking = "compose" if engine else "running engine"
        yield Finding("Docker", "missing", f"no {lacking}; only the containers need it")


def _browser() -> Iterator[Finding]:
    found = next((name for name in BROWSERS if which(name)), None)
    if found:
        yield Finding("browser", "ok", found)
    else:
        yield Finding(
            "browser", "missing", "none found here; open the page in a browser of another machine"
        )


def _machine() -> Iterator[Finding]:
    count = cores()
    details = f"{count} for this process" + ("; three processes share it" if count == 1 else "")
    yield Finding("cores", "ok", details)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    raised = "" if hard == resource.RLIM_INFINITY else f" to {hard}"
    most = "the most allowed" if soft == hard else f"can be raised{raised}"
    state: State = "ok" if soft >= 256 else "wrong"
    yield Finding("open files", state, f"limit {soft}, {most}")


CHECKS: tuple[Callable[[], Iterator[Finding]], ...] = (
    _python,
    _packages,
    _cache,
    _machine,
    _ports,
    _extras,
    _docker,
    _browser,
)


def command(
    json: Json = False,
) -> None:
    """List what this machine lacks, and how to install it.

    Exits with 1 if no run can fly on this machine. Software that only some commands need is listed as missing.

    Example: outrider doctor
    """
    findings = [finding for check in CHECKS for finding in check()]
    if json:
        print_json({"findings": [finding._asdict() for finding in findings]})
    else:
        colours = {"ok": "green", "missing": "yellow", "wrong": "red"}
        rows = [
            (what, Text(state, style=colours[state]), details) for what, state, details in findings
        ]
        print_table(("what", "", "found"), rows, whole=("what", ""))
    if any(finding.state == "wrong" for finding in findings):
        raise typer.Exit(1)
