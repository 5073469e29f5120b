"""Input of a child process of `outrider run`: the first line of standard input, and its end."""

import atexit
import os
import shutil
import signal
import tempfile
import threading
import time

import msgspec

from bus.credentials import Credential, CredentialSet
from bus.errors import ScenarioError
from bus.messages.scenario import Law
from sim.input.faults import one_line

_PATIENCE = 10.0
"""Longest time for closing sessions and files after the parent has exited [s]."""


class Output(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Output files of the simulator."""

    folder: str = ""
    """Folder for trajectory, picture and summary; empty: not written."""
    picture: bool = True
    """True: draw the picture."""
    record: str = ""
    """MCAP file that records every tick; empty: none."""

    def __post_init__(self) -> None:
        for option, path in (("--out", self.folder), ("--record", self.record)):
            if path != path.encode(errors="replace").decode():
                raise ScenarioError(
                    f"{option} {one_line(path)}: the name is not UTF-8; allowed: UTF-8"
                )


class Start(msgspec.Struct, kw_only=True, omit_defaults=True):
    """First line of a child's standard input. The pipe then stays open; the child exits when it closes."""

    credential: Credential | None = None
    """Credential of a client of the run's router."""
    credentials: CredentialSet | None = None
    """Credentials of all parties, for the router."""
    secret: str = ""
    """Secret of the run, for the simulator alone."""
    law: Law | None = None
    """Initial law of the UAVs, for a companion."""
    scenario: str = ""
    """Resolved scenario of the run as TOML, for a companion; empty: unknown. No vehicle may receive it."""
    folder: str = ""
    """Private folder of the run, which holds the simulator's temporary files and which it removes on exit."""
    output: Output = Output()
    """Files of the run, for the simulator alone."""
    join_timeout: float = 30.0
    """Longest wait of a vehicle for a simulator or router [s]."""
    code: dict[str, str] = {}
    """User code that this vehicle loads: fields of `[custom]` and their values."""


def read_start() -> Start:
    """Read the first line of standard input; from then on, this process exits when standard input closes.

    Raises:
        SystemExit: If the parent has exited already.
    """
    line = b""
    while not line.endswith(b"\n"):
        # Not sys.stdin: a thread that waits in it aborts the interpreter's exit.
        piece = os.read(0, 65536)
        if not piece:
            raise SystemExit(1)
        line += piece
    start = msgspec.json.decode(line, type=Start)
    if start.folder:
        # A signal can arrive before a temporary file is removed; this folder is removed in any case.
        tempfile.tempdir = start.folder
        atexit.register(shutil.rmtree, start.folder, ignore_errors=True)
    threading.Thread(target=_await_end, name="outrider-watchdog", daemon=True).start()
    return start


def _await_end() -> None:
    while os.read(0, 65536):
        pass
    os.kill(os.getpid(), signal.SIGTERM)  # its handler closes sessions and files
    time.sleep(_PATIENCE)
    # Needed if the handler raised in a destructor, for example, and its exception was lost.
    os.kill(os.getpid(), signal.SIGKILL)
