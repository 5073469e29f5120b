"""The cost of a bridge to a run in lockstep: the same flight with and without it."""

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial

from bus.errors import BusError
from bus.keys import Party, Role
from bus.locator import UNIX, Locator
from bus.session import open_session
from outrider.bench.timing import Pair
from outrider.running.child import child_environment, outrider_command
from outrider.running.run_folder import run_folder

_SECONDS = 300.0
"""Length of each flight [s]: 6,000 ticks, some seconds."""


@contextmanager
def _started(*words: str) -> Iterator["subprocess.Popen[bytes]"]:
    process = subprocess.Popen(
        outrider_command(*words),
        env=child_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait(20.0)


def _rate(bridge: Callable[[ExitStack, str], None] | None = None) -> float:
    """Ticks a second of `escort` over processes.

    Args:
        bridge: Starts a bridge beside the run at this endpoint, to be ended with the stack.

    Raises:
        BusError: If the run fails.
    """
    with run_folder() as folder, ExitStack() as stack:
        endpoint = f"{UNIX}/{folder / 'bus.sock'}"
        flight = ("simulator", "escort", "--duration", str(_SECONDS), "--json")
        simulator = stack.enter_context(_started(*flight, "--listen", endpoint))
        while not Locator.of(endpoint).listens() and simulator.poll() is None:
            time.sleep(0.05)
        if bridge is not None:
            bridge(stack, endpoint)
        for name in ("uav", "ugv"):
            stack.enter_context(_started(name, "--connect", endpoint))
        told, _ = simulator.communicate(timeout=300.0)
    if simulator.returncode:
        raise BusError(f"the run that was to be measured failed: exit code {simulator.returncode}")
    return float(json.loads(told)["ticks_per_second"])


@contextmanager
def _reading(endpoint: str) -> Iterator[None]:
    """A process that reads every topic of ROS 2."""
    code = (
        "import sys, zenoh\n"
        "config = zenoh.Config()\n"
        "config.insert_json5('mode', '\"client\"')\n"
        "config.insert_json5('connect/endpoints', '[\"' + sys.argv[1] + '\"]')\n"
        "with zenoh.open(config) as session:\n"
        "    kept = session.declare_subscriber('0/*/**/RIHS01_$*', zenoh.handlers.RingChannel(9))\n"
        "    sys.stdin.read()\n"
    )
    process = subprocess.Popen([sys.executable, "-P", "-c", code, endpoint], stdin=subprocess.PIPE)
    try:
        yield
    finally:
        process.communicate(timeout=20.0)


def _await_bridge(endpoint: str, patience: float = 60.0) -> None:
    """Wait until the bridge shows its topics: what comes before it costs the flight nothing."""
    shown = threading.Event()
    with open_session(Party(role=Role.ROS2, name="ros2"), "flight", connect=endpoint) as session:
        kept = session.below.liveliness().declare_subscriber(
            "@ros2_lv/*/*/*/*/MP/**", lambda _sample: shown.set(), history=True
        )
        there = shown.wait(patience)
        kept.undeclare()  # type: ignore[no-untyped-call]
    if not there:
        raise BusError("the bridge that was to be measured does not show its topics")


def _ros2(stack: ExitStack, endpoint: str, *, read: bool) -> None:
    """A bridge to ROS 2, perhaps with somebody who reads every topic."""
    stack.enter_context(_started("ros2", "--connect", endpoint))
    if read:
        stack.enter_context(_reading(endpoint))
    _await_bridge(endpoint)


def _mavlink(stack: ExitStack, endpoint: str, patience: float = 60.0) -> None:
    """A bridge to MAVLink, and a ground station that takes all that it is sent."""
    station = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    station.bind(("127.0.0.1", 0))
    station.settimeout(patience)
    told = threading.Event()

    def listen() -> None:
        with suppress(OSError):  # it is closed at the end
            while station.recv(2048):
                told.set()

    to = f"udpout:127.0.0.1:{station.getsockname()[1]}"
    stack.enter_context(_started("mavlink", "--connect", endpoint, "--to", to))
    threading.Thread(target=listen, daemon=True).start()
    if not told.wait(patience):
        raise BusError("the bridge that was to be measured tells a ground station nothing")


def ros2_idle() -> Pair:
    """Lockstep with a bridge to ROS 2 that nobody listens to, beside the same without."""
    return _rate(partial(_ros2, read=False)), _rate()


def ros2_read() -> Pair:
    """Lockstep with a bridge to ROS 2 whose every topic is read, beside the same without."""
    return _rate(partial(_ros2, read=True)), _rate()


def mavlink_read() -> Pair:
    """Lockstep with a bridge to MAVLink that tells a ground station, beside the same without."""
    return _rate(_mavlink), _rate()
