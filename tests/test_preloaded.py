"""A command that is forked from the preloaded process is as one that an interpreter was started for."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import preloaded
import pytest
from preloaded import Popen
from processes import (
    OUTRIDER,
    PIPES,
    alive,
    command_line,
    kind_of,
    opened,
    outrider,
    stat_of,
    wait_until,
)

WAITS = ("uav", "--connect", "unixsock-stream//nowhere/bus.sock", "--join-timeout", "100")


def forked(code: str, *arguments: str, **settings: object) -> str:
    with Popen([sys.executable, "-c", code, *arguments], **PIPES | settings) as process:
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return str(out).strip()


@pytest.mark.parametrize(
    "words", [["run", "escrot"], ["--help"], ["check", "--fast"], ["scenarios", "--json"]]
)
def test_it_says_the_same_and_ends_with_the_same_code(words: list[str], tmp_path: Path) -> None:
    there, here = (outrider(*words, fresh=fresh, cwd=tmp_path) for fresh in (True, False))
    assert (here.returncode, here.stdout, here.stderr) == (
        there.returncode,
        there.stdout,
        there.stderr,
    )


def test_it_is_our_child_with_its_command_line_and_no_file_but_its_own() -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs, opened([*OUTRIDER, *WAITS], stderr=subprocess.DEVNULL) as process:
        wait_until(lambda: kind_of(process.pid) == "uav")
        assert command_line(process.pid) == " ".join([*OUTRIDER, *WAITS])
        assert int(stat_of(process.pid)[1]) == os.getpid()
        links = [os.readlink(file) for file in Path(f"/proc/{process.pid}/fd").iterdir()]
        inodes = {f"socket:[{os.fstat(end.fileno()).st_ino}]" for end in (ours, theirs)}
        inodes.add(f"socket:[{os.fstat(preloaded._loaded(os.getpid())._channel.fileno()).st_ino}]")
        assert not inodes & set(links)
        process.kill()
        assert process.wait(30.0) == -signal.SIGKILL


def test_its_signals_are_as_an_interpreter_has_them() -> None:
    code = (
        "import signal; print([signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]"
        "== [signal.default_int_handler, signal.SIG_DFL], signal.pthread_sigmask(signal.SIG_BLOCK, ()))"
    )
    assert forked(code) == "True set()"


def test_folder_environment_arguments_and_files_are_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv("OUTRIDER_SECRET", "kept")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    code = (
        "import os, sys, tempfile; print(os.getcwd(), os.environ['OUTRIDER_SECRET'], tempfile.gettempdir(),"
        "sys.argv, sys.stdin.read(), os.getsid(0) == os.getpid(), os.read(int(sys.argv[1]), 9))"
    )
    reader, writer = os.pipe()
    os.write(writer, b"passed on")
    process = Popen(
        [sys.executable, "-c", code, str(reader)],
        stdin=subprocess.PIPE,
        cwd=tmp_path,
        pass_fds=[reader],
        start_new_session=True,
        **PIPES,
    )
    out, err = process.communicate("told", timeout=60)
    os.close(reader)
    os.close(writer)
    assert err == ""
    wanted = f"{tmp_path} kept {tmp_path} ['-c', '{reader}'] told True b'passed on'"
    assert out.strip() == wanted


def test_each_draws_numbers_of_its_own() -> None:
    code = "import random, numpy; print(random.random(), numpy.random.random())"
    drawn = [*forked(code).split(), *forked(code).split()]
    assert len(set(drawn)) == 4


def test_what_is_read_while_loading_gets_an_interpreter(monkeypatch: pytest.MonkeyPatch) -> None:
    code = "import sys; print('numba' in sys.modules)"
    assert forked(code) == "True"
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert forked(code) == "False"


def test_what_is_loaded_has_one_thread() -> None:
    assert forked("import threading; print(threading.active_count())") == "1"


def test_what_forks_goes_with_whoever_wanted_it() -> None:
    code = (
        "import preloaded, socket; ours, theirs = socket.socketpair();"
        "pid = preloaded._forked(lambda: preloaded._serve_pages(theirs)); theirs.close();"
        "preloaded._Forks(ours); print(pid, flush=True); input()"
    )
    pipes = PIPES | {"stdin": subprocess.PIPE}
    with opened([sys.executable, "-c", code], **pipes) as process:
        server = int(process.stdout.readline())
        assert alive(server)
        process.kill()
        process.wait()
        wait_until(lambda: not alive(server))
