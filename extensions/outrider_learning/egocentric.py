"""Vehicle frame: rows, coverage pictures and actions rotated with the vehicle's heading."""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from gymnasium import spaces

from bus.messages.team import MOST_UAVS
from bus.observations import (
    ALTITUDE,
    GRADIENT,
    HEADING,
    UAV,
    UGV,
    Entry,
    Table,
    bounds,
    by_name,
    names,
    team_table,
    without,
)
from outrider_learning.transformation import Mask, Transformation
from sim.env.observation import AgentObservation, Array
from sim.env.spaces import box

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
"""Row of a UAV in its own frame: x ahead, y to the left. R is half the diagonal of the area."""
UGV_BODY: Table = (
    *_BODY,
    *(entry for entry in UGV if entry.name == "underway"),
    Entry("goal_x", "from the UGV to its goal, ahead; 0 if it is not underway", "m", "-D", "D"),
    Entry("goal_y", "the same, to the left", "m", "-D", "D"),
)
"""Row of a UGV in its own frame."""

_FURTHER = tuple(
    more + team_table(mates)
    for mates in range(MOST_UAVS + 1)
    for more in ((), ALTITUDE, GRADIENT, ALTITUDE + GRADIENT)
)
_OMITS = ((), ("time",), ("position",), ("time", "position"))
_LEFT_OUT = {"time": ("time",), "position": ("centre_x", "centre_y")}


def _body_without(table: Table, omit: Sequence[str]) -> Table:
    """Return the row in the vehicle frame if these parts are left out of the row in the world frame."""
    left_out = [name for part in omit for name in _LEFT_OUT[part]]
    return tuple(entry for entry in table if entry.name not in left_out)


_BODY_OF = (
    (UGV, UGV_BODY),
    (UGV + HEADING, UGV_BODY),
    *(
        (without(UAV + more, omit), _body_without(UAV_BODY + more, omit))
        for more in _FURTHER
        for omit in _OMITS
    ),
)
"""Rows in the world frame, and in the vehicle frame."""
_NEEDED = "Egocentric needs the row of a UAV or a UGV, in SI units, not {} of shape {}"


def _is_row(table: Table, space: spaces.Space[Any]) -> bool:
    """Return whether a space holds the rows of a table, by its shape and the signs of its bounds."""
    low = getattr(space, "low", None)
    if low is None or low.shape != (len(table),):
        return False
    return bool(np.all((low < 0.0) == [entry.low.startswith("-") for entry in table]))


