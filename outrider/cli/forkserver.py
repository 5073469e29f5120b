"""The forkserver of `outrider run`: what it loads, and what becomes of a process that it forks.

It loads what a vehicle's process may load, so no world and no scenario: the simulator's process loads these for itself.
It opens no session and has no thread of its own. See `outrider.running.forking`, which starts it.
"""

import ctypes
import gc
import os
import socket
import sys
from importlib import import_module
from pathlib import Path

import msgspec
import numpy as np

from agents.process import warm_up
from bus.keys import Role
from outrider.cli.main import main as command_line
from outrider.cli.stopping import leave
from outrider.running.forking import COMPILING, READY, Request
from sim.kernels.compile import compiling, is_compiled

PRELOADED = (
    "bus.session",
    "outrider.cli.pilots",
    "outrider.running.user_code",
    "outrider.running.watchdog",
    "rich.markup",
    "rich.progress",
    "rich.table",
)
"""Modules that vehicles and simulator load besides the pilots' code."""


def preload() -> None:
    """Load and compile what a vehicle's process needs, so that a fork has it."""
    for name in PRELOADED:
        import_module(name)
    with compiling("uav", "ugv"):
        for role in (Role.UAV, Role.UGV):
            warm_up(role)
    gc.freeze()  # the collector need not look at what is here, and so does not copy it in each fork


def _fork_orphan() -> int:
    """Fork a process whose parent is not this one but the nearest ancestor that adopts.

    Returns:
        Its process id here, 0 in it; -1 here if there is no room for it.
    """
    reader, writer = os.pipe()
    try:
        middle = os.fork()
    except OSError:
        os.close(reader)
        os.close(writer)
        return -1
    if middle == 0:
        pid = -1
        try:
            pid = os.fork()
            if pid > 0:
                os.write(writer, pid.to_bytes(8, "little"))
        finally:
            if pid != 0:
                os._exit(0)
        os.close(reader)
        os.close(writer)
        return 0
    os.close(writer)
    told = os.read(reader, 8)
    os.close(reader)
    os.waitpid(middle, 0)  # the child is an orphan, and adopted, before this returns
    return int.from_bytes(told, "little") if told else -1


def _serve(channel: socket.socket) -> list[int]:
    """Fork whenever files come, until whoever sends them has gone; returns in each forked process, with its files."""
    channel.send(READY)
    while True:
        try:
            _, files, _, _ = socket.recv_fds(channel, 1, 4)
        except OSError:
            leave(1)
        if not files:
            leave(0)
        pid = _fork_orphan()
        if pid == 0:
            channel.close()
            return files
        for file in files:
            os.close(file)
        channel.send(max(pid, 0).to_bytes(8, "little"))


def _show(command: list[str]) -> None:
    """Let `ps` show this command: write it over the command line with which the forkserver was started."""
    fields = Path("/proc/self/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    start, end = int(fields[45]), int(fields[46])  # arg_start and arg_end of proc(5)
    if 0 < start < end:
        text = b"".join(os.fsencode(word) + b"\0" for word in command)[: end - start - 1]
        ctypes.memset(start, 0, end - start)
        ctypes.memmove(start, text, len(text))


def _become(files: list[int]) -> None:
    """Take up the files, and be what is asked for in the last of them."""
    os.setsid()
    for number, file in enumerate(files[:3]):
        os.dup2(file, number)
    for file in files[:3]:
        os.close(file)
    with os.fdopen(files[3], "rb") as stream:
        told = stream.read()
    if not told:
        sys.exit(1)  # whoever wanted this process has gone
    request = msgspec.json.decode(told, type=Request)
    os.environ.clear()
    os.environ.update(request.environment)
    sys.argv[:] = ["outrider", *request.command[4:]]  # without `python -P -m outrider`
    np.random.seed()  # noqa: NPY002 - its state is the forkserver's; a policy of the user's own may use it
    _show(request.command)


def main() -> None:
    """Serve; in a forked process, be the command line."""
    channel = socket.socket(fileno=int(sys.argv[1]))
    if not is_compiled(Role.UAV.value, Role.UGV.value):
        channel.send(COMPILING)
    preload()
    _become(_serve(channel))
    command_line()


if __name__ == "__main__":
    main()
