"""Observations for learning: each transformation once, for one world and for a batch of worlds alike.

`outrider.wrappers` puts them around environments. An observation is a row of `bus.layout`, or a dictionary of `row` and
`coverage`; in a batch the worlds are leading axes of every array. A transformation is bound to the space of a single
observation by `space`, and may have a memory of each world's episode: `begin` starts it, `apply` goes on by one tick.
"""

from abc import ABC, abstractmethod
from typing import Annotated, Any, Literal, NamedTuple, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from bus.layout import SYMBOLS, Field, GradientCue, RowType, UavRow, UgvRow, bounds
from sim.env.actions import LARGEST

Array = npt.NDArray[Any]
Observation = Array | dict[str, Array]
Worlds = npt.NDArray[np.bool_]
"""One truth for each world, in the shape of the leading axes: () for one world."""
Channels = Literal["last", "first"]

ROW, COVERAGE = "row", "coverage"
"""The keys of an observation that is a dictionary."""


class Transformation(ABC):
    """What is done to one vehicle's observations, in one world or in each of a batch. One object serves one environment."""

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

    def begin(self, observation: Observation, worlds: Worlds) -> Observation:
        """Begin an episode in these worlds with this observation; the memory of the others stays as it is.

        Args:
            observation: Of all worlds.
            worlds: Which of them begin.

        Returns:
            A new observation of all worlds.
        """
        return self.apply(observation)

    @abstractmethod
    def apply(self, observation: Observation) -> Observation:
        """The observation of the next tick, transformed: new arrays, inside the space."""

    def action(self, action: Any) -> Any:  # noqa: ANN401 - what is no action passes, and the environment refuses it
        """The environment's action for one that was chosen by the last observation. Shape (..., 2)."""
        return action


def _the_box(space: spaces.Space[Any], what: str) -> spaces.Box:
    if not isinstance(space, spaces.Box):
        raise ValueError(f"{what} needs a Box, not {type(space).__name__}")
    return space


def _said(space: spaces.Space[Any]) -> str:
    """A space in one line: NumPy writes bounds in several."""
    return f"{type(space).__name__}, shape {space.shape}, {space.dtype}"


def _inside(values: Array, box: spaces.Box) -> Array:
    """The values in the box's type, brought into its bounds: what rounding has put outside."""
    inside: Array = np.clip(values.astype(box.dtype), box.low, box.high)
    return inside


class _Part(ABC):
    """What is done to one array of an observation."""

    box: spaces.Box
    """Of what comes out."""

    def begin(self, array: Array, worlds: Worlds) -> Array:
        """As `Transformation.begin`."""
        return self.apply(array)

    @abstractmethod
    def apply(self, array: Array) -> Array:
        """As `Transformation.apply`."""


