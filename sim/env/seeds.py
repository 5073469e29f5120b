"""Seeds of episodes."""

import numpy as np

from sim.engine.run_keys import check_seed


class Seeds:
    """Seeds of an environment's episodes.

    Args:
        first: Seed of the first episode, if `reset` gives none.

    Raises:
        ValueError: If the seed is not a whole number from 0 to 2**53 - 1.
    """

    def __init__(self, first: int) -> None:
        self.current = check_seed(first)
        """Seed of this episode."""
        self._given, self._since, self._started = self.current, 0, False

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

        Its seed is the given one, or derived from the last given seed and the number of episodes since.

        Raises:
            ValueError: If the seed is not a whole number from 0 to 2**53 - 1.
        """
        if seed is not None:
            self.current, self._since = check_seed(seed), 0
            self._given = self.current
        elif self._started:
            self._since += 1
            words = np.random.SeedSequence((self._given, self._since)).generate_state(1, np.uint64)
            self.current = int(words[0]) >> 11
        self._started = True
