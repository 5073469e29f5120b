"""Processes of a run, started one by one around a router, for the tests."""

import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cached_property
from pathlib import Path

from bus.credentials import new_credentials, read_credential, write_credentials
from bus.joining import open_session
from bus.keys import CONTROL
from bus.session import Session
from processes import fly_to, free_port, started, wait_until

SECONDS = 60.0
"""Simulated time of a run that is disturbed: 1,200 ticks."""


SECRET = bytes(range(16)).hex()
"""Secret of the runs whose processes are started one by one; otherwise, the simulator would create one."""


def answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


class Scattered:
    """The processes of a run, started one by one, around a router of its own."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._stack = stack
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        made = new_credentials("mine", ["uav_0"], ["ugv_0"])
        paths = write_credentials(made, folder / "credentials")
        self._files = {name: str(path) for name, path in paths.items()}

    def start(self, kind: str, *arguments: str, name: str = "") -> "subprocess.Popen[str]":
        common = ["--credentials", self._files[name or kind]]
        if kind != "router":
            common += ["--run", "mine", "--connect", self.endpoint]
        return self._stack.enter_context(started(kind, *arguments, *common))

    def router(self, *arguments: str) -> "subprocess.Popen[str]":
        router = self.start("router", "--listen", self.endpoint, *arguments)
        port = int(self.endpoint.rpartition(":")[2])
        wait_until(lambda: answers(port))
        return router

    def simulator(self, *arguments: str) -> "subprocess.Popen[str]":
        options = ("escort", "--duration", str(SECONDS), "--secret", SECRET, "--json")
        return self.start("simulator", *options, *arguments)

    def vehicles(self, *arguments: str) -> "list[subprocess.Popen[str]]":
        return [self.start(name[:3], *arguments, name=name) for name in ("uav_0", "ugv_0")]

    def client(self, name: str) -> Session:
        """Open a session of this party until the end of the run."""
        credential = read_credential(Path(self._files[name]))
        return self._stack.enter_context(
            open_session(credential.party, "mine", connect=self.endpoint, credential=credential)
        )

    @cached_property
    def operator(self) -> Session:
        return self.client("operator")

    def await_simulator(self) -> None:
        """Wait for the simulator, for vehicles that do not wait themselves."""
        controls = self.operator.outbox(CONTROL)
        wait_until(lambda: controls.wanted)

    def fly_to(self, tick: int) -> None:
        """Fly the run to this tick, and let it continue."""
        fly_to(self.operator, tick)


@contextmanager
def scattered(folder: Path) -> Iterator[Scattered]:
    with ExitStack() as stack:
        yield Scattered(folder, stack)
