"""The forkserver of a run: what it has loaded, what it knows, and that a forked process is as one that was started."""

import os
import queue
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import pytest
from processes import (
    SHORT,
    alive,
    child_of,
    children_of,
    command_line,
    family,
    flying,
    kind_of,
    launched,
    python,
    stat_of,
    wait_until,
)

from bus.errors import BusError
from bus.locator import Locator
from outrider.running import forking, launch
from outrider.running.child import Child
from outrider.running.flying import fly
from outrider.running.forking import Forkserver, forkserver
from sim.kernels import compile as kernels

SECRET = bytes(range(100, 116)).hex()


@pytest.fixture(scope="module")
def forks() -> Iterator[Forkserver]:
    with forkserver() as server:
        assert server is not None
        yield server


def _waiting(forks: Forkserver) -> Child:
    """A vehicle that waits for a router, for ever: nobody listens there."""
    words = ["uav", "--connect", "unixsock-stream//nowhere/bus.sock", "--join-timeout", "100"]
    return Child("uav_0", words, forkserver=forks)


def test_what_is_loaded_before_a_fork_is_no_world_no_scenario_no_session_and_no_thread() -> None:
    code = (
        "import sys, threading; from outrider.cli.forkserver import preload; preload();"
        "print(threading.active_count(), sorted(n for n in sys.modules if n.startswith('sim.')))"
    )
    done = python(code)
    threads, _, loaded = done.stdout.partition(" ")
    assert threads == "1"
    names = set(eval(loaded))  # noqa: S307 - a list of names that we have printed
    assert "sim.models.field" in names
    rooms = {name.split(".")[1] for name in names}
    assert rooms <= {"kernels", "models", "input"}


def test_a_forked_process_is_our_child_in_its_own_session_with_its_own_command_line(forks):
    child = _waiting(forks)
    try:
        wait_until(lambda: " outrider uav " in command_line(child.pid))
        started = f"{sys.executable} -P -m outrider uav --connect unixsock-stream//nowhere/bus.sock"
        assert command_line(child.pid).startswith(started)
        assert command_line(child.pid).endswith("--join-timeout 100 --watchdog")
        _, parent, _, session, *_ = stat_of(child.pid)
        assert (int(parent), int(session)) == (os.getpid(), child.pid)
        assert child.ended is None
        assert not child.wait(0.0)
        child.kill()
        assert child.ended == -signal.SIGKILL
        assert "was killed by signal 9" in child.exit_report()
    finally:
        child.close()


@pytest.mark.parametrize("end", [Child.ask_to_end, Child.close])
def test_a_forked_process_ends_when_asked_and_when_nobody_holds_its_standard_input(
    end: Callable[[Child], None], forks: Forkserver, tmp_path: Path
) -> None:
    socket = tmp_path / "bus.sock"
    words = ["simulator", "escort", "--listen", f"unixsock-stream/{socket}"]
    child = Child("simulator", words, forkserver=forks)
    wait_until(socket.exists)
    end(child)
    assert child.wait(30.0)
    child.close()


@pytest.mark.parametrize("is_forked", [True, False])
def test_a_process_that_fails_has_exit_code_and_standard_error_of_its_own(is_forked, forks):
    lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    words = ["uav", "--run", "a/b"]
    child = Child("uav_0", words, lines, forkserver=forks if is_forked else None)
    try:
        assert child.wait(30.0)
        for told in ("uav_0 (pid", "ended with exit code 2", "run = 'a/b'"):
            assert told in child.exit_report()
        assert lines.get(timeout=10.0) is None
    finally:
        child.close()


