"""The velocity that pressed keys ask of the UGV. Pure: the clock is an argument.

A terminal tells when a key goes down and repeats it while it is held, but never tells when it is let go. So a key
is a dead man's switch: it counts for a moment, and its repeats prolong it. Whoever lets go, falls asleep or loses the
connection brakes.
"""

import math
from enum import Enum

FIRST = 0.7
"""The time for which the first press counts [s]; longer than most keyboards take to begin repeating."""
REPEAT = 0.4
"""The time that each repeat adds [s]."""
CHORD = 0.15
"""Two keys that go down within this time [s] are one diagonal."""
STEP = 0.05
"""By how much the speed is set [m/s]."""
LOWEST, HIGHEST = STEP, 20.0
"""Bounds of the speed [m/s]."""


class Heading(Enum):
    """A direction on the ground; y is up on the map."""

    EAST = (1, 0)
    WEST = (-1, 0)
    NORTH = (0, 1)
    SOUTH = (0, -1)

    @property
    def axis(self) -> int:
        """0 along x, 1 along y."""
        return 0 if self.value[0] else 1


class PressedKeys:
    """The velocity that the operator wants now.

    Args:
        speed: How fast a pressed key drives [m/s].
    """

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self._held: dict[Heading, float] = {}  # what is held, and since when [s]
        self._until = -math.inf

    def press(self, heading: Heading, now: float) -> None:
        """A key has gone down, or is repeated, at `now` [s]."""
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
        """Want nothing any more: brake."""
        self._held = {}

    def faster(self, steps: int) -> None:
        """Set the speed higher by so many steps, or lower."""
        self.speed = min(max(round(self.speed / STEP + steps) * STEP, LOWEST), HIGHEST)

    def velocity(self, now: float) -> tuple[float, float] | None:
        """The velocity that is wanted at `now` [s], in m/s; None: to brake."""
        if not self._is_held(now):
            return None
        x, y = (sum(heading.value[axis] for heading in self._held) for axis in (0, 1))
        share = self.speed / math.hypot(x, y)
        return x * share, y * share

    def _is_held(self, now: float) -> bool:
        return bool(self._held) and now < self._until
