"""The cost of a bridge to a run in lockstep: the same flight with and without it."""

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bus.errors import BusError
from bus.keys import Party, Role
from bus.session import open_session
from outrider.bench.timing import Pair
from outrider.running.child import environment_of

_SECONDS = 300.0
"""Length of each flight [s]: 6,000 ticks, some seconds."""


@contextmanager
def _started(*words: str) -> Iterator["subprocess.Popen[bytes]"]:
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "outrider", *words],
        env=environment_of(""),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait(20.0)


def _rate(*, bridge: bool, read: bool) -> float:
    """Ticks a second of `escort` over processes, perhaps with a bridge to ROS 2 and somebody who reads all of it.

    Raises:
        BusError: If the run fails.
    """
    with tempfile.TemporaryDirectory(prefix="outrider-beside-") as folder, ExitStack() as stack:
        endpoint = f"unixsock-stream/{Path(folder) / 'bus.sock'}"
        simulator = stack.enter_context(
            _started(
                "simulator",
                "escort",
                "--duration",
                str(_SECONDS),
                "--listen",
                endpoint,
                "--json",
            )
        )
        while not Path(endpoint.partition("/")[2]).exists() and simulator.poll() is None:
            time.sleep(0.05)
        if bridge:
            stack.enter_context(_started("ros2", "--connect", endpoint))
        if read:
            stack.enter_context(_reading(endpoint))
        if bridge:
            _await_bridge(endpoint)
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


def ros2_idle() -> Pair:
    """Lockstep with a bridge to ROS 2 that nobody listens to, beside the same without."""
    return _rate(bridge=True, read=False), _rate(bridge=False, read=False)


def ros2_read() -> Pair:
    """Lockstep with a bridge to ROS 2 whose every topic is read, beside the same without."""
    return _rate(bridge=True, read=True), _rate(bridge=False, read=False)
