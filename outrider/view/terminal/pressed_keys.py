"""Velocity commanded by pressed keys. Pure: the clock is an argument.

A terminal reports when a key is pressed, and repeats a held key, but does not report its release. A key therefore acts
as a dead man's switch: a press counts for a moment, and repeats prolong it. The UGV brakes when the operator releases
the key, falls asleep or loses the connection.
"""

import math
from enum import Enum

FIRST = 0.7
"""Duration of the first press [s]; longer than the repeat delay of most keyboards."""
REPEAT = 0.4
"""Duration of each repeat [s]."""
CHORD = 0.15
"""Longest time between two presses that make a diagonal [s]."""
STEP = 0.05
"""Step of the speed setting [m/s]."""
LOWEST, HIGHEST = STEP, 20.0
"""Bounds of the speed setting [m/s]."""


class Heading(Enum):
    """Direction on the ground; y points up on the map."""

    EAST = (1, 0)
    WEST = (-1, 0)
    NORTH = (0, 1)
    SOUTH = (0, -1)

    @property
    def axis(self) -> int:
        """Axis of the direction: 0 for x, 1 for y."""
        return 0 if self.value[0] else 1


class PressedKeys:
    """State of the keys, and the velocity that they command.

    Args:
        speed: Speed of a pressed key [m/s].
    """

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self._held: dict[Heading, float] = {}  # held keys, and the times of their first press [s]
        self._until = -math.inf

    def press(self, heading: Heading, now: float) -> None:
        """Register a press or a repeat at `now` [s]."""
        if not self._is_held(now):
            self._held = {}
        if heading in self._held:
            self._until = max(self._until, now + REPEAT)
            return
        partners = {
            one: since
            for one, since in self._held.items()
            if one.axis != heading.axis and now - since <= CHORD
        }
        self._held = {**partners, heading: now}
        self._until = now + FIRST

    def release(self) -> None:
        """Release all keys: brake."""
        self._held = {}

    def faster(self, steps: int) -> None:
        """Increase the speed by a number of steps; negative: reduce it."""
        self.speed = min(max(round(self.speed / STEP + steps) * STEP, LOWEST), HIGHEST)

    def velocity(self, now: float) -> tuple[float, float] | None:
        """Return the commanded velocity at `now` [s], in m/s; None: brake."""
        if not self._is_held(now):
            return None
        x, y = (sum(heading.value[axis] for heading in self._held) for axis in (0, 1))
        share = self.speed / math.hypot(x, y)
        return x * share, y * share

    def _is_held(self, now: float) -> bool:
        return bool(self._held) and now < self._until
