"""Seconds and ticks: messages and scenarios carry seconds, everything inside counts ticks.

A time stamp is a tick times dt, never a sum. It becomes a tick again once, where a message is received.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.messages.vehicle import Detection, RelativeInformation

NO_TICK = -1
"""In place of a tick: a time stamp that is none of a tick."""

DUST = 1e-6
"""A time may be off by this share of a tick, by rounding in whoever made it: 0.35 s is seven ticks of 0.05 s."""

MOST_TICKS = 2**40
"""So many at most are counted with: those of a time that has no end."""


RADIO_PERIOD = 0.2
"""Time between two messages of relative information by radio [s]."""


class Look(NamedTuple):
    """A detection, as everything inside takes it."""

    taken: int
    """In which tick; NO_TICK: its time stamp is none of a tick."""
    x: float
    y: float
    """p_a - p_g with noise [m]."""


def tick_of(time: float, dt: float) -> int:
    """The tick of a time stamp.

    Args:
        time: As a message carries it [s].
        dt: Length of a tick [s].

    Returns:
        The tick; NO_TICK where the time is between two ticks, or not finite. Whoever receives such a message uses
        it for nothing.
    """
    ticks = time / dt
    if not -DUST <= ticks < 2.0**53:
        return NO_TICK
    tick = round(ticks)
    return tick if abs(ticks - tick) <= DUST else NO_TICK


def looks_of(detections: Iterable[Detection | RelativeInformation], dt: float) -> tuple[Look, ...]:
    """Return the relative positions of a message; dt [s] is the length of a tick."""
    return tuple(Look(tick_of(one.time, dt), *one.relative_position) for one in detections)


def look_rows(looks: Sequence[Look]) -> npt.NDArray[np.float64]:
    """Return relative positions as compiled code takes them, in the columns of `Look`. Shape (looks, 3)."""
    return np.array(looks, dtype=np.float64).reshape(-1, len(Look._fields))


def radio_ticks(dt: float) -> int:
    """Every how many ticks of this length [s] a UAV radios relative information to its UGV."""
    return max(1, round(RADIO_PERIOD / dt))


def ticks_within(duration: float, dt: float) -> int:
    """The number of whole ticks in a duration [s]; `MOST_TICKS` where it has no end."""
    return math.floor(min(duration / dt + DUST, MOST_TICKS))


def first_tick_from(time: float, dt: float) -> int:
    """The first tick that is not before a time [s]."""
    return math.ceil(time / dt - DUST)
