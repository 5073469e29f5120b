"""Transformations of observations.

An observation is a row of `bus.observations`, or a dictionary of `row` and `coverage`; in a batch the worlds are
leading axes of every array. A transformation is bound to the space of a single observation by `space`, and may have a
memory of each world's episode: `begin` starts it, `apply` goes on by one tick.
"""

from abc import ABC, abstractmethod
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sim.env.observation import AgentObservation, Array

Mask = npt.NDArray[np.bool_]
"""One truth for each world, in the shape of the leading axes: () for one world."""
Channels = Literal["last", "first"]

ROW, COVERAGE = "row", "coverage"
"""The keys of an observation that is a dictionary."""


class Transformation(ABC):
    """The change to one vehicle's observations, in one world or in each of a batch.

    One object serves one environment.
    """

    def settings(self) -> dict[str, Any]:
        """The arguments that make another one like this, as JSON can hold them.

        Raises:
            ValueError: If there are none: it cannot be saved with a policy.
        """
        raise ValueError(
            f"{type(self).__name__} cannot be saved with a policy: it has no settings()"
        )

    @abstractmethod
    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The space of what comes out; to be called once, before anything else.

        Args:
            space: Of a single observation that goes in.

        Raises:
            ValueError: If the transformation does not fit it.
        """

    def action_space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The space of a single action that `action` takes, from that of the environment.

        Raises:
            ValueError: If the transformation does not fit it.
        """
        return space

    def begin(self, observation: AgentObservation, worlds: Mask) -> AgentObservation:
        """Begin an episode in these worlds with this observation; the memory of the others stays as it is.

        Args:
            observation: Of all worlds.
            worlds: Which of them begin.

        Returns:
            A new observation of all worlds.
        """
        return self.apply(observation)

    @abstractmethod
    def apply(self, observation: AgentObservation) -> AgentObservation:
        """The observation of the next tick, transformed: new arrays, inside the space."""

    def action(self, action: Any) -> Any:  # noqa: ANN401 - what is no action passes, and the environment refuses it
        """The environment's action for one that was chosen by the last observation. Shape (..., 2)."""
        return action


def the_box(space: spaces.Space[Any], what: str) -> spaces.Box:
    """The space, which must be a box.

    Raises:
        ValueError: If it is none; `what` says who needs it.
    """
    if not isinstance(space, spaces.Box):
        raise ValueError(f"{what} needs a Box, not {type(space).__name__}")
    return space


def one_line(space: spaces.Space[Any]) -> str:
    """A space in one line: NumPy writes bounds in several."""
    return f"{type(space).__name__}, shape {space.shape}, {space.dtype}"


def inside_box(values: Array, box: spaces.Box) -> Array:
    """The values in the box's type, brought into its bounds: what rounding has put outside."""
    inside: Array = np.clip(values.astype(box.dtype), box.low, box.high)
    return inside


class Part(ABC):
    """The change to one array of an observation."""

    box: spaces.Box
    """Of what comes out."""

    def begin(self, array: Array, worlds: Mask) -> Array:
        """As `Transformation.begin`."""
        return self.apply(array)

    @abstractmethod
    def apply(self, array: Array) -> Array:
        """As `Transformation.apply`."""


class EachArray(Transformation):
    """The same for the row and for the picture."""

    def __init__(self) -> None:
        self._parts: dict[str, Part] = {}

    @abstractmethod
    def _part(self, box: spaces.Box, *, picture: bool) -> Part:
        """Returns the change to an array of this space."""

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The space of what comes out, array by array."""
        what = type(self).__name__
        if isinstance(space, spaces.Dict):
            for key, part in space.spaces.items():
                self._parts[key] = self._part(
                    the_box(part, f"{what}: {key}"), picture=key == COVERAGE
                )
            return spaces.Dict({key: part.box for key, part in self._parts.items()})
        self._parts[ROW] = self._part(the_box(space, what), picture=False)
        return self._parts[ROW].box

    def begin(self, observation: AgentObservation, worlds: Mask) -> AgentObservation:
        """Begin an episode in these worlds, array by array."""
        if isinstance(observation, dict):
            return {key: part.begin(observation[key], worlds) for key, part in self._parts.items()}
        return self._parts[ROW].begin(observation, worlds)

    def apply(self, observation: AgentObservation) -> AgentObservation:
        """The observation of the next tick, array by array."""
        if isinstance(observation, dict):
            return {key: part.apply(observation[key]) for key, part in self._parts.items()}
        return self._parts[ROW].apply(observation)


def channel_axis(channels: Channels) -> int:
    """The place of the channel among the last three axes."""
    if channels not in {"last", "first"}:
        raise ValueError(f"channels = {channels!r}; allowed: 'last', 'first'")
    return -1 if channels == "last" else -3


def check_picture(space: spaces.Space[Any], what: str) -> spaces.Box:
    """The space, which must be that of the environment's own coverage.

    Raises:
        ValueError: If it is another; `what` says who needs it.
    """
    box = the_box(space, f"{what}: {COVERAGE}")
    plain = len(box.shape) == 2 and box.shape[0] == box.shape[1] and box.dtype.kind == "f"
    if not plain or np.any(box.low < 0.0) or np.any(box.high > 1.0):
        raise ValueError(
            f"{what} needs the environment's own coverage, a square of shares in [0, 1], not {one_line(box)}"
        )
    return box
