"""Commands of ours as processes that are forked from one that has loaded everything, for the tests.

To start an interpreter and load our packages takes more processor time than most flights. Each worker of pytest has one
process, started when first wanted, that has loaded them, has no session and no thread, and forks itself for each
command. What is forked is a child of the test's process like one that was started: same command line, working folder,
environment, standard files, signals, exit code. It shares the memory of what is loaded, so a test that looks at
what a process has loaded, or knows, or reads when it starts, starts an interpreter.
"""

import atexit
import contextlib
import fcntl
import gc
import importlib.util
import inspect
import os
import pkgutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import types
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any, NoReturn

import msgspec
import numpy as np

from outrider.cli import forkserver
from outrider.cli.main import main as command_line
from outrider.running import child, forking
from outrider.running.warming import warm_up_flight

_COMMAND, _FORKSERVER = "outrider", "outrider.cli.forkserver"
_LOADED = ("bus", "agents", "sim", "outrider")
_SKIPPED = ("outrider.bench", "outrider.bridges", "outrider.learning", "outrider.envs")
_ROOM = 8192
"""For the command lines that are shown, in bytes."""
_MOST_FILES = 8
_FREE = frozenset(
    {
        *("PYTEST_CURRENT_TEST", "TMPDIR", "PYTHONSAFEPATH"),
        *("OUTRIDER_DEBUG", "OUTRIDER_PASSWORD", "OUTRIDER_SECRET"),
    }
)
"""Variables that nobody reads while loading; a command whose others differ from ours gets an interpreter."""
_LIBRARIES = ("KMP_", "PYGAME_", "SDL_")
"""Beginnings of those that libraries set in the process of the tests, and that no command of ours reads."""


def _read_while_loading(environment: Mapping[str, str]) -> dict[str, str]:
    return {
        name: value
        for name, value in environment.items()
        if name not in _FREE and not name.startswith(_LIBRARIES)
    }


_ENVIRONMENT = _read_while_loading(os.environ)


class Job(msgspec.Struct, frozen=True, kw_only=True):
    """All that a forked process is to be, but for its files."""

    command: list[str]
    code: str
    """Of `python -c`; empty: there is a module."""
    module: str
    arguments: list[str]
    folder: str
    environment: dict[str, str]
    files: list[int]
    """The numbers that its files have in it."""
    has_own_session: bool
    is_safe_path: bool
    """Whether `python -c` finds no modules in its folder."""


def _job(told: dict[str, Any]) -> tuple[Job, list[int]] | None:
    """The job for what `subprocess.Popen` was told, with our files for it; None: an interpreter must do it."""
    if isinstance(told["args"], str | bytes) or told["shell"] or told["preexec_fn"]:
        return None
    command = [os.fsdecode(word) for word in told["args"]]
    words = command[1:]
    if words[:1] == ["-P"]:
        words = words[1:]
    ours = words[:2] in (["-m", _COMMAND], ["-m", _FORKSERVER]) or words[:1] == ["-c"]
    if command[:1] != [sys.executable] or not ours:
        return None
    files = [told["p2cread"], told["c2pwrite"], told["errwrite"]]
    standard = [number if file < 0 else file for number, file in enumerate(files)]
    if any(os.isatty(file) for file in standard) or len(told["pass_fds"]) + 3 > _MOST_FILES:
        return None  # what is loaded has looked at its files once
    given = os.environ if told["env"] is None else told["env"]
    job = Job(
        command=command,
        code=words[1] if words[0] == "-c" else "",
        module=words[1] if words[0] == "-m" else "",
        arguments=words[2:],
        folder=os.path.abspath(told["cwd"] or os.curdir),
        environment={os.fsdecode(name): os.fsdecode(value) for name, value in given.items()},
        files=[0, 1, 2, *told["pass_fds"]],
        has_own_session=bool(told["start_new_session"]),
        is_safe_path=command[1:2] == ["-P"] or bool(given.get("PYTHONSAFEPATH")),
    )
    return job, [*standard, *told["pass_fds"]]


