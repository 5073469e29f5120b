"""Arguments of a reset: seeds of episodes, and options."""

import secrets
from collections.abc import Mapping
from typing import Any

import numpy as np

from bus.messages.base import MAX_SEED
from sim.engine.run_keys import check_seed
from sim.input.faults import near


def check_options(options: Mapping[str, Any] | None, *allowed: str) -> None:
    """Check the options of a reset.

    Raises:
        ValueError: If they are not a mapping, or a key is not one of these.
    """
    rule = ", ".join(allowed) or "none"
    if not isinstance(options, Mapping | None):
        raise ValueError(f"options = {options!r}: not options; allowed: a dictionary with {rule}")
    for key in options or ():
        if key not in allowed:
            meant = near(str(key), allowed)
            raise ValueError(f"options[{key!r}]: unknown option{meant}; allowed: {rule}")


class Seeds:
    """Seeds of an environment's episodes.

    Without a given seed, the first one comes from the operating system, so that no two environments are the same.
    """

    def __init__(self) -> None:
        self._current: int | None = None
        self._given, self._since, self._started = 0, 0, False

    @property
    def current(self) -> int:
        """Seed of this episode; before the first episode, its seed if none is given."""
        if self._current is None:
            self._current = self._given = secrets.randbelow(MAX_SEED + 1)
        return self._current

    @staticmethod
    def check(seed: int | None) -> None:
        """Check a seed.

        Raises:
            ValueError: If it is not a whole number from 0 to 2**53 - 1, nor None.
        """
        if seed is not None:
            check_seed(seed)

    def begin(self, seed: int | None) -> None:
        """Start the next episode.

        Its seed is the given one. Without one, the first seed is drawn from the operating system, and a later one is
        derived from the last given or drawn seed and the number of episodes since.

        Raises:
            ValueError: If the seed is not a whole number from 0 to 2**53 - 1.
        """
        if seed is not None:
            self._current = self._given = check_seed(seed)
            self._since = 0
        elif self._started:
            self._since += 1
            words = np.random.SeedSequence((self._given, self._since)).generate_state(1, np.uint64)
            self._current = int(words[0]) >> 11
        else:
            _ = self.current  # draws it
        self._started = True
