"""Samples of delay and loss at equal intervals, from a recorded or a simulated link."""

import math
from typing import NamedTuple

import numpy as np

from bus.errors import ScenarioError
from bus.messages.links import LinkSettings
from sim.channel.description import link_parameters, longest_wait
from sim.channel.link_records import LinkParameters
from sim.channel.links import first_arrivals
from sim.channel.recorded import Fates, RecordedLink, recording_of
from sim.compiling.compile import FloatArray, IntArray
from sim.models.randomness import Key

MILLISECOND = 0.001
_FINEST = 0.0002
"""Time resolution of a simulated link [s]."""
_TICKS = 100
"""Largest number of ticks between two messages of a simulated link."""
_MESSAGES = 20_000
_KEY: Key = (np.uint64(0x6F757472), np.uint64(0x69646572))
"""Rng key of every simulated link: the same file and settings give the same numbers."""
_MOST = 1_000_000
"""Largest number of evaluated messages of a recorded link, from its start."""


class Sample(NamedTuple):
    """Messages sent at equal intervals."""

    interval: float
    """Time between two messages [s]."""
    delay: FloatArray
    """Delays [s]; NaN if lost. Shape (messages,)."""

    @property
    def lost(self) -> float:
        """Return the share of lost messages."""
        return float(np.isnan(self.delay).mean())

    @property
    def arrived(self) -> FloatArray:
        """Return the delays of received messages in ascending order [s]."""
        found: FloatArray = np.sort(self.delay[~np.isnan(self.delay)])
        return found

    @property
    def lost_runs(self) -> IntArray:
        """Return the first message of each run of losses and the first after it. Shape (runs, 2)."""
        edges = np.diff(np.isnan(self.delay).astype(np.int8), prepend=0, append=0)
        return np.flatnonzero(edges).reshape(-1, 2)

    @property
    def bursts(self) -> IntArray:
        """Return the lengths of the runs of losses."""
        runs = self.lost_runs
        return runs[:, 1] - runs[:, 0]

    @property
    def waits(self) -> FloatArray:
        """Return the time from each message until it or a later one arrives [s].

        The receiver's view of delay and loss combined.
        """
        sent = np.arange(len(self.delay)) * self.interval
        arrives = np.where(np.isnan(self.delay), np.inf, sent + self.delay)
        first = np.minimum.accumulate(arrives[::-1])[::-1] - sent
        found: FloatArray = first[np.isfinite(first)]
        return found


def recorded_sample(recorded: RecordedLink, *, rate: float, message_bytes: int) -> Sample:
    """Return the messages of a recorded link.

    Args:
        recorded: Table with messages of its own, or Mahimahi file, replayed once.
        rate: Message rate over a Mahimahi file [1/s].
        message_bytes: Message size [bytes]. A full queue drops messages as in a run.

    Raises:
        ScenarioError: If the file is not a recorded link, or no message arrives.
    """
    recording = recording_of(recorded)
    if isinstance(recording, Fates):
        gaps = np.diff(recording.sent)
        interval = float(np.median(gaps[gaps > 0.0])) if (gaps > 0.0).any() else 1.0
        sample = Sample(interval, recording.delay[:_MOST])
    else:
        every = max(1, round(1.0 / (rate * MILLISECOND)))
        settings = LinkSettings(trace=recorded.name, message_bytes=message_bytes)
        p = link_parameters(settings, MILLISECOND, traces=(recorded,))
        messages = min(max(2, p.period // every), _MOST)
        sample = _played(p, MILLISECOND, messages, every)
    if not sample.arrived.size:
        raise ScenarioError(
            f"{recorded.name}: no message arrives; allowed: recordings with received messages"
        )
    return sample


def drawn_sample(settings: LinkSettings, interval: float) -> Sample:
    """Simulate messages over a link with random delays and losses.

    Args:
        settings: Settings of the link.
        interval: Time between two messages [s].
    """
    every = min(max(1, math.ceil(interval / _FINEST)), _TICKS)
    dt = interval / every
    return _played(link_parameters(settings, dt), dt, _MESSAGES, every)


def _played(parameters: LinkParameters, dt: float, messages: int, every: int) -> Sample:
    # later messages let the last ones arrive
    later = (parameters.longest + longest_wait(parameters)) // every + 2
    arrived = first_arrivals(parameters, _KEY, messages + later, every=every)[:messages]
    took = (arrived - np.arange(messages) * every) * dt
    return Sample(every * dt, np.where(arrived >= 0, took, np.nan))
