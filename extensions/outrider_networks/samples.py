"""The fates of messages sent at equal times: over a recorded link, or over one that is drawn."""

import math
from typing import NamedTuple

import numpy as np

from bus.errors import ScenarioError
from bus.messages.links import LinkSettings
from sim.channel.description import link_parameters
from sim.channel.link_records import LinkParameters
from sim.channel.links import first_arrivals
from sim.channel.recorded import Fates, RecordedLink, recording_of
from sim.compiling.compile import FloatArray, IntArray
from sim.models.randomness import Key

MILLISECOND = 0.001
_FINEST = 0.0002
"""Resolution at which a link is played [s]."""
_TICKS = 100
"""Largest number of ticks of a played link between two messages."""
_MESSAGES = 20_000
_KEY: Key = (np.uint64(0x6F757472), np.uint64(0x69646572))
"""Seed of every played link: the same file and settings give the same numbers."""
_MOST = 1_000_000
"""Messages of a recorded link that are looked at, from its first on."""


class Sample(NamedTuple):
    """Messages, one every `interval`."""

    interval: float
    """[s]"""
    delay: FloatArray
    """[s]; NaN: lost. Shape (messages,)."""

    @property
    def lost(self) -> float:
        """Share of the messages."""
        return float(np.isnan(self.delay).mean())

    @property
    def arrived(self) -> FloatArray:
        """Delays of those that arrived [s], rising."""
        found: FloatArray = np.sort(self.delay[~np.isnan(self.delay)])
        return found

    @property
    def lost_runs(self) -> IntArray:
        """For each run of lost messages its first one and the one after its last. Shape (runs, 2)."""
        edges = np.diff(np.isnan(self.delay).astype(np.int8), prepend=0, append=0)
        return np.flatnonzero(edges).reshape(-1, 2)

    @property
    def bursts(self) -> IntArray:
        """The number of messages lost in a row, each time that any were."""
        runs = self.lost_runs
        return runs[:, 1] - runs[:, 0]

    @property
    def waits(self) -> FloatArray:
        """Time from each message until it or a later one arrives [s]: what a receiver notices of delay and loss."""
        sent = np.arange(len(self.delay)) * self.interval
        arrives = np.where(np.isnan(self.delay), np.inf, sent + self.delay)
        first = np.minimum.accumulate(arrives[::-1])[::-1] - sent
        found: FloatArray = first[np.isfinite(first)]
        return found


def recorded_sample(recorded: RecordedLink, *, rate: float, message_bytes: int) -> Sample:
    """The messages of a recorded link.

    Args:
        recorded: A table has messages of its own; a Mahimahi file is played for one round.
        rate: Messages that are sent over a Mahimahi file [1/s].
        message_bytes: Their size. A full queue loses messages as in a run.

    Raises:
        ScenarioError: If it is no recorded link, or nothing arrives over it.
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
            f"{recorded.name}: no message arrives; allowed: a recording with one that does"
        )
    return sample


def drawn_sample(settings: LinkSettings, interval: float) -> Sample:
    """Some thousand messages over a link that is drawn.

    Args:
        settings: Of the link.
        interval: Between two messages [s].
    """
    every = min(max(1, math.ceil(interval / _FINEST)), _TICKS)
    dt = interval / every
    return _played(link_parameters(settings, dt), dt, _MESSAGES, every)


def _played(parameters: LinkParameters, dt: float, messages: int, every: int) -> Sample:
    arrived = first_arrivals(parameters, _KEY, messages, every=every)
    took = (arrived - np.arange(messages) * every) * dt
    return Sample(every * dt, np.where(arrived >= 0, took, np.nan))
