"""Headings of UGVs that steer: rotation into base_link, and the turn rate."""

import math

from bus.messages.base import Vector
from sim.models.kinematics import wrapped

_LONGEST = 1.0
"""Longest time between two headings from which a turn rate follows [s]."""


def in_base_link(vector: Vector, heading: float | None) -> Vector:
    """Return a vector in `map` as one in the base_link of a vehicle.

    Args:
        vector: Its components east and north.
        heading: Heading of the vehicle [rad], from east to north; None: its base_link has the orientation of `map`.
    """
    if heading is None:
        return vector
    (x, y), e_x, e_y = vector, math.cos(heading), math.sin(heading)
    return x * e_x + y * e_y, y * e_x - x * e_y


def in_map(vector: Vector, heading: float | None) -> Vector:
    """Return a vector in the base_link of a vehicle as one in `map`; arguments as of `in_base_link`."""
    return in_base_link(vector, None if heading is None else -heading)


class TurnRate:
    """Turn rate of a vehicle: the mean between its last two headings, 0 if unknown."""

    def __init__(self) -> None:
        self.value = 0.0
        """Turn rate [rad/s]; positive: to the left."""
        self._last: tuple[float, float] | None = None

    def update(self, time: float, heading: float | None) -> float:
        """Return the turn rate at a simulated time [s], by the heading then [rad]; None: the vehicle has none."""
        if heading is None:
            return 0.0
        before, previous = self._last or (time, heading)
        passed = time - before
        if passed != 0.0:
            turned = wrapped(heading - previous)
            self.value = turned / passed if 0.0 < passed <= _LONGEST else 0.0
        self._last = time, heading
        return self.value
