"""Messages that a bridge rejects, counted by cause."""

from collections import Counter
from collections.abc import Callable

_LONGEST = 300


class Refused(Exception):
    """Rejection of a message; as a string one printable line.

    Args:
        cause: Short text, the same for all rejections of one kind.
        what: Details of this message.
    """

    def __init__(self, cause: str, what: str) -> None:
        line = f"{cause}: {what}"[:_LONGEST]
        super().__init__("".join(one if one.isprintable() else "?" for one in line))
        self.cause, self.what = cause, what


class Refusals:
    """Counter of rejections; reports the 1st, 2nd, 4th, 8th ... of each cause, so that a flood cannot fill a log.

    Args:
        report: Called with the newest rejection and the number of rejections with its cause.
    """

    def __init__(self, report: Callable[[Refused, int], None]) -> None:
        self._report = report
        self.counts: Counter[str] = Counter()
        self.newest: Refused | None = None

    def add(self, refused: Refused, count: int = 1) -> None:
        """Count a rejection, or `count` rejections of one kind."""
        before = self.counts[refused.cause]
        self.counts[refused.cause] = after = before + count
        self.newest = refused
        if before.bit_length() != after.bit_length():
            self._report(refused, after)