class _Popen(subprocess.Popen[Any], ABC):
    """`subprocess.Popen`, but what it starts may be forked."""

    def _execute_child(self, *given: Any) -> None:
        told = inspect.signature(subprocess.Popen._execute_child).bind(self, *given).arguments  # type: ignore[attr-defined]
        job = _job(told)
        pid = self._fork(*job) if job is not None else 0
        if not pid:
            super()._execute_child(*given)  # type: ignore[misc]
            return
        self.pid, self._child_created = pid, True
        ends = ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")
        self._close_pipe_fds(*(told[name] for name in ends))  # type: ignore[attr-defined]

    @abstractmethod
    def _fork(self, job: Job, files: Sequence[int]) -> int:
        """The process id of a forked child; 0: it cannot be forked."""


class _Forks:
    """A process that forks itself, as the one sees it whose children the forks become.

    Args:
        channel: To it; see `_serve`.
    """

    def __init__(self, channel: socket.socket) -> None:
        self._lock, self._channel = threading.Lock(), channel
        self._receive(1)

    def _receive(self, count: int) -> bytes:
        told = self._channel.recv(count, socket.MSG_WAITALL)
        if len(told) < count:
            raise RuntimeError(f"the preloaded process has ended: {self._lost()}")
        return told

    def _lost(self) -> str:
        return ""

    def fork(self, job: Job, files: Sequence[int]) -> int:
        """Fork a child of ours that does the job, with these of our files; its process id, or 0."""
        with self._lock, forking._adopting() as adopts:
            if not adopts:
                return 0
            reader, writer = os.pipe()
            with os.fdopen(reader, "rb"), os.fdopen(writer, "wb") as asked:
                socket.send_fds(self._channel, [b"f"], [reader, *files])
                asked.write(msgspec.json.encode(job))
            return int.from_bytes(self._receive(8), "little")


def subprocess_with(popen: type[_Popen]) -> types.SimpleNamespace:
    """The library's module, but for its `Popen`: for `outrider.running.forking`, which starts a forkserver."""
    return types.SimpleNamespace(**vars(subprocess) | {"Popen": popen})


# the side of the tests


class Popen(_Popen):
    """`subprocess.Popen`, but a command of ours is forked from what is loaded where its environment allows that."""

    def _fork(self, job: Job, files: Sequence[int]) -> int:
        if _read_while_loading(job.environment) != _ENVIRONMENT or not os.path.isdir(job.folder):
            return 0
        return _loaded(os.getpid()).fork(job, files)


class _Loaded(_Forks):
    """The process that has loaded everything, as the tests' process sees it."""

    def __init__(self) -> None:
        channel, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", __file__, str(theirs.fileno()), " " * _ROOM],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                pass_fds=[theirs.fileno()],
                env=_ENVIRONMENT,
            )
        super().__init__(channel)
        atexit.register(self.close)

    def _lost(self) -> str:
        return str(self._process.communicate()[1].decode())

    def close(self) -> None:
        self._channel.close()
        self._process.communicate()


@cache
def _loaded(_pid: int) -> _Loaded:
    """The one of this process, which is started when first wanted."""
    return _Loaded()


# the other side


class _InPlace(_Popen):
    """Processes that a forked command starts itself are forked too.

    Its forkserver is a fork of its own. A page is started when the command has threads, so it is forked by another fork
    that has none.
    """

    pages: _Forks | None = None

    def _fork(self, job: Job, files: Sequence[int]) -> int:
        if job.module == _COMMAND:
            return self.pages.fork(job, files) if self.pages is not None else 0
        if job.module != _FORKSERVER:
            return 0
        pid = _forked(lambda: _do(job, files))
        if "--dashboard" in sys.argv:
            ours, theirs = socket.socketpair()
            with theirs:
                _forked(lambda: _serve_pages(theirs))
            type(self).pages = _Forks(ours)
        return pid


