"""Observations scaled by a mean and a variance, as Stable-Baselines3's `VecNormalize` had them when it was saved."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from outrider_learning.transformation import Transformation
from sim.env.observation import AgentObservation, Array


class Standardized(Transformation):
    """One array, entry by entry (x - mean) / sqrt(variance + epsilon), cut to ± clip.

    Args:
        mean: Of each entry.
        variance: Of each entry.
        epsilon: Added to the variance.
        clip: Largest value that comes out.
    """

    def __init__(
        self, *, mean: Sequence[float], variance: Sequence[float], epsilon: float, clip: float
    ) -> None:
        self._mean, self._variance = np.asarray(mean), np.asarray(variance)
        self._epsilon, self._clip = epsilon, clip

    def settings(self) -> dict[str, Any]:
        """The arguments."""
        return {
            "mean": self._mean.tolist(),
            "variance": self._variance.tolist(),
            "epsilon": self._epsilon,
            "clip": self._clip,
        }

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The box of what comes out."""
        if not isinstance(space, spaces.Box) or space.shape != self._mean.shape:
            raise ValueError(
                f"Standardized: made for a Box of shape {self._mean.shape}, not {type(space).__name__} of {space.shape}"
            )
        return spaces.Box(-self._clip, self._clip, self._mean.shape, np.float32)

    def apply(self, observation: AgentObservation) -> AgentObservation:
        """The array scaled."""
        if isinstance(observation, dict):
            raise ValueError("Standardized takes one array, not a dictionary")
        scaled = (observation - self._mean) / np.sqrt(self._variance + self._epsilon)
        shown: Array = np.clip(scaled, -self._clip, self._clip).astype(np.float32)
        return shown
