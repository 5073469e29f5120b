"""Relative positions of a message, as compiled code takes them: detections, and what a UAV has radioed."""

from collections.abc import Sequence

import numpy as np

from bus.messages import Detection, RelativeInformation
from bus.ticks import Look, tick_of
from sim.kernels.compile import FloatArray


class LookRows:
    """An array that is used again for the looks of each message.

    Args:
        dt: Length of a tick [s].
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._rows: FloatArray = np.zeros((4, len(Look._fields)))

    def take(self, looks: Sequence[Detection | RelativeInformation]) -> tuple[FloatArray, int]:
        """The looks in the columns of `Look`, and how many rows they are."""
        rows = self._rows
        if not looks:
            return rows, 0
        if len(looks) > len(rows):
            rows = self._rows = np.zeros((2 * len(looks), len(Look._fields)))
        for row, one in zip(rows, looks, strict=False):
            row[:] = tick_of(one.time, self._dt), *one.relative_position
        return rows, len(looks)
