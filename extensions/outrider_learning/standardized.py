"""Observations scaled by the mean and variance of a saved `VecNormalize` of Stable-Baselines3."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from outrider_learning.bounds import LARGEST, positive, row
from outrider_learning.transformation import Transformation
from sim.env.observation import AgentObservation, Array

_MOST_ENTRIES = 1 << 20


class Standardized(Transformation):
    """Scaled array: (x - mean) / sqrt(variance + epsilon) by entry, clipped to ± clip.

    Args:
        mean: Mean of each entry.
        variance: Variance of each entry.
        epsilon: Constant added to the variance.
        clip: Largest magnitude of a result.

    Raises:
        ValueError: If a number is not finite, a variance is negative, or `epsilon` or `clip` is not positive.
    """

    def __init__(
        self, *, mean: Sequence[float], variance: Sequence[float], epsilon: float, clip: float
    ) -> None:
        self._mean = row("mean", mean, -LARGEST, most=_MOST_ENTRIES)
        self._variance = row("variance", variance, 0.0, most=_MOST_ENTRIES)
        self._epsilon, self._clip = positive("epsilon", epsilon), positive("clip", clip)
        if len(self._mean) != len(self._variance):
            lengths = f"{len(self._mean)} and {len(self._variance)}"
            raise ValueError(f"mean and variance: {lengths} numbers; allowed: equally many")

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
