"""Observations scaled by the mean and variance of a saved `VecNormalize` of Stable-Baselines3."""

from typing import Any

import numpy as np
from gymnasium import spaces

from outrider_learning.bounds import LARGEST, positive, table
from outrider_learning.transformation import Transformation
from sim.env.observation import AgentObservation, Array


class Standardized(Transformation):
    """Scaled array: (x - mean) / sqrt(variance + epsilon) by entry, clipped to ± clip.

    Args:
        mean: Mean of each entry: a list, or lists of lists as deep as the observation's shape.
        variance: Variance of each entry, with the same shape.
        epsilon: Constant added to the variance.
        clip: Largest magnitude of a result.

    Raises:
        ValueError: If a number is not finite, a variance is negative, the shapes differ, or `epsilon` or `clip` is not
            positive.
    """

    def __init__(self, *, mean: object, variance: object, epsilon: float, clip: float) -> None:
        self._mean = table("mean", mean, -LARGEST)
        self._variance = table("variance", variance, 0.0)
        self._epsilon, self._clip = positive("epsilon", epsilon), positive("clip", clip)
        if self._mean.shape != self._variance.shape:
            shapes = f"{self._mean.shape} and {self._variance.shape}"
            raise ValueError(f"mean and variance: of shapes {shapes}; allowed: equal ones")

    def settings(self) -> dict[str, Any]:
        """Return the arguments."""
        return {
            "mean": self._mean.tolist(),
            "variance": self._variance.tolist(),
            "epsilon": self._epsilon,
            "clip": self._clip,
        }

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space of the scaled array."""
        if not isinstance(space, spaces.Box) or space.shape != self._mean.shape:
            raise ValueError(
                f"Standardized: needs a Box of shape {self._mean.shape}, got {type(space).__name__} of {space.shape}"
            )
        return spaces.Box(-self._clip, self._clip, self._mean.shape, np.float32)

    def apply(self, observation: AgentObservation) -> AgentObservation:
        """Return the scaled array."""
        if isinstance(observation, dict):
            raise ValueError("Standardized: needs one array, got a dictionary")
        scaled = (observation - self._mean) / np.sqrt(self._variance + self._epsilon)
        shown: Array = np.clip(scaled, -self._clip, self._clip).astype(np.float32)
        return shown
