"""The vehicle's own frame: rows, pictures and actions turned with it."""

from typing import Any, cast

import numpy as np
from gymnasium import spaces

from bus.observations import GRADIENT, UAV, UGV, Entry, Table, bounds, names
from outrider.envs.observations.transformation import (
    COVERAGE,
    ROW,
    Mask,
    Transformation,
    check_picture,
    inside_box,
    one_line,
    the_box,
)
from sim.env.actions import LARGEST
from sim.env.observation import AgentObservation, Array

_BODY: Table = (
    Entry("time", "time since the start of the episode", "s", "0", "T"),
    Entry("speed", "own speed", "m/s", "0", "v_max"),
    Entry("heading_x", "own x axis in the world frame, x: cosine of the heading", "", "-1", "1"),
    Entry("heading_y", "own x axis in the world frame, y: its sine", "", "-1", "1"),
    Entry("centre_x", "from the vehicle to the centre of the area, ahead", "m", "-R", "R"),
    Entry("centre_y", "from the vehicle to the centre of the area, to the left", "m", "-R", "R"),
)
UAV_BODY: Table = (
    *_BODY,
    *(entry for entry in UAV if entry.name == "detected"),
    Entry("relative_x", "detected p_a - p_g, ahead; 0 without a detection", "m", "-d_max", "d_max"),
    Entry("relative_y", "the same, to the left", "m", "-d_max", "d_max"),
    *(entry for entry in UAV if entry.name == "age"),
)
"""A UAV's row in its own frame: x ahead, y to the left."""
UGV_BODY: Table = (
    *_BODY,
    *(entry for entry in UGV if entry.name == "underway"),
    Entry("goal_x", "from the UGV to its goal, ahead; 0 if it is not underway", "m", "-D", "D"),
    Entry("goal_y", "the same, to the left", "m", "-D", "D"),
)
"""A UGV's row in its own frame: x ahead, y to the left."""


class Egocentric(Transformation):
    """The vehicle's own frame: the origin at the vehicle, x along its velocity, y to the left.

    While it is slower than `rest` its last heading stays, at the start of an episode east. Rows become `UAV_BODY` and
    `UGV_BODY`, a gradient behind them is turned. Actions are accelerations [m/s²] in this frame, by the heading
    of the last observation, and are turned into the world frame. The coverage picture turns along: columns ahead, rows
    to the left, each pixel the nearest one of the environment's picture, and 1 where that has none.

    A turned action keeps its length and may leave the square of the action space: the world shortens it to u_max,
    as always.

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

    def settings(self) -> dict[str, Any]:
        """The speed below which the heading stays."""
        return {"rest": self._rest}

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The row in the vehicle's frame, and the picture as it was."""
        if isinstance(space, spaces.Dict):
            if COVERAGE in space.spaces:
                check_picture(space.spaces[COVERAGE], "Egocentric")
            return spaces.Dict({**space.spaces, ROW: self._body(space.spaces.get(ROW, space))})
        return self._body(space)

    def _body(self, space: spaces.Space[Any]) -> spaces.Box:
        """Take in the row's space and give the new one."""
        entries = _entries(space)
        limits = dict(
            zip(entries, cast("spaces.Box", space).high.astype(np.float64).tolist(), strict=True)
        )
        width, height = limits["x"], limits["y"]
        diagonal = float(np.hypot(width, height))
        self._fields, self._centre = entries, (0.5 * width, 0.5 * height)
        body = UGV_BODY if entries == names(UGV) else UAV_BODY
        self._names = names(body)
        extent = {"T": limits["time"], "v_max": limits["vx"], "R": 0.5 * diagonal, "D": diagonal}
        extent["d_max"] = limits.get("relative_x", np.inf)
        low, high = bounds(body, extent)
        if "gradient_x" in entries:
            least, largest = bounds(GRADIENT, {})
            self._names, low, high = self._names + names(GRADIENT), low + least, high + largest
        dtype = cast("Any", space.dtype).type
        self._box = spaces.Box(np.array(low, dtype), np.array(high, dtype), dtype=dtype)
        return self._box

    def action_space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """The same square, in the vehicle's frame."""
        if the_box(space, "Egocentric").shape != (2,):
            raise ValueError(f"Egocentric needs accelerations of shape (2,), not {one_line(space)}")
        return space

    def begin(self, observation: AgentObservation, worlds: Mask) -> AgentObservation:
        """Let these worlds' vehicles look east, unless they move."""
        if self._heading.shape != (*worlds.shape, 2):
            self._heading = np.empty((*worlds.shape, 2))
            worlds = np.ones(worlds.shape, dtype=np.bool_)
        self._heading[worlds] = (1.0, 0.0)
        return self._seen(observation, worlds)

    def apply(self, observation: AgentObservation) -> AgentObservation:
        """The observation in the frame of this tick."""
        return self._seen(observation, np.ones(self._heading.shape[:-1], dtype=np.bool_))

    def _seen(self, observation: AgentObservation, turning: Mask) -> AgentObservation:
        """The observation in the vehicles' frames; where `turning`, by their velocities of now."""
        whole = observation if isinstance(observation, dict) else {ROW: observation}
        entries = dict(
            zip(self._fields, np.moveaxis(whole[ROW].astype(np.float64), -1, 0), strict=True)
        )
        speed = np.hypot(entries["vx"], entries["vy"])
        turning = turning & (speed >= self._rest)
        velocity = np.stack((entries["vx"], entries["vy"]), axis=-1)
        self._heading[turning] = velocity[turning] / speed[turning, None]
        row = inside_box(self._in_body(entries, speed), self._box)
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
    for row in (names(UAV), names(UAV + GRADIENT), names(UGV)):
        if isinstance(space, spaces.Box) and space.shape == (len(row),) and space.dtype.kind == "f":
            low, high = (
                dict(zip(row, bound.tolist(), strict=True)) for bound in (space.low, space.high)
            )
            flag = "underway" if "underway" in row else "detected"
            zero = all(low[name] == 0.0 for name in ("time", "x", "y", flag))
            if zero and high[flag] == 1.0 and np.isfinite(high["x"]) and np.isfinite(high["y"]):
                return row
    raise ValueError(
        f"Egocentric needs a UAV's or a UGV's own row, before any other change, not {one_line(space)}"
    )


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
