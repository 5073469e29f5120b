"""Recorded run as a source of the page, with playback speed, pause and seek."""

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

_Thinned = TypeVar("_Thinned", bound=Message)
_MAX_MESSAGES = 2000
"""Maximum number of maps or statuses in memory; beyond it, every second one is dropped."""
_MAX_SKIPPED = 2400
"""Maximum number of truths sent to the history when the user seeks."""
_PERIOD = 0.2
"""Wall time between two status messages [s]; the same as the simulator's."""


class RecordedRun:
    """Playback of one recorded run; stops at its end.

    Args:
        recording: Run to play.
        speed: Simulated seconds per second of wall time.
        clock: Returns the wall time [s].
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
        # The last statuses follow the end of the run; their factors include idle time.
        self._factors = [
            (status.time, status.realtime_factor)
            for status in self._statuses
            if not status.over and status.realtime_factor
        ]
        self._geometry = (
            None
            if recording.head.scenario is None
            else geometry_of(recording.scenario, recording.buildings)
        )
        self._file = recording.path.name
        self._note = recording.damage.reason
        self.playing, self.speed = True, speed
        self._at = self._times[0]
        self._polled: float | None = None
        self._status_sent = 0.0
        self._truth = self._last_status = -1  # indices of the messages sent last
        self._last_maps = [-1 for _ in self._maps]
        self._last_time = self._at

    @property
    def begin(self) -> float:
        """Start of the recording [s]."""
        return self._times[0]

    @property
    def end(self) -> float:
        """End of the recording [s]."""
        return self._times[-1]

    # Playback

    def play(self) -> None:
        """Resume playback; restart if the end was reached."""
        if self._at >= self.end:
            self.seek(self.begin)
        self.playing = True

    def pause(self) -> None:
        """Pause playback."""
        self.playing = False

    def seek(self, to: float) -> None:
        """Jump to a time [s]."""
        self._at = min(max(to, self.begin), self.end)
        self._status_sent = 0.0

    def step(self, ticks: int) -> None:
        """Pause, and advance by some ticks."""
        self.pause()
        self.seek(self._times[min(max(self._index() + ticks, 0), len(self._times) - 1)])

    # Source

    def _index(self) -> int:
        return max(0, bisect_right(self._times, self._at + 1e-9) - 1)

    def news(self) -> Iterator[Message]:
        """Yield the messages up to the current playback time."""
        now = self._clock()
        if self.playing and self._polled is not None:
            self._at = min(self.end, self._at + (now - self._polled) * self.speed)
            self.playing = self._at < self.end
        self._polled = now
        index = self._index()
        yield from self._up_to(index)
        if now - self._status_sent >= _PERIOD or not self.playing:
            self._status_sent = now
            yield self._status(self._truths[index])
        for kind, maps in enumerate(self._maps):
            newest = bisect_right(maps, self._truths[index].tick, key=lambda one: one.tick) - 1
            if newest not in (-1, self._last_maps[kind]):
                self._last_maps[kind] = newest
                yield maps[newest]

    def _up_to(self, index: int) -> Iterator[Status | Truth]:
        """Yield the truths and statuses since the last call, or since the start after seeking back."""
        if index == self._truth:
            return
        first = self._truth + 1 if index > self._truth else 0
        self._truth = index
        for truth in (
            *self._truths[first : index : max(1, (index - first) // _MAX_SKIPPED)],
            self._truths[index],
        ):
            if self._status_index(truth.time) != self._last_status:
                yield self._status(truth)
            self._last_time = truth.time
            yield truth

    def _status_index(self, at: float) -> int:
        return max(0, bisect_right(self._statuses, at + 1e-9, key=lambda status: status.time) - 1)

    def _status(self, truth: Truth) -> Status:
        self._last_status = self._status_index(truth.time)
        recorded = self._statuses[self._last_status]
        return msgspec.structs.replace(
            recorded,
            tick=truth.tick,
            time=truth.time,
            paused=not self.playing and self._at < self.end,
            geometry=recorded.geometry or self._geometry,
            over=recorded.over and self._at >= self.end,
        )

    @property
    def factor(self) -> float:
        """Recorded real-time factor at the truth sent last."""
        at = bisect_right(self._factors, (self._last_time + 1e-9, 0.0)) - 1
        return self._factors[max(0, at)][1] if self._factors else 0.0

    @property
    def state(self) -> SourceState:
        """Playback state of the recording."""
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
        why = f": the file is incomplete, {self._note}" if self._note else ""
        return SourceState(level="info", line=f"End of the recording{why}.", replay=playing)

    def control(self, _control: Control) -> bool:
        """Return False: a recording accepts no commands."""
        return False

    def drive(self, _vehicle: str, _drive: Teleoperation) -> bool:
        """Return False: the vehicles of a recording cannot be driven."""
        return False

    def close(self) -> None:
        """Do nothing: a recording holds no resources."""


def _thinned(messages: Iterable[_Thinned]) -> list[_Thinned]:
    """Return evenly spaced messages, at most `_MAX_MESSAGES`, including the last one."""
    kept: list[_Thinned] = []
    stride, last = 1, None
    for number, message in enumerate(messages):
        last = message
        if number % stride == 0:
            kept.append(message)
            if len(kept) > _MAX_MESSAGES:
                kept, stride = kept[::2], 2 * stride
    if last is not None and kept[-1] is not last:
        kept.append(last)
    return kept


def _unknown_status(recording: Recording) -> Status:
    """Return a status for a file that was truncated before its first status."""
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
