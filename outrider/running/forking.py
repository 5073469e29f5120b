"""Processes that are forked from one that has loaded everything: they start at once, and load nothing twice.

The forkserver (`outrider.cli.forkserver`) is an interpreter of its own with an environment that has no secret. It is
handed open files and nothing else; what a process is to be stands in one of them, which only that process reads. So
nothing of a run is in the memory that its vehicles share.

A forked process is a child of ours, as one that was started: the forkserver forks it through a process that ends at
once, and Linux gives the orphan to the nearest ancestor that adopts (PR_SET_CHILD_SUBREAPER). Where there is no such
thing, processes are started one by one.
"""

import contextlib
import ctypes
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from typing import IO

import msgspec

from bus.errors import BusError

_PR_SET_CHILD_SUBREAPER, _PR_GET_CHILD_SUBREAPER = 36, 37
_LONGEST_COMMAND = 4096
"""Room for the command line that `ps` shows of a forked process: it is that of the forkserver, written over."""


READY, COMPILING = b"r", b"c"
"""A forkserver's words: all is loaded; the pilots are not in the cache, and it compiles for some ten seconds."""
_TOKEN = "OUTRIDER_TOKEN"  # noqa: S105 - the name of a variable: the page's token is no vehicle's
_SECRET = "OUTRIDER_SECRET"  # noqa: S105 - a variable's name
"""The place where a simulator's process that was forked finds the run's secret."""
_OUR_ACCESS = ("OUTRIDER_CREDENTIALS", "OUTRIDER_PASSWORD")
"""Variables by which the person who starts the run joins others; its processes have credentials of its own."""


def environment_of(secret: str, *, token: bool = False) -> dict[str, str]:
    """A child's environment: ours, without our run's secret unless it is for it.

    A forked process has it in its memory alone; of an interpreter that is started all processes of its user can read
    the environment, a vehicle's among them, as all users can read its command line. The page alone gets its token.
    """
    left_out = {_SECRET, *_OUR_ACCESS} | (set() if token else {_TOKEN})
    ours = {name: value for name, value in os.environ.items() if name not in left_out}
    return ours | ({_SECRET: secret} if secret else {})


class Request(msgspec.Struct, frozen=True, kw_only=True):
    """Command and environment of a process that is forked."""

    command: list[str]
    """Its command line, from the interpreter on."""
    environment: dict[str, str]


