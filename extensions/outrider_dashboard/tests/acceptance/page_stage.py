"""Processes and browser pages for the checks of `page.py`."""

import json
import math
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

OUTRIDER = [sys.executable, "-m", "outrider"]
RUN = "page"
OBSERVERS = "dashboard_observer"
_PAD = """window.pads = [null]; navigator.getGamepads = () => window.pads;"""


class Failed(Exception):
    """A failed check."""


def say(line: str) -> None:
    """Print a line of the report."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def free_port() -> int:
    """Return a port on which no process listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def wait_until(condition: Callable[[], Any], what: str, seconds: float = 20.0) -> Any:
    """Wait until the condition is true, and return its value."""
    limit = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > limit:
            raise Failed(f"in vain: {what} ({seconds:g} s)")
        time.sleep(0.05)
    return found


def answers(port: int) -> bool:
    """Return whether a process listens on the port."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


class Processes:
    """The processes of a run, started one by one."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        made = subprocess.run(
            [*OUTRIDER, "credentials", str(folder / "credentials"), "--run", RUN, "--json"],
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        )
        self.files: dict[str, str] = json.loads(made.stdout)["files"]
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, kind: str, *arguments: str, name: str = "") -> "subprocess.Popen[bytes]":
        """Start a process with its own credentials."""
        where = (
            ["--listen", self.endpoint]
            if kind == "router"
            else ["--run", RUN, "--connect", self.endpoint]
        )
        name = name or kind
        party = "operator" if name.startswith("dashboard") else name
        credential = self.files["observer" if name == OBSERVERS else party]
        return self._launch(name, kind, *arguments, "--credentials", credential, *where)

    def _launch(self, name: str, *words: str) -> "subprocess.Popen[bytes]":
        """Start an outrider command; it logs to a file of this name."""
        with (self._folder / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(
                [*OUTRIDER, *words],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                cwd=self._folder,
            )
        self._running[name] = process
        return process

    def start_all(self, port: int) -> None:
        """Record a run, then start all processes of another run and the dashboard on this port.

        The recording comes first: it compiles, so that the processes of the run do not wait for one another.
        """
        words = ("run", "escort", "--in-process", "--no-files", "--duration", "25")
        recording = self._launch("recording", *words, "--record", str(self._folder / "run.mcap"))
        if recording.wait(300.0):
            raise Failed("nothing was recorded")
        self.start("router")
        wait_until(lambda: answers(int(self.endpoint.rpartition(":")[2])), "the router listens")
        self.simulator(1.0)
        for name in ("uav_0", "ugv_0"):
            self.start(name[:3], "--join-timeout", "120", name=name)
        self.start("dashboard", "--port", str(port))
        wait_until(lambda: answers(port), "the dashboard listens", 60.0)

    def log(self, name: str) -> str:
        """Return the log of a process."""
        return (self._folder / f"{name}.log").read_text(errors="replace")

    def address(self, name: str) -> str:
        """Return the page's address that a process prints, with its token."""

        def printed() -> "re.Match[str] | None":
            return re.search(r"http://127\.0\.0\.1:\d+/\?token=[\w-]+", self.log(name))

        found: re.Match[str] = wait_until(printed, f"{name} says where its page is", 40.0)
        return found.group(0)

    def replay(self) -> None:
        """Replay a recording of 25 s slowly, with its page."""
        path, port = str(self._folder / "run.mcap"), free_port()
        words = ("--with", f"dashboard:port={port}", "--realtime", "0.5")
        self._launch("replay", "replay", path, *words)

    def run(self, scenario: str, *words: str, name: str = "pairs") -> "subprocess.Popen[bytes]":
        """Start a whole run with its page, from a scenario with HTML in its name; the log has this name."""
        file = self._folder / f"{name} <img src='data:,' onerror='window.ran = true'>.toml"
        file.write_text(scenario)
        page = ("--with", "dashboard:port=0", "--no-files")
        return self._launch(name, "run", str(file), *page, *words)

    def compile(self, scenario: str) -> None:
        """Fly a scenario for a second, so that the processes of a run in real time do not compile."""
        file = self._folder / "compiled.toml"
        file.write_text(scenario)
        words = ("--in-process", "--no-files", "--duration", "1")
        if self._launch("compiled", "run", str(file), *words).wait(300.0):
            raise Failed(f"not flown: {self.log('compiled')}")

    def simulator(self, factor: float) -> None:
        """Start a simulator in real time."""
        words = ("escort", "--duration", "20000", "--realtime", str(factor))
        self.start("simulator", *words, "--join-timeout", "120")

    def kill(self, name: str) -> None:
        """Kill a process, like a crash."""
        process = self._running.pop(name)
        process.send_signal(signal.SIGKILL)
        process.wait()

    def end(self) -> None:
        """End all running processes."""
        for process in self._running.values():
            process.terminate()
        for process in self._running.values():
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def logs(self) -> str:
        """Return the last lines of each log."""
        return "\n".join(
            f"--- {path.name}\n{path.read_text(errors='replace')[-1500:]}"
            for path in self._folder.glob("*.log")
        )


class Page:
    """A page in a browser, and its complaints.

    Args:
        context: The browser context.
        address: Address of the page.
        complaints: Receives the messages of the browser, and requests that leave this machine.
    """

    def __init__(self, context: Any, address: str, complaints: list[str]) -> None:
        context.add_init_script(_PAD)
        self.page = context.new_page()
        here = (address.partition("?")[0], "data:", "blob:")

        def on_message(message: Any) -> None:
            if message.type in ("error", "warning"):
                complaints.append(f"console: {message.text}")

        def on_request(request: Any) -> None:
            if not request.url.startswith(here):
                complaints.append(f"a request left this machine: {request.url}")

        self.page.on("console", on_message)
        self.page.on("pageerror", lambda error: complaints.append(f"script: {error}"))
        self.page.on("request", on_request)
        self.page.goto(address)
        self.ready()
        if "?" in self.page.url:
            raise Failed(f"the token stays in the bar: {self.page.url}")

    def ready(self) -> None:
        """Wait until the page shows a run."""
        shows = "window.outrider && outrider.store.status && outrider.store.truth && true"
        wait_until(lambda: self.run(shows), "the page shows a run")

    def run(self, script: str) -> Any:
        """Return the value of an expression in the page."""
        return self.page.evaluate(f"() => ({script})")

    @property
    def tick(self) -> int:
        """Return the tick of the displayed truth."""
        return int(self.run("outrider.store.truth.tick"))

    @property
    def status(self) -> dict[str, Any]:
        """Return the newest status of the page."""
        found: dict[str, Any] = self.run("outrider.store.status")
        return found

    def position(self, name: str = "ugv_0") -> list[float]:
        """Return the displayed position of a vehicle [m]."""
        found: list[float] = self.run(f"outrider.store.truth.vehicles.{name}.position")
        return found

    def velocity(self) -> list[float]:
        """Return the displayed velocity of the UGV [m/s]."""
        found: list[float] = self.run("outrider.store.truth.vehicles.ugv_0.velocity")
        return found

    def speed(self) -> float:
        """Return the displayed speed of the UGV [m/s]."""
        return math.hypot(*self.velocity())

    def control(self) -> str:
        """Return who has control: `mine`, `other` or `free`."""
        return str(self.run("document.getElementById('wheel-card').dataset.wheel"))

    def banner(self) -> str:
        """Return the fault that the page shows, or an empty string."""
        banner = "document.getElementById('banner')"
        return str(self.run(f"{banner}.hidden ? '' : {banner}.innerText"))

    def click(self, text: str) -> None:
        """Click a button."""
        self.page.get_by_role("button", name=text, exact=False).click()

    def choose(self, label: str, option: str) -> None:
        """Choose an option of a list."""
        self.page.get_by_role("combobox", name=label).click()
        self.page.get_by_role("option").filter(
            has=self.page.get_by_text(option, exact=True)
        ).click()
