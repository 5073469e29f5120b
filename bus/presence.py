"""Presence of a party in a run."""

import math
import time

from bus.session import Session


class Presence:
    """Tracks whether a party has a session in a run."""

    def __init__(self, session: Session, name: str) -> None:
        self._numbers: set[int] = set()
        self._changed = time.monotonic()
        self.joined = -math.inf
        """Time at which its latest session joined [s]; minus infinity before the first."""
        session.watch(name, self._change)

    def _change(self, _name: str, number: int, present: bool) -> None:
        self._changed = time.monotonic()
        if present:
            self.joined = self._changed
            self._numbers.add(number)
        else:
            self._numbers.discard(number)

    @property
    def there(self) -> bool:
        """True if the party has a session now."""
        return bool(self._numbers)

    def absent_for(self) -> float:
        """Return the time since its last session ended, or since tracking started [s]; 0 if it is present."""
        return 0.0 if self._numbers else time.monotonic() - self._changed