class Forked:
    """A forked process, with those methods of `subprocess.Popen` that a run needs.

    Args:
        pid: Process id, of a child of ours.
        stdin, stdout, stderr: Our ends of its pipes.
    """

    def __init__(
        self, pid: int, stdin: IO[bytes], stdout: IO[bytes] | None, stderr: IO[bytes]
    ) -> None:
        self.pid, self.stdin, self.stdout, self.stderr = pid, stdin, stdout, stderr
        self._code: int | None = None

    def poll(self) -> int | None:
        """Exit code, negative for a signal; None while it runs."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end.

        Raises:
            subprocess.TimeoutExpired: If it has not ended after `timeout` [s].
        """
        limit = None if timeout is None else time.monotonic() + timeout
        pause = 0.0005
        while (code := self.poll()) is None:
            if limit is not None and time.monotonic() > limit:
                raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
            time.sleep(pause)
            pause = min(2.0 * pause, 0.05)
        return code

    def _send(self, number: int) -> None:
        if self.poll() is None:  # it is ours to reap, so nobody else has its number yet
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """SIGTERM."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """SIGKILL."""
        self._send(signal.SIGKILL)


@contextlib.contextmanager
def _adopting() -> Iterator[bool]:
    """While this lasts, orphans among our descendants become our children; false where the system cannot do that."""
    if sys.platform != "linux":
        yield False
        return
    prctl, before = ctypes.CDLL(None, use_errno=True).prctl, ctypes.c_int()
    prctl(_PR_GET_CHILD_SUBREAPER, ctypes.byref(before), 0, 0, 0)
    try:
        yield prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) == 0
    finally:
        prctl(_PR_SET_CHILD_SUBREAPER, before.value, 0, 0, 0)


class Forkserver:
    """The forkserver as the process sees it that has started it."""

    def __init__(self) -> None:
        self._channel, theirs = socket.socketpair()
        self._is_ready = False
        self.is_compiling = False
        """True if it has told so, and has not told since that all is loaded."""
        with theirs:
            arguments = [str(theirs.fileno()), " " * _LONGEST_COMMAND]
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "outrider.cli.forkserver", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                pass_fds=[theirs.fileno()],
                env=environment_of(""),  # whatever a vehicle's process may know, and no more
                start_new_session=True,
            )

    def _receive(self, count: int) -> bytes:
        told = b""
        with contextlib.suppress(ConnectionError):
            told = self._channel.recv(count, socket.MSG_WAITALL)
        if len(told) < count:
            self._channel.close()
            _, words = self._process.communicate()
            last = words.decode(errors="replace").strip().splitlines()[-1:] or ["without a word"]
            raise BusError(f"the process that forks the run's processes has ended: {last[0]}")
        return told

    def ready(self, patience: float) -> bool:
        """Wait up to `patience` [s] until everything is loaded; true if it is.

        Raises:
            BusError: If the forkserver has ended.
        """
        if not self._is_ready and select.select([self._channel], [], [], patience)[0]:
            self._is_ready = self._receive(1) == READY
            self.is_compiling = not self._is_ready
        return self._is_ready

    def fork(self, command: Sequence[str], secret: str, *, piped: bool) -> Forked:
        """Fork a process that does what the command would do.

        Args:
            command: `python -P -m outrider ...`.
            secret: Of the run, where the process may know it.
            piped: Whether its standard output is read.

        Raises:
            BusError: If the forkserver has ended, or cannot fork.
        """
        while not self.ready(1.0):
            pass
        request = Request(command=list(command), environment=environment_of(secret))
        with contextlib.ExitStack() as ours, contextlib.ExitStack() as theirs:

            def pipe(mode: str) -> tuple[IO[bytes], int]:
                """Our end, for reading or writing, and theirs, which is closed here once it is handed over."""
                reader, writer = os.pipe()
                end, other = (writer, reader) if mode == "wb" else (reader, writer)
                theirs.callback(os.close, other)
                return ours.enter_context(os.fdopen(end, mode, 0 if mode == "wb" else -1)), other

            stdin, their_stdin = pipe("wb")
            stderr, their_stderr = pipe("rb")
            asked, their_asked = pipe("wb")
            stdout, their_stdout = pipe("rb") if piped else (None, os.open(os.devnull, os.O_WRONLY))
            if stdout is None:
                theirs.callback(os.close, their_stdout)
            files = [their_stdin, their_stdout, their_stderr, their_asked]
            with contextlib.suppress(BrokenPipeError):
                socket.send_fds(self._channel, [b"f"], files)
            theirs.close()
            pid = int.from_bytes(self._receive(8), "little")
            if not pid:
                raise BusError("the system has no room for another process")
            with contextlib.suppress(BrokenPipeError), asked:
                asked.write(msgspec.json.encode(request))
            ours.pop_all()
            return Forked(pid, stdin, stdout, stderr)

    def close(self) -> None:
        """End it, if that is not done; what it has forked stays."""
        if self._channel.fileno() >= 0:
            self._channel.close()
            self._process.kill()  # it has nothing to put in order, and may be compiling
            self._process.communicate()


@contextlib.contextmanager
def forkserver() -> Iterator[Forkserver | None]:
    """A forkserver, gone afterwards; None where the system has no use for one."""
    with _adopting() as adopts:
        if not adopts:
            yield None
            return
        server = Forkserver()
        try:
            yield server
        finally:
            server.close()