def _forked(call: Callable[[], None]) -> int:
    """The process id of a fork that does no more than this."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    pid = os.fork()
    if pid == 0:
        _end_with(call)
    return pid


def _serve_pages(channel: socket.socket) -> None:
    # so that it ends with the command, and keeps nothing open
    _close_all_but({0, 1, 2, channel.fileno()})
    forkserver._show(["pages"])
    _serve(channel)()


def _end_with(call: Callable[[], None]) -> NoReturn:
    """End as an interpreter would after this call, but leave what is loaded as it is: to take it down takes 0.2 s.

    What stands below on the stack may be somebody else's.
    """
    code = 1
    try:
        call()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
        if isinstance(ended.code, str):
            sys.stderr.write(f"{ended.code}\n")
    except BaseException:  # noqa: BLE001 - as an interpreter does
        sys.excepthook(*sys.exc_info())
    finally:
        with contextlib.suppress(BaseException):
            threading._shutdown()  # type: ignore[attr-defined]
            atexit._run_exitfuncs()
        try:
            sys.stdout.flush()
        except OSError as error:
            sys.stderr.write(f"Exception ignored in: {sys.stdout}\n{error!r}\n")
            code = 120
        with contextlib.suppress(OSError):
            sys.stderr.flush()
        os._exit(code)


def _preload() -> None:
    """Load all that commands load, and what they compile."""
    for name in _LOADED:
        import_module(name)
        for found in pkgutil.walk_packages(sys.modules[name].__path__, f"{name}."):
            is_skipped = found.name.startswith(_SKIPPED) or found.name.endswith("__main__")
            if not is_skipped:
                with contextlib.suppress(ImportError):  # of an extra
                    import_module(found.name)
    warm_up_flight()


def _open_files() -> set[int]:
    listed = os.listdir("/proc/self/fd")
    # the one by which they were listed is not open any more
    return {int(name) for name in listed if os.path.lexists(f"/proc/self/fd/{name}")}


_kept: set[int] = set()
"""Files that are open because of what is loaded."""


def _close_all_but(files: set[int]) -> None:
    """Close what whoever has forked this had opened."""
    gc.freeze()  # what is nobody's any more must not close a file that has got its number here
    for file in _open_files() - _kept - files:
        os.close(file)


def _do(job: Job, files: Sequence[int]) -> None:
    """Be the process that is wanted, and do what it does."""
    if job.has_own_session:
        os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    above = max(*job.files, *files) + 1
    copies = [fcntl.fcntl(file, fcntl.F_DUPFD, above) for file in files]
    _close_all_but(set(copies))
    for copy, number in zip(copies, job.files, strict=True):
        os.dup2(copy, number)
        os.close(copy)
    os.chdir(job.folder)
    os.environ.clear()
    os.environ.update(job.environment)
    tempfile.tempdir = None
    np.random.seed()  # noqa: NPY002 - its state is that of all that are forked
    forkserver._show(job.command)
    sys.argv[1:] = job.arguments
    if job.module == _COMMAND:
        command_line()
    elif job.module == _FORKSERVER:
        forkserver.main()
    else:
        main = types.ModuleType("__main__")
        sys.modules["__main__"], sys.argv[0] = main, "-c"
        if not job.is_safe_path:
            sys.path.insert(0, "")
        exec(compile(job.code, "<string>", "exec"), vars(main))  # noqa: S102 - as `python -c` does


def _serve(channel: socket.socket) -> Callable[[], None]:
    """Fork for each job that comes, until whoever sends them has gone; returns in each forked process."""
    channel.send(b"r")
    while True:
        _, files, _, _ = socket.recv_fds(channel, 1, 1 + _MOST_FILES)
        if not files:
            os._exit(0)
        pid = forkserver._fork_orphan()
        if pid == 0:
            channel.close()
            with os.fdopen(files[0], "rb") as stream:
                job = msgspec.json.decode(stream.read(), type=Job)
            return lambda: _do(job, files[1:])
        for file in files:
            os.close(file)
        channel.send(max(pid, 0).to_bytes(8, "little"))


def _main() -> None:
    """Load, and serve; what is forked is the `__main__` that `python -m outrider` has."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's is for the tests
    channel = socket.socket(fileno=int(sys.argv[1]))
    _preload()
    gc.collect()
    gc.freeze()
    _kept.update(_open_files() - {channel.fileno()})
    spec = importlib.util.find_spec("outrider.__main__")
    assert spec is not None
    assert spec.origin is not None
    main = types.ModuleType("__main__")
    main.__spec__, main.__package__, main.__file__ = spec, _COMMAND, spec.origin
    sys.modules["preloaded"], sys.modules["__main__"] = sys.modules["__main__"], main
    sys.argv[0] = spec.origin
    for library in (forking, child):
        vars(library)["subprocess"] = subprocess_with(_InPlace)
    forkserver.preload()
    loaded: Any = forkserver
    loaded.preload = lambda: None
    _end_with(_serve(channel))


if __name__ == "__main__":
    _main()
