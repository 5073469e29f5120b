"""The coverage picture as an image of bytes."""

from typing import Any

import numpy as np
from gymnasium import spaces

from outrider.envs.observations.transformation import (
    COVERAGE,
    Channels,
    Transformation,
    channel_axis,
    check_picture,
)
from sim.env.observation import AgentObservation


class CoverageImage(Transformation):
    """The coverage picture as an image of bytes, as networks for images take it: 0 unseen, 255 covered.

    A byte is 255 times the share, rounded to the nearest, halves upwards. Row 0 stays in the south. The number of
    pixels and their size are the environment's `coverage_patch`.

    Args:
        channels: Shape (pixels, pixels, 1) for "last", (1, pixels, pixels) for "first".
        only: Whether the row is dropped, and the image alone is the observation.

    Raises:
        ValueError: If `channels` is neither.
    """

    def __init__(self, *, channels: Channels = "last", only: bool = False) -> None:
        self._axis = channel_axis(channels)
        self._only = only

    def settings(self) -> dict[str, Any]:
        """The form of the image."""
        return {"channels": "last" if self._axis == -1 else "first", "only": self._only}

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The same dictionary with the image in the picture's place, or the image."""
        picture = space.spaces.get(COVERAGE) if isinstance(space, spaces.Dict) else None
        if not isinstance(space, spaces.Dict) or picture is None:
            raise ValueError(
                "CoverageImage needs an observation with 'coverage': make the environment with coverage_patch"
            )
        shape = check_picture(picture, "CoverageImage").shape
        image = spaces.Box(0, 255, (*shape, 1) if self._axis == -1 else (1, *shape), np.uint8)
        return image if self._only else spaces.Dict({**space.spaces, COVERAGE: image})

    def apply(self, observation: AgentObservation) -> AgentObservation:
        """The observation with the image."""
        if not isinstance(observation, dict):
            raise ValueError(
                "CoverageImage was bound to an observation with 'coverage', and this has none"
            )
        share = observation[COVERAGE].astype(np.float64)
        image = np.expand_dims(
            np.floor(255.0 * np.clip(share, 0.0, 1.0) + 0.5).astype(np.uint8), self._axis
        )
        return (
            image
            if self._only
            else {key: array.copy() for key, array in observation.items()} | {COVERAGE: image}
        )
