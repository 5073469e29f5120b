"""Times of sent and received messages, as a table of delays."""

import math
from typing import NamedTuple

import numpy as np

from bus.errors import ScenarioError
from bus.numbers import below
from outrider_networks.delay_fit import LONGEST
from sim.channel.recorded import MOST_LINES, RecordedLink, pack
from sim.compiling.compile import FloatArray

_ROUNDING = 1e-5
"""Largest negative delay that counts as 0 [s]: the resolution of captured times."""
_UNEVEN, _MOST_UNEVEN = 0.25, 0.05
"""Part of an interval by which a gap may miss a multiple of it, and largest share of other gaps."""


class MessageTimes(NamedTuple):
    """Messages in the order of sending. Shapes (messages,)."""

    sent: FloatArray
    """Time on the sender's clock [s], increasing."""
    delay: FloatArray
    """Receiver's clock at arrival, minus `sent` [s]; NaN: lost."""
    notes: tuple[str, ...] = ()


def table_of(times: MessageTimes, name: str) -> RecordedLink:
    """Return the messages as a table for a link's `trace`.

    Raises:
        ScenarioError: If the clocks of sender and receiver differ visibly, or there are too many messages.
    """
    least = float(np.nanmin(times.delay)) if np.isfinite(times.delay).any() else 0.0
    if least < -_ROUNDING:
        raise ScenarioError(
            f"{name}: a delay is {below(least, 0.0)} s, as the receiver's clock is behind the sender's; "
            "allowed: synchronized clocks"
        )
    if least > LONGEST:
        raise ScenarioError(
            f"{name}: every delay is {least:.6g} s or more, as sender and receiver use different clocks; "
            "allowed: synchronized clocks"
        )
    if len(times.sent) > MOST_LINES:
        raise ScenarioError(
            f"{name}: more than {MOST_LINES:,} messages; allowed: a shorter recording"
        )
    sent = (times.sent - times.sent[0]).tolist()
    rows = [
        f"{at:.6f},{'lost' if math.isnan(took) else f'{max(took, 0.0):.6f}'}"
        for at, took in zip(sent, times.delay.tolist(), strict=True)
    ]
    return pack(name, "\n".join(("sent [s],delay [s]", *rows, "")).encode())


def with_gaps(times: MessageTimes) -> MessageTimes:
    """Add a lost message for each multiple of the interval at which none was sent.

    Messages at uneven intervals stay as they are, with a note.
    """
    gaps = np.diff(times.sent)
    interval = float(np.median(gaps)) if gaps.size else 0.0
    if interval <= 0.0:
        return times
    steps = np.maximum(np.round(gaps / interval), 1.0)
    uneven = float((np.abs(gaps / interval - steps) > _UNEVEN).mean())
    if uneven > _MOST_UNEVEN:
        note = (
            f"losses do not show: {100.0 * uneven:.2g} % of the messages are not sent at whole "
            f"multiples of {interval:.3g} s"
        )
        return times._replace(notes=(*times.notes, note))
    missing = (steps - 1.0).astype(int)
    if missing.sum() + len(times.sent) > MOST_LINES:
        return times._replace(notes=(*times.notes, "losses do not show: the gaps are too long"))
    before = np.repeat(np.arange(len(gaps)), missing)
    first = np.repeat(np.cumsum(missing) - missing, missing)
    number = np.arange(len(before)) - first + 1
    lost = times.sent[before] + number * gaps[before] / steps[before]
    sent = np.concatenate((times.sent, lost))
    delay = np.concatenate((times.delay, np.full(len(lost), np.nan)))
    order = np.argsort(sent, kind="stable")
    return times._replace(sent=sent[order], delay=delay[order])
