"""Stack of the last observations of each world; Gymnasium stacks single environments only."""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from outrider_learning.bounds import whole
from outrider_learning.transformation import Mask, Transformation
from sim.env.observation import AgentObservation, Array


class Stack(Transformation):
    """Last observations along a new axis, oldest first, like Gymnasium's `FrameStackObservation`.

    An episode starts with copies of its first observation.

    Args:
        length: Number of observations.

    Raises:
        ValueError: If `length` is not a whole number from 1 to 1000.
    """

    def __init__(self, length: int) -> None:
        self._length = whole("length", length, 1000)
        self._memory: dict[str, Array] = {}

    def settings(self) -> dict[str, Any]:
        """Return the length."""
        return {"length": self._length}

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space with a new first axis. Shape (length, ...)."""
        return batch_space(space, self._length)

    def begin(self, observation: AgentObservation, worlds: Mask) -> AgentObservation:
        """Fill the memory of these worlds with their first observation."""
        if worlds.all() or not self._memory:
            self._memory = {
                key: np.repeat(array[:, None], self._length, axis=1)
                for key, array in _arrays(observation).items()
            }
        for key, array in _arrays(observation).items():
            self._memory[key][worlds] = array[worlds][:, None]
        return self._stacked(observation)

    def apply(self, observation: AgentObservation) -> AgentObservation:
        """Add one observation in every world."""
        for key, array in _arrays(observation).items():
            memory = self._memory[key]
            memory[:, :-1] = memory[:, 1:].copy()
            memory[:, -1] = array
        return self._stacked(observation)

    def _stacked(self, observation: AgentObservation) -> AgentObservation:
        stacked = {key: memory.copy() for key, memory in self._memory.items()}
        return stacked if isinstance(observation, dict) else stacked[""]


def _arrays(observation: AgentObservation) -> dict[str, Array]:
    return observation if isinstance(observation, dict) else {"": observation}
