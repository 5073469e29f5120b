"""Recording of a run in progress by an observer."""

import time
from typing import Protocol

from bus import keys
from bus.messages.base import Message
from bus.messages.control import Change
from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.session import Session
from outrider.recording import schemas
from outrider.recording.schemas import Head, Topic, head_of
from sim.scenario.types import Scenario

_INBOX_ROOM = 4096
"""Largest number of pending truths before the oldest are lost: two seconds of a fast run."""
_LAST_MESSAGES = 0.6
"""Wait for further messages after the end of the run is reported [s]; a run that is reset continues."""
_BATCH = 256
"""Largest number of truths recorded before the caller can update its display."""


def _new_in(changes: tuple[Change, ...], known: tuple[Change, ...]) -> tuple[Change, ...]:
    """Return the new entries of a list of changes, of which only the end is sent."""
    old = next(n for n in range(len(changes), -1, -1) if known[len(known) - n :] == changes[:n])
    return changes[old:]


class RunSink(Protocol):
    """Destination of an observer's messages: a recording or a bag."""

    @property
    def next_start(self) -> float:
        """Start of another flight on the file's clock [s]."""

    def begin(self, head: Head, scenario: Scenario | None) -> None:
        """Start a flight."""

    def take(self, topic: Topic, message: Message, seconds: float) -> None:
        """Write a message of the current flight.

        Args:
            topic: Channel of the message.
            message: Message of the simulator.
            seconds: Simulated time [s].
        """

    def flush_if_due(self) -> None:
        """Write buffered messages, from time to time."""

    def close(self) -> None:
        """Complete and close the file."""


class RunRecorder:
    """Recorder of a run in progress: an observer that writes the simulator's messages to a file.

    Args:
        session: Session of an observer.
        file: Destination; closed together with the recorder.
        scenario: Scenario of the run, if known.
    """

    def __init__(self, session: Session, file: RunSink, scenario: Scenario | None) -> None:
        self._file = file
        self._scenario = scenario
        self._truths = session.inbox(keys.TRUTH, newest=_INBOX_ROOM)
        self._maps = {
            schemas.COVERAGE: session.inbox(keys.COVERAGE, newest=64),
            schemas.GROUND: session.inbox(keys.GROUND, newest=16),
        }
        self._statuses = session.inbox(keys.STATUS, newest=64)
        self._status: Status | None = None
        self._changes: tuple[Change, ...] = ()  # of the last status
        self._waiting: dict[Topic, CoverageMap | GroundMap] = {}  # for the truths of their ticks
        self._over_since: float | None = None
        self._busy = False
        self._episode = -1
        self.ticks = 0
        """Number of recorded ticks."""
        self.missing_ticks = 0
        """Number of ticks between the first and the newest that did not arrive."""
        self.first_tick = 0
        """First recorded tick of the first flight."""
        self.newest_tick = -1
        self.newest_time = 0.0
        """Simulated time of the newest tick [s]."""

    @property
    def ticks_of_run(self) -> int | None:
        """Number of ticks of the complete run; None: not known yet."""
        return self._status.ticks if self._status is not None else None

    @property
    def over(self) -> bool:
        """True if the run is over."""
        return (
            not self._busy
            and self._over_since is not None
            and time.monotonic() - self._over_since > _LAST_MESSAGES
        )

    def record(self, patience: float) -> None:
        """Record the messages that have arrived; wait up to `patience` [s] for the first."""
        received = self._truths.receive(patience)
        self._record_others()
        self._busy = received is not None
        recorded = 0
        while received is not None:
            if isinstance(received.message, Truth):
                self._record_truth(received.message)
                recorded += 1
            received = self._truths.next_waiting() if recorded < _BATCH else None
        self._file.flush_if_due()

    def _record_others(self) -> None:
        while (received := self._statuses.next_waiting()) is not None:
            if isinstance(received.message, Status):
                self._status = received.message
                if self._episode >= 0:
                    self._file.take(schemas.STATUS, received.message, received.message.time)
                    self._record_changes(received.message.changes)
                over = received.message.over
                self._over_since = (self._over_since or time.monotonic()) if over else None
        for topic, inbox in self._maps.items():
            while (received := inbox.next_waiting()) is not None:
                if isinstance(received.message, CoverageMap | GroundMap):
                    self._waiting[topic] = received.message
        self._record_maps()

    def _record_changes(self, changes: tuple[Change, ...]) -> None:
        for change in _new_in(changes, self._changes):
            self._file.take(schemas.CHANGES, change, self.newest_time)
        self._changes = changes

    def _record_maps(self) -> None:
        for topic, ground in list(self._waiting.items()):
            if self.newest_tick >= ground.tick > 0:
                self._file.take(topic, ground, self.newest_time * ground.tick / self.newest_tick)
                del self._waiting[topic]

    def _record_truth(self, truth: Truth) -> None:
        if self._episode < 0 or truth.tick < self.newest_tick:
            self._begin(truth)
        elif truth.tick == self.newest_tick:
            return  # a paused simulation repeats its truth
        else:
            self.missing_ticks += truth.tick - self.newest_tick - 1
            if truth.tick == self.newest_tick + 1:
                self._file.take(schemas.COMMANDS, schemas.commands_of(truth), self.newest_time)
        self.ticks += 1
        self.newest_tick, self.newest_time = truth.tick, truth.time
        self._file.take(schemas.TRUTH, truth, truth.time)
        self._record_maps()

    def _begin(self, truth: Truth) -> None:
        self._episode += 1
        if self._episode == 0:
            self.first_tick = truth.tick
        start = self._file.next_start if self._episode else 0.0
        name, seed = ("", 0) if self._status is None else (self._status.scenario, self._status.seed)
        head = head_of(self._scenario, seed, name=name, episode=self._episode, start=start)
        self._file.begin(head, self._scenario)

    def counts(self) -> dict[str, object]:
        """Return the numbers of recorded ticks and flights."""
        return {
            "ticks": self.ticks,
            "missing_ticks": self.missing_ticks,
            "first_tick": self.first_tick,
            "last_tick": self.newest_tick,
            "flights": self._episode + 1,
        }

    def description(self) -> str:
        """Describe the recording in one line."""
        if not self.ticks:
            return "no tick received"
        late = f", recorded from tick {self.first_tick} on" if self.first_tick else ""
        return (
            f"{self.ticks} ticks up to {self.newest_time:.2f} s, {self.missing_ticks} missing{late}"
        )

    def close(self) -> None:
        """Complete and close the file.

        Raises:
            OSError: If a write failed.
        """
        self._file.close()