class Egocentric(Transformation):
    """Vehicle frame: origin at the vehicle, x along its velocity, or its heading if it steers, y to the left.

    Below the speed `rest`, a vehicle that does not steer keeps its last heading; an episode starts with heading east.
    Rows become `UAV_BODY` or `UGV_BODY`. A gradient and relative positions that follow them are rotated, altitude,
    climb rate and the team's other entries are not. Actions are accelerations [m/s²] in this frame, by the heading of
    the last observation; with an altitude, a vertical one follows. The coverage picture is rotated: columns ahead, rows
    to the left, nearest sampling, 1 outside. The picture of the tiles is not rotated.

    Args:
        rest: Speed below which the heading is frozen [m/s].

    Raises:
        ValueError: If `rest` is not positive and finite.
    """

    def __init__(self, *, rest: float = 0.01) -> None:
        if not 0.0 < rest < np.inf:
            raise ValueError(f"rest = {rest!r}; must be positive and finite")
        self._rest = float(rest)
        self._heading: Array = np.empty((0, 2))

    def settings(self) -> dict[str, Any]:
        """Return the speed below which the heading is frozen."""
        return {"rest": self._rest}

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space of the row in the vehicle frame; pictures keep theirs."""
        if isinstance(space, spaces.Dict):
            return spaces.Dict({**space.spaces, "row": self._row_space(space["row"])})
        return self._row_space(space)

    def _row_space(self, space: spaces.Space[Any]) -> spaces.Box:
        found = next((both for both in _BODY_OF if _is_row(both[0], space)), None)
        if found is None:
            raise ValueError(_NEEDED.format(type(space).__name__, space.shape))
        self._table, self._body = found
        self._axes = 3 if "altitude" in names(self._table) else 2
        old = cast("spaces.Box", space)
        high = by_name(self._table, old.high.astype(np.float64))
        width, height = high.get("x", 0.0), high.get("y", 0.0)
        self._centre = 0.5 * width, 0.5 * height
        diagonal = float(np.hypot(width, height))
        extent = {"T": high.get("time", high.get("age", 0.0)), "v_max": high["vx"]}
        extent |= {"D": diagonal, "R": 0.5 * diagonal}
        extent["d_max"] = high.get("relative_x", diagonal)
        extent |= {"z_max": high.get("altitude", 0.0), "w_max": high.get("climb_rate", 0.0)}
        self._box = box(*bounds(self._body, extent), cast("Any", old.dtype).type)
        return self._box

    def begin(self, observation: AgentObservation, worlds: Mask) -> AgentObservation:
        """Reset the headings of these worlds to east, or along the velocity."""
        if len(self._heading) != len(worlds):
            self._heading = np.tile((1.0, 0.0), (len(worlds), 1))
        self._heading[worlds] = (1.0, 0.0)
        return self._shown(observation, worlds)

    def apply(self, observation: AgentObservation) -> AgentObservation:
        """Return the observation in the frame of this tick."""
        return self._shown(observation, np.ones(len(self._heading), dtype=np.bool_))

    def _shown(self, observation: AgentObservation, turning: Mask) -> AgentObservation:
        """Return the observation; where `turning`, update the heading from the velocity."""
        whole = observation if isinstance(observation, dict) else {"row": observation}
        old = by_name(self._table, whole["row"].astype(np.float64))
        velocity, speed = np.stack((old["vx"], old["vy"]), -1), np.hypot(old["vx"], old["vy"])
        if "heading_x" in old:  # a UGV that steers
            self._heading = np.stack((old["heading_x"], old["heading_y"]), -1)
        else:
            turning = turning & (speed >= self._rest)
            self._heading[turning] = velocity[turning] / speed[turning, None]
        row = self._row(old | {"speed": speed}).astype(self._box.dtype)
        row = np.clip(row, self._box.low, self._box.high)
        if not isinstance(observation, dict):
            return row
        shown = {key: array.copy() for key, array in observation.items()} | {"row": row}
        if "coverage" in shown:
            shown["coverage"] = _turned_picture(shown["coverage"], self._heading)
        return shown

    def _row(self, entries: dict[str, Array]) -> Array:
        """Return the rows from the entries by name. Shape (worlds, entries)."""
        cosine, sine = self._heading.T
        vectors = {
            name: (entries[f"{name}_x"], entries[f"{name}_y"])
            for name in ("relative", "gradient", "goal", "measured")
            if f"{name}_x" in entries
        }
        mates = [name for name in entries if name.startswith("mate_x_")]
        if "x" in entries:
            vectors["centre"] = self._centre[0] - entries["x"], self._centre[1] - entries["y"]
        if "goal" in vectors:
            x, y = vectors["goal"][0] - entries["x"], vectors["goal"][1] - entries["y"]
            vectors["goal"] = x * entries["underway"], y * entries["underway"]
        new = entries | {"heading_x": cosine, "heading_y": sine}
        for name, (x, y) in vectors.items():
            new[f"{name}_x"], new[f"{name}_y"] = cosine * x + sine * y, cosine * y - sine * x
        for name in mates:
            other = name.replace("_x_", "_y_")
            x, y = entries[name], entries[other]
            new[name], new[other] = cosine * x + sine * y, cosine * y - sine * x
        return np.stack([new[name] for name in names(self._body)], axis=-1)

    def action(self, action: Any) -> Any:  # noqa: ANN401 - see Transformation
        """Return the acceleration in the world frame; invalid actions pass unchanged."""
        body = np.asarray(action)
        wrong = body.ndim != 2 or len(body) != len(self._heading) or body.dtype.kind not in "fiu"
        if wrong or body.shape[1] not in (self._axes, self._axes + 1):  # the last: a request
            return action
        (ahead, left, *up), (cosine, sine) = body.T.astype(np.float64), self._heading.T
        return np.stack((cosine * ahead - sine * left, sine * ahead + cosine * left, *up), axis=-1)


def _turned_picture(picture: Array, heading: Array) -> Array:
    """Return the picture with columns ahead and rows to the left, by nearest sampling; 1 outside.

    Args:
        picture: Columns eastwards, rows northwards. Shape (worlds, pixels, pixels).
        heading: Cosine and sine. Shape (worlds, 2).
    """
    pixels = picture.shape[-1]
    middle = 0.5 * (pixels - 1)
    ahead, left = np.meshgrid(np.arange(pixels) - middle, np.arange(pixels) - middle)
    cosine, sine = heading[:, 0, None, None], heading[:, 1, None, None]
    column = np.rint(middle + cosine * ahead - sine * left).astype(np.intp)
    row = np.rint(middle + sine * ahead + cosine * left).astype(np.intp)
    inside = (column >= 0) & (column < pixels) & (row >= 0) & (row < pixels)
    worlds = np.arange(len(picture))[:, None, None]
    found = picture[worlds, np.where(inside, row, 0), np.where(inside, column, 0)]
    return np.where(inside, found, picture.dtype.type(1))
