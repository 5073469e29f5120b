"""Recording a run in progress, from outside: an observer who writes down what the simulator tells."""

import time
from typing import Protocol

from bus import keys
from bus.messages.base import Message
from bus.messages.control import Change
from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.session import Session
from outrider.recording import schemas
from outrider.recording.schemas import Commands, Head, Topic, head_of
from sim.scenario.types import Scenario

_INBOX_ROOM = 4096
"""Truths that wait for us before the oldest are lost: two seconds of a fast run."""
_LAST_WORDS = 0.6
"""The time after the run's last message in which something may still come [s]; a run that is reset goes on."""
_AT_ONCE = 256
"""Truths that are taken before the caller is shown how it stands."""


def _new_in(changes: tuple[Change, ...], known: tuple[Change, ...]) -> tuple[Change, ...]:
    """Those of the last changes that have come since others were the last."""
    old = next(n for n in range(len(changes), -1, -1) if known[len(known) - n :] == changes[:n])
    return changes[old:]


class RunSink(Protocol):
    """Takes down what an observer is told: a recording's file, or a bag."""

    @property
    def next_start(self) -> float:
        """The place of another flight on its clock [s]."""

    def begin(self, head: Head, scenario: Scenario | None) -> None:
        """A flight begins."""

    def take(self, topic: Topic, message: Message, seconds: float) -> None:
        """Take down a message of the flight that has begun.

        Args:
            topic: Its channel.
            message: What was told.
            seconds: When, in simulated time.
        """

    def flush_if_due(self) -> None:
        """Hand over what waits."""

    def close(self) -> None:
        """End it."""


class RunRecorder:
    """Records a run in progress: an observer who writes down what the simulator tells.

    Args:
        session: An observer's.
        file: Takes it down; closed with this.
        scenario: What is flown, if that is known.
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
        self._changes: tuple[Change, ...] = ()  # the last that were told
        self._waiting: dict[Topic, CoverageMap | GroundMap] = {}  # for their ticks' truths
        self._over_since: float | None = None
        self._busy = False
        self._episode = -1
        self.ticks = 0
        """Truths that were taken down."""
        self.missing_ticks = 0
        """Ticks between the first and the newest that never came."""
        self.first_tick = 0
        """Of the first flight."""
        self.newest_tick = -1
        self.newest_time = 0.0
        """[s]"""

    @property
    def ticks_of_run(self) -> int | None:
        """Number of ticks that it will have; None: not known yet."""
        return self._status.ticks if self._status is not None else None

    @property
    def over(self) -> bool:
        """True if the run is."""
        return (
            not self._busy
            and self._over_since is not None
            and time.monotonic() - self._over_since > _LAST_WORDS
        )

    def take(self, patience: float) -> None:
        """Take down what has come, and wait for up to `patience` [s] where nothing has."""
        received = self._truths.receive(patience)
        self._take_others()
        self._busy = received is not None
        taken = 0
        while received is not None:
            if isinstance(received.message, Truth):
                self._take_truth(received.message)
                taken += 1
            received = self._truths.next_waiting() if taken < _AT_ONCE else None
        self._file.flush_if_due()

    def _take_others(self) -> None:
        while (received := self._statuses.next_waiting()) is not None:
            if isinstance(received.message, Status):
                self._status = received.message
                if self._episode >= 0:
                    self._file.take(schemas.STATUS, received.message, received.message.time)
                    self._take_changes(received.message.changes)
                over = received.message.over
                self._over_since = (self._over_since or time.monotonic()) if over else None
        for topic, inbox in self._maps.items():
            while (received := inbox.next_waiting()) is not None:
                if isinstance(received.message, CoverageMap | GroundMap):
                    self._waiting[topic] = received.message
        self._put_maps()

    def _take_changes(self, changes: tuple[Change, ...]) -> None:
        for change in _new_in(changes, self._changes):
            self._file.take(schemas.CHANGES, change, self.newest_time)
        self._changes = changes

    def _put_maps(self) -> None:
        for topic, ground in list(self._waiting.items()):
            if self.newest_tick >= ground.tick > 0:
                self._file.take(topic, ground, self.newest_time * ground.tick / self.newest_tick)
                del self._waiting[topic]

    def _take_truth(self, truth: Truth) -> None:
        if self._episode < 0 or truth.tick < self.newest_tick:
            self._begin(truth)
        elif truth.tick == self.newest_tick:
            return  # a clock that stands still tells it again
        else:
            self.missing_ticks += truth.tick - self.newest_tick - 1
            if truth.tick == self.newest_tick + 1:
                asked = {name: vehicle.command for name, vehicle in truth.vehicles.items()}
                told = Commands(tick=self.newest_tick, accelerations=asked)
                self._file.take(schemas.COMMANDS, told, self.newest_time)
        self.ticks += 1
        self.newest_tick, self.newest_time = truth.tick, truth.time
        self._file.take(schemas.TRUTH, truth, truth.time)
        self._put_maps()

    def _begin(self, truth: Truth) -> None:
        self._episode += 1
        if self._episode == 0:
            self.first_tick = truth.tick
        start = self._file.next_start if self._episode else 0.0
        name, seed = ("", 0) if self._status is None else (self._status.scenario, self._status.seed)
        head = head_of(self._scenario, seed, name=name, episode=self._episode, start=start)
        self._file.begin(head, self._scenario)

    def counts(self) -> dict[str, object]:
        """Counts of what has come."""
        return {
            "ticks": self.ticks,
            "missing_ticks": self.missing_ticks,
            "first_tick": self.first_tick,
            "last_tick": self.newest_tick,
            "flights": self._episode + 1,
        }

    def story(self) -> str:
        """The same in words."""
        if not self.ticks:
            return "no tick came"
        late = f", recorded from tick {self.first_tick} on" if self.first_tick else ""
        return f"{self.ticks} ticks up to {self.newest_time:.2f} s, {self.missing_ticks} missing between them{late}"

    def close(self) -> None:
        """End the file.

        Raises:
            OSError: If not all could be written.
        """
        self._file.close()
