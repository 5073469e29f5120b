"""The past of the UAV's filter, kept so that a detection that comes late counts at its own time."""

from bisect import bisect_left
from collections import deque
from operator import attrgetter

import msgspec

from bus.ticks import ticks_within
from sim.kernels.compile import FloatArray

SPAN = 60.0
"""The largest delay of a detection that is still used, by default [s]."""

_MOST_TICKS = 100_000  # about 60 MB; where ticks are so short that the span has more, it is cut

_tick_of = attrgetter("tick")


class PastTick(msgspec.Struct, gc=False, kw_only=True):
    """A tick at which the filter was called: where the UAV was, what it saw, and what it believed before that.

    The arrays are the filter's own, not copies: it replaces its arrays and never writes into them.
    """

    tick: int
    own_position: tuple[float, float]  # p_a [m]
    seen: tuple[float, float] | None = None  # where the UGV was detected, in the world frame [m]
    x: FloatArray
    P: FloatArray
    age: int | None  # since the newest believed detection [ticks]; None: nothing was ever believed
    refused: int
    refused_in_a_row: int


class FilterHistory:
    """The moments of the last so many ticks, in order; the oldest make room.

    Args:
        span: How far back it reaches [s].
        dt: Length of a tick [s].

    Raises:
        ValueError: If the span is negative.
    """

    def __init__(self, *, span: float, dt: float) -> None:
        if not span >= 0.0:
            raise ValueError(f"span must not be negative, but is {span}")
        self.ticks = _MOST_TICKS if span / dt > _MOST_TICKS else ticks_within(span, dt)
        """Its oldest tick."""
        self._moments: deque[PastTick] = deque(maxlen=self.ticks + 1)
        self.add = self._moments.append
        """Add the newest moment. The method is the queue's own: it is called at every tick."""

    def find(self, tick: int) -> PastTick | None:
        """The moment of this tick, if the filter was called then."""
        k = bisect_left(self._moments, tick, key=_tick_of)
        if k == len(self._moments):
            return None
        moment = self._moments[k]
        return moment if moment.tick == tick else None

    def after(self, moment: PastTick) -> list[PastTick]:
        """All moments later than this one, in order."""
        k = bisect_left(self._moments, moment.tick + 1, key=_tick_of)
        return [self._moments[i] for i in range(k, len(self._moments))]