def test_forked_processes_draw_numbers_of_their_own(tmp_path, monkeypatch):
    drawing = (
        "import random, numpy\nraise SystemExit(f'{random.random()} {numpy.random.random()}')\n"
    )
    (tmp_path / "drawing.py").write_text(drawing, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    drawn: list[str] = []
    with forkserver() as server:
        for _ in range(2):
            child = Child("ugv_0", ["ugv", "--policy", "drawing:policy"], forkserver=server)
            assert child.wait(30.0)
            drawn += child.stderr_tail().split()
            child.close()
    assert len(drawn) == len(set(drawn)) == 4


def test_a_forkserver_that_has_ended_is_one_line() -> None:
    with forkserver() as server:
        assert server is not None
        assert server.ready(60.0)
        server._process.kill()
        with pytest.raises(BusError, match=r"the process that forks the run's processes has ended"):
            _waiting(server)


def test_it_tells_that_it_compiles_first_where_nothing_is_compiled(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("OUTRIDER_CACHE", str(tmp_path))
    with forkserver() as server:
        assert server is not None
        wait_until(lambda: server.ready(0.1) or server.is_compiling, 60.0)
        assert server.is_compiling
    monkeypatch.setattr(kernels, "cache_folder", lambda: tmp_path)
    with suppress(KeyboardInterrupt), kernels.compiling("uav", "ugv"):
        raise KeyboardInterrupt
    assert not kernels.is_compiled("uav")  # it may have been half of it
    with kernels.compiling():
        pass
    assert not kernels.is_compiled("uav")
    with kernels.compiling("uav"):
        pass
    assert kernels.is_compiled("uav")
    assert not kernels.is_compiled("uav", "ugv")


@pytest.mark.usefixtures("forked_forkserver")
def test_while_it_compiles_the_simulator_is_a_process_of_its_own_which_compiles_too(monkeypatch):
    class Busy(forking.Forkserver):
        """Compiles until the simulator has done so, and listens."""

        forked: ClassVar[list[str]] = []

        def ready(self, patience: float) -> bool:
            is_ready = super().ready(patience) and any(listened)
            self.is_compiling = not is_ready
            return is_ready

        def fork(self, command: Any, *given: Any, **named: Any) -> Any:
            self.forked.append(command[4])
            return super().fork(command, *given, **named)

    listened: list[bool] = []
    listens = Locator.listens
    monkeypatch.setattr(Locator, "listens", lambda own: listens(own) and not listened.append(True))
    monkeypatch.setattr(forking, "Forkserver", Busy)
    outcome = launched()
    assert Busy.forked == ["uav", "ugv"]
    assert outcome.summary is not None
    assert outcome.summary.trajectory_sha256 == fly(SHORT, SHORT.seed)[1].trajectory_sha256


def test_what_is_compiled_at_once_waits_for_no_other_and_the_same_waits(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "cache_folder", lambda: tmp_path)
    entered = threading.Event()

    def enter(*shares: Any) -> None:
        with kernels.compiling(*shares):
            entered.set()

    for mine, other, waits in (
        (("world",), ("uav", "ugv"), False),
        (("world",), ("world",), True),
        (("uav", "ugv"), ("ugv",), True),
        ((), ("uav",), True),
    ):
        entered.clear()
        with kernels.compiling(*mine):
            thread = threading.Thread(target=enter, args=other)
            thread.start()
            assert entered.wait(0.2 if waits else 10.0) != waits
        thread.join(10.0)
        assert entered.is_set()


def test_where_orphans_find_no_parent_each_process_is_started_by_itself_and_shows_no_secret(
    monkeypatch,
):
    monkeypatch.setattr(forking, "_adopting", lambda: nullcontext(False))
    monkeypatch.setattr(forking, "Forkserver", None)  # nobody starts one
    monkeypatch.setenv("OUTRIDER_SECRET", SECRET)
    shown = {}

    def look() -> int:
        for pid in family(os.getpid()):
            with suppress(OSError):  # it may just have ended
                environment = Path(f"/proc/{pid}/environ").read_text(errors="replace")
                words = command_line(pid)
                if kind := kind_of(pid):
                    shown[kind] = shown.get(kind, False) or SECRET in environment + words
        return 0

    outcome = launched(msgspec.structs.replace(launch.NOBODY, stop=look), secret=SECRET)
    assert shown == {"simulator": False, "uav": False, "ugv": False}
    assert outcome.summary is not None
    told = fly(SHORT, SHORT.seed, secret=SECRET)[1]
    assert outcome.summary.trajectory_sha256 == told.trajectory_sha256


@pytest.mark.usefixtures("nothing_left_behind")
def test_it_stays_for_respawns_alone_knows_no_secret_and_goes_with_its_run(monkeypatch):
    monkeypatch.setenv("OUTRIDER_SECRET", SECRET)
    with flying(
        "escort", "--set", "duration=100000.0", "--no-files", "--respawn", fresh=True
    ) as run:
        everybody = children_of(run.pid)
        (server,) = [pid for pid in everybody if "outrider.cli.forkserver" in command_line(pid)]
        assert len(everybody) == 4
        for pid in (server, child_of(run, "uav"), child_of(run, "ugv")):
            assert SECRET.encode() not in Path(f"/proc/{pid}/environ").read_bytes()
            assert not _holds(pid, SECRET.encode())
        assert _holds(child_of(run, "simulator"), SECRET.encode())
        run.kill()
        run.wait()
        wait_until(lambda: not any(alive(pid) for pid in everybody))


def _holds(pid: int, what: bytes) -> bool:
    """Whether some writable memory of a process holds these bytes."""
    with Path(f"/proc/{pid}/mem").open("rb", 0) as memory:
        for line in Path(f"/proc/{pid}/maps").read_text(encoding="utf-8").splitlines():
            place, access, *_ = line.split()
            if not access.startswith("rw"):
                continue
            begin, end = (int(edge, 16) for edge in place.split("-"))
            try:
                memory.seek(begin)
                if what in memory.read(end - begin):
                    return True
            except (OSError, OverflowError):
                continue
    return False
