"""A recording as the hub has it: played at a speed, paused, and wound to any time."""

import time
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import msgspec

from bus.messages.base import Message
from bus.messages.control import Control
from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.messages.vehicle import Teleoperation
from bus.registry import DEFAULT_LAW
from outrider.recording.reader import Recording, coverages, grounds, statuses
from outrider_dashboard.sources.protocol import Playing, SourceState
from sim.scene.known import geometry_of

_Kept = TypeVar("_Kept", bound=Message)
_ROOM = 2000
"""Maps and statuses that are kept; of more, every second one."""
_PAST = 2400
"""Truths that the history is told at most when the tape is wound."""
_PERIOD = 0.2
"""Wall time between two status messages [s], as a simulator's."""


class Tape:
    """One flight of a file that is played; it stands still at its end.

    Args:
        recording: The flight.
        speed: Simulated seconds per second of wall time.
        clock: Wall time [s].
    """

    may_steer = False

    def __init__(
        self, recording: Recording, speed: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock = clock
        self._truths = recording.truths
        self._times = [truth.time for truth in self._truths]
        self._maps: tuple[list[CoverageMap] | list[GroundMap], ...] = (
            _thinned(coverages(recording.path, flight=recording.number)),
            _thinned(grounds(recording.path, flight=recording.number)),
        )
        self._statuses = _thinned(statuses(recording.path, flight=recording.number)) or [
            _unknown_status(recording)
        ]
        # The last ones are told when the flight is over, and count ticks that were not flown.
        self._factors = [
            (told.time, told.realtime_factor)
            for told in self._statuses
            if not told.over and told.realtime_factor
        ]
        self._geometry = (
            None if recording.head.scenario is None else geometry_of(recording.scenario)
        )
        self._file = recording.path.name
        self._note = recording.damage.reason
        self.playing, self.speed = True, speed
        self._at = self._times[0]
        self._looked: float | None = None
        self._told = 0.0
        self._truth = self._status_given = -1  # what was given last
        self._maps_given = [-1 for _ in self._maps]
        self._given = self._at

    @property
    def begin(self) -> float:
        """Of the recording [s]."""
        return self._times[0]

    @property
    def end(self) -> float:
        """Of the recording [s]."""
        return self._times[-1]

    # What people want

    def play(self) -> None:
        """Go on; from the start, where the end was reached."""
        if self._at >= self.end:
            self.wind(self.begin)
        self.playing = True

    def pause(self) -> None:
        """Stand still."""
        self.playing = False

    def wind(self, to: float) -> None:
        """Show another time [s]."""
        self._at = min(max(to, self.begin), self.end)
        self._told = 0.0

    def step(self, ticks: int) -> None:
        """Stand still some ticks further on."""
        self.pause()
        self.wind(self._times[min(max(self._index() + ticks, 0), len(self._times) - 1)])

    # What the hub wants

    def _index(self) -> int:
        return max(0, bisect_right(self._times, self._at + 1e-9) - 1)

    def news(self) -> Iterator[Message]:
        """The messages to be shown since the last call."""
        now = self._clock()
        if self.playing and self._looked is not None:
            self._at = min(self.end, self._at + (now - self._looked) * self.speed)
            self.playing = self._at < self.end
        self._looked = now
        index = self._index()
        yield from self._on_the_way_to(index)
        if now - self._told >= _PERIOD or not self.playing:
            self._told = now
            yield self._status(self._truths[index])
        for kind, maps in enumerate(self._maps):
            newest = bisect_right(maps, self._truths[index].tick, key=lambda told: told.tick) - 1
            if newest not in (-1, self._maps_given[kind]):
                self._maps_given[kind] = newest
                yield maps[newest]

    def _on_the_way_to(self, index: int) -> Iterator[Status | Truth]:
        """The truths from where the tape was (its start if it was wound back) to this one, and statuses between."""
        if index == self._truth:
            return
        first = self._truth + 1 if index > self._truth else 0
        self._truth = index
        for truth in (
            *self._truths[first : index : max(1, (index - first) // _PAST)],
            self._truths[index],
        ):
            if self._status_index(truth.time) != self._status_given:
                yield self._status(truth)
            self._given = truth.time
            yield truth

    def _status_index(self, at: float) -> int:
        return max(0, bisect_right(self._statuses, at + 1e-9, key=lambda told: told.time) - 1)

    def _status(self, truth: Truth) -> Status:
        self._status_given = self._status_index(truth.time)
        told = self._statuses[self._status_given]
        return msgspec.structs.replace(
            told,
            tick=truth.tick,
            time=truth.time,
            paused=not self.playing and self._at < self.end,
            geometry=told.geometry or self._geometry,
            over=told.over and self._at >= self.end,
        )

    @property
    def factor(self) -> float:
        """As it was when the truth that was given last was flown."""
        at = bisect_right(self._factors, (self._given + 1e-9, 0.0)) - 1
        return self._factors[max(0, at)][1] if self._factors else 0.0

    @property
    def standing(self) -> SourceState:
        """The state of the recording."""
        playing = Playing(
            file=self._file,
            begin=self.begin,
            end=self.end,
            at=self._at,
            playing=self.playing,
            speed=self.speed,
            note=self._note,
        )
        if self._at < self.end:
            return SourceState(replay=playing)
        why = f": the file is not whole, {self._note}" if self._note else ""
        return SourceState(level="info", line=f"The recording ends here{why}.", replay=playing)

    def control(self, _control: Control) -> bool:
        """Send nothing: a recording takes no commands."""
        return False

    def drive(self, _vehicle: str, _drive: Teleoperation) -> bool:
        """Nobody receives it."""
        return False

    def close(self) -> None:
        """Nothing to be done."""


def _thinned(messages: Iterable[_Kept]) -> list[_Kept]:
    """Not more than there is room for, evenly; the last one is among them."""
    kept: list[_Kept] = []
    stride, last = 1, None
    for number, message in enumerate(messages):
        last = message
        if number % stride == 0:
            kept.append(message)
            if len(kept) > _ROOM:
                kept, stride = kept[::2], 2 * stride
    if last is not None and kept[-1] is not last:
        kept.append(last)
    return kept


def _unknown_status(recording: Recording) -> Status:
    """Of a file that was cut off before its first one."""
    head, first = recording.head, recording.truths[0]
    return Status(
        scenario=head.name,
        seed=head.seed,
        tick=first.tick,
        ticks=recording.truths[-1].tick,
        time=first.time,
        realtime_factor=0.0,
        law=DEFAULT_LAW if head.scenario is None else recording.scenario.law.name,
        vehicles={},
    )
