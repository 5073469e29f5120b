"""One seed for each episode."""

import operator

import numpy as np


class Seeds:
    """The seeds of an environment's episodes.

    Args:
        first: Of the first episode, where `reset` gives none.
    """

    def __init__(self, first: int) -> None:
        self.current = first
        """The seed of this episode."""
        self._given, self._since, self._begun = first, 0, False

    @staticmethod
    def check(seed: int | None) -> None:
        """Refuse what is no seed.

        Raises:
            ValueError: If it is not a whole number from 0 to 2**53 - 1, nor None.
        """
        if seed is not None:
            _checked(seed)

    def begin(self, seed: int | None) -> None:
        """Go on to the next episode.

        With this seed, or with one that the last given seed and the number of episodes since fix.

        Raises:
            ValueError: If the seed is not a whole number from 0 to 2**53 - 1.
        """
        if seed is not None:
            self.current, self._since = _checked(seed), 0
            self._given = self.current
        elif self._begun:
            self._since += 1
            words = np.random.SeedSequence((self._given, self._since)).generate_state(1, np.uint64)
            self.current = int(words[0]) >> 11
        self._begun = True


def _checked(seed: int) -> int:
    try:
        whole = operator.index(seed)
    except TypeError:
        whole = -1
    if not 0 <= whole < 2**53:
        raise ValueError(f"seed = {seed!r}: must be a whole number from 0 to 2**53 - 1")
    return whole
