"""A child's view of `outrider run`: the first line of its standard input, and the end of that input."""

import atexit
import os
import shutil
import signal
import threading
import time

import msgspec

from bus.credentials import Credential, CredentialSet
from bus.messages.scenario import Law

_PATIENCE = 10.0
"""Time for closing sessions and files after the parent has gone [s]."""


class Output(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Files that the simulator writes."""

    folder: str = ""
    """Folder for trajectory, picture and summary; empty: none of them."""
    picture: bool = True
    """True: draw the picture."""
    record: str = ""
    """MCAP file in which every tick is recorded; empty: none."""


class Start(msgspec.Struct, kw_only=True, omit_defaults=True):
    """First line of a child's standard input. The pipe stays open: its end asks the child to end."""

    credential: Credential | None = None
    """Credential of a client of the run's router."""
    credentials: CredentialSet | None = None
    """Credentials of all parties, for the router."""
    secret: str = ""
    """Secret of the run, for the simulator alone."""
    law: Law | None = None
    """Law that the UAVs fly at first, for a companion."""
    folder: str = ""
    """Private folder of the run, which the simulator removes when it ends."""
    output: Output = Output()
    """Files of the run, for the simulator alone."""
    join_timeout: float = 30.0
    """Time for which a vehicle waits for a simulator or router [s]."""
    code: dict[str, str] = {}
    """The user's own code that this vehicle loads: fields of `[custom]` and their values."""


def read_start() -> Start:
    """Read the first line of standard input. From then on, the end of standard input ends this process.

    Raises:
        SystemExit: If the parent has gone already.
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
        atexit.register(shutil.rmtree, start.folder, ignore_errors=True)
    threading.Thread(target=_await_end, name="outrider-watchdog", daemon=True).start()
    return start


def _await_end() -> None:
    while os.read(0, 65536):
        pass
    os.kill(os.getpid(), signal.SIGTERM)  # its handler closes sessions and files
    time.sleep(_PATIENCE)
    # The handler raised in a destructor, for example, and its exception was lost.
    os.kill(os.getpid(), signal.SIGKILL)
