"""The presence of a party in a run, as a session follows it."""

import math
import time

from bus.session import Session


class Presence:
    """Follows whether a party has a session in a run."""

    def __init__(self, session: Session, name: str) -> None:
        self._places: set[int] = set()
        self._changed = time.monotonic()
        self.joined = -math.inf
        """Time at which a session of it came last [s]; none has: minus infinity."""
        session.watch(name, self._change)

    def _change(self, _name: str, place: int, present: bool) -> None:
        self._changed = time.monotonic()
        if present:
            self.joined = self._changed
            self._places.add(place)
        else:
            self._places.discard(place)

    @property
    def there(self) -> bool:
        """True if it has a session now."""
        return bool(self._places)

    def absent_for(self) -> float:
        """Time since it had one, or since it is followed [s]; 0: it is there."""
        return 0.0 if self._places else time.monotonic() - self._changed
