"""The last observations of each world together, since Gymnasium stacks those of one world only."""

import operator
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from outrider_learning.transformation import Mask, Transformation
from sim.env.observation import AgentObservation, Array


class Stack(Transformation):
    """The last observations along a new axis, the oldest first, as Gymnasium's `FrameStackObservation`.

    At the start of an episode the first observation takes the places of those before it.

    Args:
        length: Number of observations.

    Raises:
        ValueError: If `length` is no whole number from 1 on.
    """

    def __init__(self, length: int) -> None:
        try:
            self._length = operator.index(length)
        except TypeError:
            self._length = 0
        if self._length < 1:
            raise ValueError(f"length = {length!r}; must be a whole number from 1 on")
        self._memory: dict[str, Array] = {}

    def settings(self) -> dict[str, Any]:
        """Return the length."""
        return {"length": self._length}

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space with an axis more in front. Shape (length, ...)."""
        return batch_space(space, self._length)

    def begin(self, observation: AgentObservation, worlds: Mask) -> AgentObservation:
        """Fill the memory of these worlds."""
        if worlds.all() or not self._memory:
            self._memory = {
                key: np.repeat(array[:, None], self._length, axis=1)
                for key, array in _arrays(observation).items()
            }
        for key, array in _arrays(observation).items():
            self._memory[key][worlds] = array[worlds][:, None]
        return self._stacked(observation)

    def apply(self, observation: AgentObservation) -> AgentObservation:
        """Add an observation in every world."""
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