class _EachArray(Transformation):
    """The same for the row and for the picture."""

    def __init__(self) -> None:
        self._parts: dict[str, _Part] = {}

    @abstractmethod
    def _part(self, box: spaces.Box, *, picture: bool) -> _Part:
        """What is to be done to an array of this space."""

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The space of what comes out, array by array."""
        what = type(self).__name__
        if isinstance(space, spaces.Dict):
            for key, part in space.spaces.items():
                self._parts[key] = self._part(_the_box(part, f"{what}: {key}"), picture=key == COVERAGE)
            return spaces.Dict({key: part.box for key, part in self._parts.items()})
        self._parts[ROW] = self._part(_the_box(space, what), picture=False)
        return self._parts[ROW].box

    def begin(self, observation: Observation, worlds: Worlds) -> Observation:
        """Begin an episode in these worlds, array by array."""
        if isinstance(observation, dict):
            return {key: part.begin(observation[key], worlds) for key, part in self._parts.items()}
        return self._parts[ROW].begin(observation, worlds)

    def apply(self, observation: Observation) -> Observation:
        """The observation of the next tick, array by array."""
        if isinstance(observation, dict):
            return {key: part.apply(observation[key]) for key, part in self._parts.items()}
        return self._parts[ROW].apply(observation)


class Normalized(_EachArray):
    r"""Every entry scaled by its bounds to [-1, 1].

    With both bounds, $y = (x - m) / h$ with their middle m and half their distance h, or 0 where they are the same. Without
    any, $y = x / (s + |x|)$: 0 at 0, ±1/2 at ±s, never beyond ±1. With one, the distance d from it, $y = d / (s + d)$ from 0
    to 1 brought to [-1, 1]. A coverage picture lies in [0, 1] already, and a picture of bytes is what networks for images
    take: both keep their values, and the first gets the type.

    Args:
        scale: s, half way to the end for entries without a bound [the entry's unit]: by default about r_v.
        dtype: Of what comes out, np.float32 or np.float64.

    Raises:
        ValueError: If the scale is not positive and finite, or the type is another.
    """

    def __init__(self, *, scale: float = 5.0, dtype: type[np.floating[Any]] = np.float32) -> None:
        super().__init__()
        if not 0.0 < scale < np.inf:
            raise ValueError(f"scale = {scale!r}; must be positive and finite")
        if dtype not in {np.float32, np.float64}:
            raise ValueError(f"dtype = {dtype!r}; allowed: np.float32, np.float64")
        self._scale, self._dtype = float(scale), dtype

    def _part(self, box: spaces.Box, *, picture: bool) -> _Part:
        if box.dtype.kind != "f":
            return _Cast(box, box.dtype.type)
        return _Cast(box, self._dtype) if picture else _Scale(box, self._scale, self._dtype)


class _Cast(_Part):
    """Another type, the same values."""

    def __init__(self, box: spaces.Box, dtype: type[np.generic]) -> None:
        self.box = spaces.Box(box.low.astype(dtype), box.high.astype(dtype), dtype=cast("Any", dtype))

    def apply(self, array: Array) -> Array:
        """The array in the type."""
        return _inside(array, self.box)


class _Scale(_Part):
    """The bounds to [-1, 1]."""

    def __init__(self, box: spaces.Box, scale: float, dtype: type[np.floating[Any]]) -> None:
        low, high = box.low.astype(np.float64), box.high.astype(np.float64)
        self._below, self._above = np.isfinite(low), np.isfinite(high)
        self._bounded = self._below & self._above
        self._open = ~(self._below | self._above)
        low, high = np.where(self._below, low, 0.0), np.where(self._above, high, 0.0)
        self._low, self._high = low, high
        self._middle, half = 0.5 * low + 0.5 * high, 0.5 * high - 0.5 * low
        self._per_half = np.divide(1.0, half, out=np.zeros_like(half), where=half > 0.0)
        self._s = scale
        self.box = spaces.Box(-1.0, 1.0, box.shape, dtype)

    def apply(self, array: Array) -> Array:
        """The array scaled."""
        x = array.astype(np.float64)
        y = (np.where(self._bounded, x, self._middle) - self._middle) * self._per_half
        if not self._bounded.all():
            from_bound = np.where(self._below, x - self._low, self._high - x)
            distance = np.where(self._open, np.abs(x), np.maximum(from_bound, 0.0))
            share = 1.0 - self._s / (self._s + distance)  # d / (s + d) that takes an infinite d
            one_sided = np.where(self._below, 2.0 * share - 1.0, 1.0 - 2.0 * share)
            y = np.where(self._bounded, y, np.where(self._open, np.copysign(share, x), one_sided))
        return _inside(y, self.box)


class CoverageImage(Transformation):
    """The coverage picture as an image of bytes, as networks for images take it: 0 unseen, 255 covered.

    A byte is 255 times the share, rounded to the nearest, halves upwards. Row 0 stays in the south. The number of pixels and
    their size are the environment's `coverage_patch`.

    Args:
        channels: Shape (pixels, pixels, 1) for "last", (1, pixels, pixels) for "first".
        only: Whether the row is dropped, and the image alone is the observation.

    Raises:
        ValueError: If `channels` is neither.
    """

    def __init__(self, *, channels: Channels = "last", only: bool = False) -> None:
        self._axis = _channel_axis(channels)
        self._only = only

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The same dictionary with the image in the picture's place, or the image."""
        picture = space.spaces.get(COVERAGE) if isinstance(space, spaces.Dict) else None
        if not isinstance(space, spaces.Dict) or picture is None:
            raise ValueError("CoverageImage needs an observation with 'coverage': make the environment with coverage_patch")
        shape = _check_picture(picture, "CoverageImage").shape
        image = spaces.Box(0, 255, (*shape, 1) if self._axis == -1 else (1, *shape), np.uint8)
        return image if self._only else spaces.Dict({**space.spaces, COVERAGE: image})

    def apply(self, observation: Observation) -> Observation:
        """The observation with the image."""
        if not isinstance(observation, dict):
            raise ValueError("CoverageImage was bound to an observation with 'coverage', and this has none")
        share = observation[COVERAGE].astype(np.float64)
        image = np.expand_dims(np.floor(255.0 * np.clip(share, 0.0, 1.0) + 0.5).astype(np.uint8), self._axis)
        return image if self._only else {key: array.copy() for key, array in observation.items()} | {COVERAGE: image}


def _channel_axis(channels: Channels) -> int:
    """Where the channel is among the last three axes."""
    if channels not in {"last", "first"}:
        raise ValueError(f"channels = {channels!r}; allowed: 'last', 'first'")
    return -1 if channels == "last" else -3


def _check_picture(space: spaces.Space[Any], what: str) -> spaces.Box:
    box = _the_box(space, f"{what}: {COVERAGE}")
    plain = len(box.shape) == 2 and box.shape[0] == box.shape[1] and box.dtype.kind == "f"
    if not plain or np.any(box.low < 0.0) or np.any(box.high > 1.0):
        raise ValueError(f"{what} needs the environment's own coverage, a square of shares in [0, 1], not {_said(box)}")
    return box


class History(_EachArray):
    """The last observations together, the oldest first; at the start of an episode the first one stands for those before it.

    Concatenated as SuperSuit's `frame_stack` does: rows (9,) to (length * 9,), pictures (pixels, pixels) to
    (pixels, pixels, length), images along their channels. With `new_axis` stacked along a new first axis (length, ...), as
    Gymnasium's `FrameStackObservation` does. (SuperSuit fills the start with zeros; this repeats, as Gymnasium does.)

    Args:
        length: How many observations.
        stride: Ticks between two of them.
        new_axis: Whether they are stacked instead of concatenated.
        channels: Which axis of pictures and images is the channel; "first": (length, pixels, pixels).

    Raises:
        ValueError: If `length` or `stride` is no whole number from 1 on, or `channels` is neither "last" nor "first".
    """

    def __init__(self, length: int, *, stride: int = 1, new_axis: bool = False, channels: Channels = "last") -> None:
        super().__init__()
        self._length, self._stride = _whole("length", length), _whole("stride", stride)
        self._new_axis = new_axis
        self._first = _channel_axis(channels) == -3

    def _part(self, box: spaces.Box, *, picture: bool) -> _Part:
        axes = len(box.shape)
        if not self._new_axis and not 1 <= axes <= 3:
            raise ValueError(f"History concatenates arrays of 1 to 3 axes, not {_said(box)}: use new_axis=True")
        # Pictures: after the rows and columns; images: before the channels.
        at = 0 if self._new_axis or self._first or axes == 1 else 2
        merge = not self._new_axis and axes != 2
        return _Frames(box, self._length, self._stride, at=at, merge=merge)


def _whole(name: str, value: Any) -> int:  # noqa: ANN401 - whatever was given
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise ValueError(f"{name} = {value!r}; must be a whole number from 1 on")
    return int(value)


class _Frames(_Part):
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
        self._memory = np.empty((0, *box.shape), dtype=box.dtype)  # a ring: (span, worlds..., shape...)
        self._now = 0
        low, high = (self._together(np.stack([bound] * length)) for bound in (box.low, box.high))
        self.box = spaces.Box(low, high, dtype=cast("Any", box.dtype.type))

    def _together(self, frames: Array) -> Array:
        """Shape (length, worlds..., shape...) to (worlds..., out...); a new array."""
        worlds = frames.shape[1 : frames.ndim - len(self._shape)]
        moved = np.moveaxis(frames, 0, len(worlds) + self._at)
        return np.ascontiguousarray(moved.reshape(*worlds, *self._out))

    def begin(self, array: Array, worlds: Worlds) -> Array:
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


BODY_SYMBOLS = SYMBOLS | {"R": "half the diagonal of the area [m]"}
"""What the names in the ranges of the rows below stand for."""


class UavBodyRow(NamedTuple):
    """A UAV's row in its own frame: x ahead, y to the left."""

    time: Annotated[float, Field("time since the start of the episode", "s", "0", "T")]
    speed: Annotated[float, Field("own speed", "m/s", "0", "v_max")]
    heading_x: Annotated[float, Field("own x axis in the world frame, x: cosine of the heading from east", "", "-1", "1")]
    heading_y: Annotated[float, Field("own x axis in the world frame, y: its sine", "", "-1", "1")]
    centre_x: Annotated[float, Field("from the UAV to the centre of the area, ahead", "m", "-R", "R")]
    centre_y: Annotated[float, Field("from the UAV to the centre of the area, to the left", "m", "-R", "R")]
    detected: Annotated[float, Field("1 where a detection has come at this tick, else 0", "", "0", "1")]
    relative_x: Annotated[float, Field("detected p_a - p_g, ahead; 0 where none has come", "m", "-d_max", "d_max")]
    relative_y: Annotated[float, Field("detected p_a - p_g, to the left; 0 where none has come", "m", "-d_max", "d_max")]
    age: Annotated[float, Field("time since the newest detection was taken; T before the first", "s", "0", "T")]


class UgvBodyRow(NamedTuple):
    """A UGV's row in its own frame: x ahead, y to the left."""

    time: Annotated[float, Field("time since the start of the episode", "s", "0", "T")]
    speed: Annotated[float, Field("own speed", "m/s", "0", "v_max")]
    heading_x: Annotated[float, Field("own x axis in the world frame, x: cosine of the heading from east", "", "-1", "1")]
    heading_y: Annotated[float, Field("own x axis in the world frame, y: its sine", "", "-1", "1")]
    centre_x: Annotated[float, Field("from the UGV to the centre of the area, ahead", "m", "-R", "R")]
    centre_y: Annotated[float, Field("from the UGV to the centre of the area, to the left", "m", "-R", "R")]
    underway: Annotated[float, Field("1 while a goal is still to be reached, else 0", "", "0", "1")]
    goal_x: Annotated[float, Field("from the UGV to its goal, ahead; 0 where it is not underway", "m", "-D", "D")]
    goal_y: Annotated[float, Field("from the UGV to its goal, to the left; 0 where it is not underway", "m", "-D", "D")]


class Egocentric(Transformation):
    """The vehicle's own frame: the origin at the vehicle, x along its velocity, y to the left.

    While it is slower than `rest` its last heading stays, at the start of an episode east. Rows become `UavBodyRow` and
    `UgvBodyRow`, a `GradientCue` behind them is turned. Actions are accelerations [m/s²] in this frame, by the heading of the
    last observation, and are turned into the world frame. The coverage picture turns along: columns ahead, rows to the left,
    each pixel the nearest one of the environment's picture, and 1 where that has none.

    A turned action keeps its length and may leave the square of the action space: the world shortens it to u_max, as always.

    Args:
        rest: Speed below which the heading stays [m/s].

    Raises:
        ValueError: If `rest` is not positive and finite.
    """

    def __init__(self, *, rest: float = 0.01) -> None:
        if not 0.0 < rest < np.inf:
            raise ValueError(f"rest = {rest!r}; must be positive and finite")
        self._rest = float(rest)
        self._heading: Array = np.empty((0, 2))

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The row in the vehicle's frame, and the picture as it was."""
        if isinstance(space, spaces.Dict):
            if COVERAGE in space.spaces:
                _check_picture(space.spaces[COVERAGE], "Egocentric")
            return spaces.Dict({**space.spaces, ROW: self._body(space.spaces.get(ROW, space))})
        return self._body(space)

    def _body(self, space: spaces.Space[Any]) -> spaces.Box:
        """Take in the row's space and give the new one."""
        entries = _entries(space)
        limits = dict(zip(entries, cast("spaces.Box", space).high.astype(np.float64).tolist(), strict=True))
        width, height = limits["x"], limits["y"]
        diagonal = float(np.hypot(width, height))
        self._fields, self._centre = entries, (0.5 * width, 0.5 * height)
        body = UgvBodyRow if entries == UgvRow._fields else UavBodyRow
        self._names: tuple[str, ...] = body._fields
        extent = {"T": limits["time"], "v_max": limits["vx"], "R": 0.5 * diagonal, "D": diagonal}
        extent["d_max"] = limits.get("relative_x", np.inf)
        low, high = bounds(cast("RowType", body), extent)
        if "gradient_x" in entries:
            least, largest = bounds(GradientCue, {})
            self._names, low, high = self._names + GradientCue._fields, low + least, high + largest
        dtype = cast("Any", space.dtype).type
        self._box = spaces.Box(np.array(low, dtype), np.array(high, dtype), dtype=dtype)
        return self._box

    def action_space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The same square, in the vehicle's frame."""
        if _the_box(space, "Egocentric").shape != (2,):
            raise ValueError(f"Egocentric needs accelerations of shape (2,), not {_said(space)}")
        return space

    def begin(self, observation: Observation, worlds: Worlds) -> Observation:
        """Let these worlds' vehicles look east, unless they move."""
        if self._heading.shape != (*worlds.shape, 2):
            self._heading = np.empty((*worlds.shape, 2))
            worlds = np.ones(worlds.shape, dtype=np.bool_)
        self._heading[worlds] = (1.0, 0.0)
        return self._seen(observation, worlds)

    def apply(self, observation: Observation) -> Observation:
        """The observation in the frame of this tick."""
        return self._seen(observation, np.ones(self._heading.shape[:-1], dtype=np.bool_))

    def _seen(self, observation: Observation, turning: Worlds) -> Observation:
        """The observation in the vehicles' frames; where `turning`, by their velocities of now."""
        whole = observation if isinstance(observation, dict) else {ROW: observation}
        entries = dict(zip(self._fields, np.moveaxis(whole[ROW].astype(np.float64), -1, 0), strict=True))
        speed = np.hypot(entries["vx"], entries["vy"])
        turning = turning & (speed >= self._rest)
        velocity = np.stack((entries["vx"], entries["vy"]), axis=-1)
        self._heading[turning] = velocity[turning] / speed[turning, None]
        row = _inside(self._in_body(entries, speed), self._box)
        if not isinstance(observation, dict):
            return row
        seen = {key: array.copy() for key, array in observation.items()} | {ROW: row}
        if COVERAGE in observation:
            seen[COVERAGE] = _turned_picture(observation[COVERAGE], self._heading)
        return seen

    def _in_body(self, entries: dict[str, Array], speed: Array) -> Array:
        """The new row of each world."""
        cosine, sine = self._heading[..., 0], self._heading[..., 1]
        new = entries | {"speed": speed, "heading_x": cosine, "heading_y": sine}

        def turn(name: str, x: Array, y: Array) -> None:
            new[f"{name}_x"], new[f"{name}_y"] = cosine * x + sine * y, cosine * y - sine * x

        def turn_if_there(name: str) -> None:
            if f"{name}_x" in entries:
                turn(name, entries[f"{name}_x"], entries[f"{name}_y"])

        turn("centre", self._centre[0] - entries["x"], self._centre[1] - entries["y"])
        turn_if_there("relative")
        turn_if_there("gradient")
        if "goal_x" in entries:
            underway = entries["underway"] > 0.0
            x, y = entries["goal_x"] - entries["x"], entries["goal_y"] - entries["y"]
            turn("goal", np.where(underway, x, 0.0), np.where(underway, y, 0.0))
        return np.stack([new[name] for name in self._names], axis=-1)

    def action(self, action: Any) -> Any:  # noqa: ANN401 - see Transformation
        """The acceleration in the world frame; what the environment would refuse passes as it is."""
        try:
            body = np.asarray(action)
        except (TypeError, ValueError):  # a ragged list
            return action
        if body.shape != self._heading.shape or body.dtype.kind not in "fiu":
            return action
        ahead, left = np.moveaxis(body.astype(np.float64), -1, 0)
        cosine, sine = self._heading[..., 0], self._heading[..., 1]
        good = (np.abs(ahead) <= LARGEST) & (np.abs(left) <= LARGEST)
        ahead, left = np.where(good, ahead, 0.0), np.where(good, left, 0.0)
        world = np.stack((cosine * ahead - sine * left, sine * ahead + cosine * left), axis=-1)
        # An action at the limit may be turned beyond it: it is shortened, since it was allowed.
        longest = np.abs(world).max(axis=-1, keepdims=True)
        world = np.clip(world * (LARGEST / np.maximum(longest, LARGEST)), -LARGEST, LARGEST)
        return np.where(good[..., None], world, body)


def _entries(space: spaces.Space[Any]) -> tuple[str, ...]:
    """The names of a row's entries, in order.

    Raises:
        ValueError: If it is no row in SI units and in the world frame.
    """
    rows: tuple[tuple[str, ...], ...] = (UavRow._fields, UavRow._fields + GradientCue._fields, UgvRow._fields)
    for row in rows:
        if isinstance(space, spaces.Box) and space.shape == (len(row),) and space.dtype.kind == "f":
            low, high = (dict(zip(row, bound.tolist(), strict=True)) for bound in (space.low, space.high))
            flag = "underway" if "underway" in row else "detected"
            zero = all(low[name] == 0.0 for name in ("time", "x", "y", flag))
            if zero and high[flag] == 1.0 and np.isfinite(high["x"]) and np.isfinite(high["y"]):
                return row
    raise ValueError(f"Egocentric needs a UAV's or a UGV's own row, before any other change, not {_said(space)}")


def _turned_picture(picture: Array, heading: Array) -> Array:
    """The picture with columns ahead and rows to the left, by nearest sampling; 1 outside.

    Args:
        picture: Columns eastwards, rows northwards; shape (..., pixels, pixels).
        heading: Cosine and sine; shape (..., 2).
    """
    pixels = picture.shape[-1]
    middle = 0.5 * (pixels - 1)
    offset = np.arange(pixels) - middle
    cosine, sine = heading[..., 0, None, None], heading[..., 1, None, None]
    ahead, left = offset[None, :], offset[:, None]
    column = np.rint(middle + cosine * ahead - sine * left).astype(np.intp)
    row = np.rint(middle + sine * ahead + cosine * left).astype(np.intp)
    inside = (column >= 0) & (column < pixels) & (row >= 0) & (row < pixels)
    where = np.where(inside, row * pixels + column, 0).reshape(*picture.shape[:-2], pixels * pixels)
    taken = np.take_along_axis(picture.reshape(where.shape), where, axis=-1).reshape(picture.shape)
    return np.where(inside, taken, picture.dtype.type(1))
