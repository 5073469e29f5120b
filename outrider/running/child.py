"""Child process of `outrider run`."""

import contextlib
import os
import queue
import re
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO

import msgspec

from outrider.running.parent import Start

_TAIL = 200
"""Number of lines of standard error kept for each child."""
_REPORTED = 12
"""Number of those lines in an error message."""
_WARNING = re.compile(r"(?:outrider: )?(?:outrider(?:\.\w+)+|py\.warnings): ")
"""Prefix of a warning in a child's log."""
_ERROR = "outrider: "
"""Prefix of the error line of an `outrider` command."""
_TRACEBACK = "Traceback (most recent call last):"
_TOKEN = "OUTRIDER_TOKEN"  # noqa: S105 - a variable's name
_PRIVATE = ("OUTRIDER_SECRET", "OUTRIDER_CREDENTIALS", "OUTRIDER_PASSWORD", "OUTRIDER_HOST")
"""Variables that no child inherits: the run's secret, credentials for other runs, and the host of a public page."""


def outrider_command(*words: str) -> list[str]:
    """Return the command line that runs an `outrider` command in a new process."""
    return [sys.executable, "-P", "-m", "outrider", *words]


def child_environment(*, companion: bool = False) -> dict[str, str]:
    """Return the environment of this process without secrets.

    Args:
        companion: True for a companion, which keeps the page's token.
    """
    left_out = _PRIVATE if companion else (*_PRIVATE, _TOKEN)
    return {name: value for name, value in os.environ.items() if name not in left_out}


class Child:
    """Process of the run, with the last lines of its standard error.

    Its standard input stays open. The child exits when it closes, so also when this process is killed.

    Args:
        name: Name on the bus.
        arguments: Arguments of the `outrider` command line.
        start: First line of its standard input.
        lines: Receives its standard output line by line, then None.
        log: File for its standard error; None: no file.
        companion: True for a companion, which is not part of the run.
        on_warning: Called from another thread with each warning in its log.
    """

    def __init__(
        self,
        name: str,
        arguments: Sequence[str],
        start: Start,
        *,
        lines: "queue.SimpleQueue[bytes | None] | None" = None,
        log: Path | None = None,
        companion: bool = False,
        on_warning: Callable[[str], None] = lambda _line: None,
    ) -> None:
        self.name = name
        self._log = log
        self._on_warning = on_warning
        self._tail: deque[str] = deque(maxlen=_TAIL)
        first = msgspec.json.encode(start) + b"\n"  # may fail: before there is a process
        self._process = subprocess.Popen(
            outrider_command(*arguments, "--child"),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL if lines is None else subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=child_environment(companion=companion),
            start_new_session=True,  # Ctrl-C reaches only this process, which ends the children in order
        )
        self._send(first)
        self._readers: list[threading.Thread] = []
        self._read_with(self._listen, self._process.stderr)
        if lines is not None:
            self._read_with(self._pass_on, self._process.stdout, lines)

    def _send(self, line: bytes) -> None:
        if self._process.stdin is not None:
            with contextlib.suppress(
                BrokenPipeError
            ):  # the child has exited; its exit code gives the reason
                self._process.stdin.write(line)
                self._process.stdin.flush()

    def _read_with(self, work: Callable[..., None], *given: object) -> None:
        reader = threading.Thread(target=work, args=given, daemon=True)
        self._readers.append(reader)
        reader.start()

    def _listen(self, stream: IO[bytes]) -> None:
        for line in stream:
            text = line.decode(errors="replace").rstrip()
            warning = _WARNING.match(text)
            if warning is None:
                self._tail.append(text)
            else:
                self._on_warning(f"{self.name}: {text[warning.end() :]}")
            if self._log is not None:
                with contextlib.suppress(OSError):  # a full disk must not end the run
                    self._log.parent.mkdir(exist_ok=True)
                    with self._log.open("ab") as file:
                        file.write(line)

    @staticmethod
    def _pass_on(stream: IO[bytes], lines: "queue.SimpleQueue[bytes | None]") -> None:
        for line in stream:
            lines.put(line)
        lines.put(None)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def ended(self) -> int | None:
        """Exit code, negative for a signal; None while it runs."""
        return self._process.poll()

    def _last_lines(self) -> list[str]:
        for reader in self._readers:
            reader.join(1.0)
        return [line for line in self._tail if line]

    def stderr_tail(self) -> str:
        """Return the last lines of standard error, without warnings, as one line; after a traceback only its message.

        With OUTRIDER_DEBUG, return the whole traceback unchanged.
        """
        lines = self._last_lines()
        if _TRACEBACK not in lines:
            return " | ".join(lines[-_REPORTED:])
        if os.environ.get("OUTRIDER_DEBUG"):
            return "\n".join(["", *lines])
        last = len(lines) - lines[::-1].index(_TRACEBACK)
        where = f" (full traceback: {self._log})" if self._log is not None else ""
        return " | ".join(line for line in lines[last:] if not line.startswith(" ")) + where

    def error_line(self) -> str:
        """Return its error message if standard error holds nothing else; otherwise an empty text."""
        lines = self._last_lines()
        is_all = len(lines) == 1 and lines[0].startswith(_ERROR)
        return lines[0].removeprefix(_ERROR) if is_all else ""

    def drop_log(self) -> None:
        """Remove its log, whose content has been reported."""
        if self._log is not None:
            with contextlib.suppress(OSError):
                self._log.unlink()
                self._log.parent.rmdir()

    def exit_report(self) -> str:
        """Describe its exit in one line."""
        code = self.ended
        how = (
            f"was killed by signal {-code}"
            if code is not None and code < 0
            else f"ended with exit code {code}"
        )
        tail = self.stderr_tail()
        return f"{self.name} (pid {self.pid}) {how}" + (f": {tail}" if tail else "")

    def ask_to_end(self) -> None:
        """Ask it to exit, by closing its standard input."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def wait(self, patience: float) -> bool:
        """Wait up to `patience` [s] for its exit; return true if it has exited."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)
        return self.ended is not None

    def kill(self) -> None:
        """Send SIGKILL and wait for the exit."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """Close this process's ends of its pipes."""
        self.ask_to_end()
        for reader in self._readers:
            reader.join(5.0)
        if any(reader.is_alive() for reader in self._readers):
            return  # a hung process; a stream that a thread reads cannot be closed
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
