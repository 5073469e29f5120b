"""Companions: commands of extensions that run beside a run or a recording, `--with NAME`."""

import queue
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from bus import plugins
from bus.errors import ScenarioError
from outrider.running.child import Child

_LAST_FRAME = 2.0
"""Longest wait for all companions to show the end of the run [s, wall time]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Companion:
    """Object of an entry point `outrider.companions`; the command of the same name is started.

    `outrider run --with NAME:port=9000` starts `outrider NAME --connect ENDPOINT --run RUN --port 9000 --child`. The
    command reads a `outrider.running.parent.Start` from standard input, with the operator's credential and the UAVs'
    law, and exits when that input closes. It writes one line to standard output when it is ready, which the user
    sees, and one when it has shown the end of the run. The run waits some seconds for it. If it fails in this time,
    the run does not start. If it fails later, the run continues.
    """

    realtime: float | None = None
    """Default pace of a run with it [simulated seconds per second]; None: as fast as possible."""
    replays: bool = False
    """True: `outrider replay FILE --with NAME` calls the command with `--replay FILE`."""


class Beside(NamedTuple):
    """Companion requested by the user."""

    name: str
    words: tuple[str, ...]
    """Options of its command."""
    companion: Companion


def parse_companion(text: str) -> Beside:
    """Parse `NAME` or `NAME:OPTION=VALUE,OPTION`, and check that its extra is installed.

    Raises:
        ScenarioError: If the companion is unknown, or one of its libraries is missing.
    """
    name, _, options = text.partition(":")
    known = plugins.registered("companions")
    if name not in known:
        allowed = ", ".join(sorted(known)) or "none, as none is installed"
        raise ScenarioError(f"--with {text}: unknown companion; allowed: {allowed}")
    companion = plugins.load(known[name])
    if not isinstance(companion, Companion):
        raise ScenarioError(f"--with {text}: {known[name].value} is not a Companion")
    extra = plugins.extra_of(known[name])
    if extra:
        plugins.require(extra, f"--with {name}")
    words: list[str] = []
    for option in filter(None, options.split(",")):
        field, separator, value = option.partition("=")
        words += [f"--{field}", *([value] if separator else [])]
    return Beside(name, tuple(words), companion)


class Companions:
    """Companion processes of one run.

    Args:
        on_event: Called with a line for the user.
        patience: Longest wait for all to be ready; then the run starts [s, wall time].
    """

    def __init__(self, on_event: Callable[[str], None], patience: float = 10.0) -> None:
        self._on_event, self._patience = on_event, patience
        self._lines: dict[Child, queue.SimpleQueue[bytes | None]] = {}
        self._starting: set[Child] = set()
        """Processes that are not ready yet."""

    def add(self, start: Callable[["queue.SimpleQueue[bytes | None]"], Child]) -> None:
        """Add a process, started with a queue for its standard output."""
        lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        child = start(lines)
        self._lines[child] = lines
        self._starting.add(child)

    def _in_order(self) -> list[Child]:
        """Return the processes that are not ready yet, in order of their start."""
        return [child for child in self._lines if child in self._starting]

    def _becomes_ready(self, child: Child, seconds: float) -> bool:
        """Wait for a process to be ready, and tell the user; return False if it exits instead."""
        with suppress(queue.Empty):
            line = self._lines[child].get(timeout=seconds)
            if line is None:
                return False
            self._starting.discard(child)
            self._on_event(line.decode().strip())
        return True

    def failed_before_ready(self, is_over: Callable[[], bool]) -> Child | None:
        """Wait until all are ready, or for a while; return the first that exits instead."""
        limit = time.monotonic() + self._patience
        for child in self._lines:
            while child in self._starting and not is_over() and time.monotonic() < limit:
                if not self._becomes_ready(child, 0.1):
                    child.wait(self._patience)
                    return child
        if not is_over():
            for child in self._in_order():
                self._on_event(f"{child.name} is still starting; the run does not wait for it")
        return None

    def await_end_shown(self) -> None:
        """Wait briefly until they have shown the end of the run."""
        limit = time.monotonic() + _LAST_FRAME
        for child, lines in self._lines.items():
            if child in self._starting:
                self._becomes_ready(child, max(0.0, limit - time.monotonic()))
            if child.ended is None and child not in self._starting:
                with suppress(queue.Empty):
                    lines.get(timeout=max(0.0, limit - time.monotonic()))

    def report(self) -> None:
        """Report each companion that is ready late, and each that has exited before the run's end, once."""
        for child in self._in_order():
            self._becomes_ready(child, 0.0)
        for child in [child for child in self._lines if child.ended is not None]:
            del self._lines[child]
            self._starting.discard(child)
            self._on_event(f"{child.exit_report()}; the run continues without it")


def pace_with(companions: Sequence[Beside]) -> float | None:
    """Return the pace of a run with these companions; None: as fast as possible."""
    paces = [one.companion.realtime for one in companions if one.companion.realtime is not None]
    return paces[0] if paces else None
