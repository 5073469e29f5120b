"""Messages that a bridge does not pass on, counted by cause."""

from collections import Counter
from collections.abc import Callable

_LONGEST = 300


class Refused(Exception):
    """A message that is not passed on; as a string one printable line.

    Args:
        cause: In a few words, the same for all alike.
        what: Of this one, for people.
    """

    def __init__(self, cause: str, what: str) -> None:
        line = f"{cause}: {what}"[:_LONGEST]
        super().__init__("".join(one if one.isprintable() else "?" for one in line))
        self.cause, self.what = cause, what


class Refusals:
    """Counts what was refused, and tells the 1st, 2nd, 4th, 8th ... of each cause: a flood must not fill a log.

    Args:
        tell: Takes the newest one, and how many of its cause there have been.
    """

    def __init__(self, tell: Callable[[Refused, int], None]) -> None:
        self._tell = tell
        self.counts: Counter[str] = Counter()
        self.newest: Refused | None = None

    def add(self, refused: Refused, count: int = 1) -> None:
        """Take down one, or so many alike."""
        before = self.counts[refused.cause]
        self.counts[refused.cause] = after = before + count
        self.newest = refused
        if before.bit_length() != after.bit_length():
            self._tell(refused, after)
