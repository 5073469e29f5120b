"""Start, supervision and end of processes that measure or install.

Output lines are passed on as they arrive; a failure has its reason in one line.
"""

import contextlib
import os
import re
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST_REASON = 160
_REMARKS = ("warning", "[notice]", "note:", "hint:", "╰", "[end of output]")
_UNSET = ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP")
"""Variables that would let a peer's interpreter import foreign packages."""


class Failed(Exception):
    """Failure of an installation or a measurement, with the reason in one line."""


def run(
    command: list[str], *, cwd: Path, deadline: float, on_line: Callable[[str], None] | None = None
) -> None:
    """Run a command to its end.

    Args:
        command: Command with arguments.
        cwd: Working directory.
        deadline: Time after which the process is killed [s].
        on_line: Callback for each line of standard output.

    Raises:
        Failed: If the command fails, with the last line of its standard error.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as said:
        with _started(command, cwd, said.fileno()) as process:
            late = threading.Event()
            timer = threading.Timer(deadline, lambda: (late.set(), _end(process)))
            timer.daemon = True
            timer.start()
            try:
                for line in process.stdout or ():
                    if on_line is not None:
                        on_line(line.rstrip("\n"))
                code = process.wait()
            finally:
                timer.cancel()
        if late.is_set():
            raise Failed(f"not finished after {deadline:g} s")
        if code:
            said.seek(0)
            raise Failed(reason(said.read()) or f"ended with exit code {code}")


@contextmanager
def _started(command: list[str], cwd: Path, errors: int) -> Iterator[subprocess.Popen[str]]:
    """Yield a process in its own process group, which ends with the block."""
    environment = {name: value for name, value in os.environ.items() if name not in _UNSET}
    process = subprocess.Popen(
        command,
        cwd=cwd,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=errors,
        start_new_session=True,
        encoding="utf-8",
        errors="replace",
    )
    try:
        yield process
    finally:
        _end(process)
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def _end(process: subprocess.Popen[str]) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        # they hold nothing that would have to be put in order
        os.killpg(process.pid, signal.SIGKILL)


def reason(text: str) -> str:
    """Return the last informative line of an error, without addresses and local folders."""
    lines = [line.strip() for line in text.splitlines()]
    telling = [line for line in lines if line and not line.lower().startswith(_REMARKS)]
    return in_one_line(telling[-1]) if telling else ""


def in_one_line(text: str) -> str:
    """Return a message in one line, for a table."""
    text = re.sub(r"\b\w+://\S+", "(address)", " ".join(text.split()))
    text = re.sub(r"(?<![\w.])(?:/[^\s/:'\"]+)+/([^\s/:'\"]+)", r"\1", text)
    return text if len(text) <= LONGEST_REASON else text[: LONGEST_REASON - 1] + "…"
