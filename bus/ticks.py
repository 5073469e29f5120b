"""Conversion between seconds and ticks: messages and scenarios use seconds, the rest of the code counts ticks.

A time stamp is a tick times dt, never a sum. It is converted back to a tick once, on receipt.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.messages.vehicle import Detection, RelativeInformation

NO_TICK = -1
"""Placeholder for a time stamp that matches no tick."""

TICK_TOLERANCE = 1e-6
"""Tolerance, in ticks, when converting a time stamp to a tick: 0.35 s is seven ticks of 0.05 s."""

MOST_TICKS = 2**40
"""Largest count of ticks; used for unlimited times."""


RADIO_PERIOD = 0.2
"""Time between two radio messages with relative information [s]."""
TEAM_PERIOD = 0.2
"""Time between two messages of a UAV to its team [s]."""


class DetectionRow(NamedTuple):
    """Detection in ticks, the internal form."""

    taken: int
    """Tick of the detection; NO_TICK: its time stamp matches no tick."""
    x: float
    y: float
    """Relative position p_a - p_g with noise [m]."""


def tick_of(time: float, dt: float) -> int:
    """Return the tick of a time stamp.

    Args:
        time: Time stamp of a message [s].
        dt: Duration of a tick [s].

    Returns:
        The tick; NO_TICK if the time is between two ticks, or not finite. The receiver ignores such a message.
    """
    ticks = time / dt
    if not -TICK_TOLERANCE <= ticks < 2.0**53:
        return NO_TICK
    tick = round(ticks)
    return tick if abs(ticks - tick) <= TICK_TOLERANCE else NO_TICK


def detection_rows(
    detections: Iterable[Detection | RelativeInformation], dt: float
) -> tuple[DetectionRow, ...]:
    """Return the relative positions of a message; dt is the duration of a tick [s]."""
    return tuple(DetectionRow(tick_of(one.time, dt), *one.relative_position) for one in detections)


def detection_array(detections: Sequence[DetectionRow]) -> npt.NDArray[np.float64]:
    """Return relative positions in the columns of `DetectionRow`, for compiled code. Shape (detections, 3)."""
    return np.array(detections, dtype=np.float64).reshape(-1, len(DetectionRow._fields))


def radio_ticks(dt: float) -> int:
    """Return the period, in ticks of dt [s], of the UAV's relative information by radio."""
    return max(1, round(RADIO_PERIOD / dt))


def team_ticks(dt: float) -> int:
    """Return the period, in ticks of dt [s], of a UAV's messages to its team."""
    return max(1, round(TEAM_PERIOD / dt))


def ticks_within(duration: float, dt: float) -> int:
    """Return the number of whole ticks in a duration [s]; `MOST_TICKS` if it is unlimited."""
    return math.floor(min(duration / dt + TICK_TOLERANCE, MOST_TICKS))


def first_tick_from(time: float, dt: float) -> int:
    """Return the first tick at or after a time [s]."""
    return math.ceil(time / dt - TICK_TOLERANCE)
