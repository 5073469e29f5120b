"""The last observations together."""

from typing import Any, cast

import numpy as np
from gymnasium import spaces

from outrider.envs.observations.transformation import (
    Channels,
    EachArray,
    Mask,
    Part,
    channel_axis,
    one_line,
)
from sim.env.observation import Array


class History(EachArray):
    """The last observations together, the oldest first.

    At the start of an episode the first one stands for those before it.

    Concatenated as SuperSuit's `frame_stack` does: rows (9,) to (length * 9,), pictures (pixels, pixels) to (pixels,
    pixels, length), images along their channels. With `new_axis` stacked along a new first axis (length, ...), as
    Gymnasium's `FrameStackObservation` does. (SuperSuit fills the start with zeros; this repeats, as Gymnasium does.)

    Args:
        length: How many observations.
        stride: Ticks between two of them.
        new_axis: Whether they are stacked instead of concatenated.
        channels: Which axis of pictures and images is the channel; "first": (length, pixels, pixels).

    Raises:
        ValueError: If `length` or `stride` is no whole number from 1 on, or `channels` is neither "last" nor "first".
    """

    def __init__(
        self, length: int, *, stride: int = 1, new_axis: bool = False, channels: Channels = "last"
    ) -> None:
        super().__init__()
        self._length, self._stride = _whole("length", length), _whole("stride", stride)
        self._new_axis = new_axis
        self._first = channel_axis(channels) == -3

    def settings(self) -> dict[str, Any]:
        """Length, stride, and the form."""
        return {
            "length": self._length,
            "stride": self._stride,
            "new_axis": self._new_axis,
            "channels": "first" if self._first else "last",
        }

    def _part(self, box: spaces.Box, *, picture: bool) -> Part:
        axes = len(box.shape)
        if not self._new_axis and not 1 <= axes <= 3:
            raise ValueError(
                f"History concatenates arrays of 1 to 3 axes, not {one_line(box)}: use new_axis=True"
            )
        # Pictures: after the rows and columns; images: before the channels.
        at = 0 if self._new_axis or self._first or axes == 1 else 2
        merge = not self._new_axis and axes != 2
        return _Frames(box, self._length, self._stride, at=at, merge=merge)


def _whole(name: str, value: Any) -> int:  # noqa: ANN401 - whatever was given
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise ValueError(f"{name} = {value!r}; must be a whole number from 1 on")
    return int(value)


class _Frames(Part):
    """A memory of one array's last values.

    Args:
        box: Of the array.
        length: How many come out.
        stride: Ticks between two of them.
        at: The axis of a single array before which their axis is put.
        merge: Whether the two become one.
    """

    def __init__(self, box: spaces.Box, length: int, stride: int, *, at: int, merge: bool) -> None:
        self._shape, self._at = box.shape, at
        self._out = (*box.shape[:at], length, *box.shape[at:])
        if merge:
            self._out = (*box.shape[:at], length * box.shape[at], *box.shape[at + 1 :])
        self._span = (length - 1) * stride + 1
        self._back = stride * np.arange(length - 1, -1, -1)
        # a ring: (span, worlds..., shape...)
        self._memory = np.empty((0, *box.shape), dtype=box.dtype)
        self._now = 0
        low, high = (self._together(np.stack([bound] * length)) for bound in (box.low, box.high))
        self.box = spaces.Box(low, high, dtype=cast("Any", box.dtype.type))

    def _together(self, frames: Array) -> Array:
        """Shape (length, worlds..., shape...) to (worlds..., out...); a new array."""
        worlds = frames.shape[1 : frames.ndim - len(self._shape)]
        moved = np.moveaxis(frames, 0, len(worlds) + self._at)
        return np.ascontiguousarray(moved.reshape(*worlds, *self._out))

    def begin(self, array: Array, worlds: Mask) -> Array:
        """Forget these worlds."""
        if self._memory.shape[1:] != array.shape or not self._memory.size:
            self._memory = np.empty((self._span, *array.shape), dtype=self._memory.dtype)
            worlds = np.ones(array.shape[: array.ndim - len(self._shape)], dtype=np.bool_)
        self._memory[:, worlds] = array[worlds]
        return self._seen()

    def apply(self, array: Array) -> Array:
        """Remember the array."""
        self._now = (self._now + 1) % self._span
        self._memory[self._now] = array
        return self._seen()

    def _seen(self) -> Array:
        return self._together(self._memory[(self._now - self._back) % self._span])
