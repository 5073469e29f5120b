"""Observation and action of the learned UAV: coverage around its UGV and a velocity, in the escort frame."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from bus.observations import UAV, by_name, names
from outrider_learning.bounds import SMALLEST, positive, row, whole
from outrider_learning.transformation import Mask, Transformation
from sim.env.observation import AgentObservation, Array

_V_X = names(UAV).index("vx")
_LARGEST = 5.0
"""Largest magnitude of an entry; larger ones are clipped."""
_NEAR = 1e-6
"""Relative distance [m] below which the frame keeps its last direction."""


class EscortView(Transformation):
    """Escort frame: x axis from the UGV to the UAV, by the estimate; east before the first estimate.

    An observation is one array: detection flag; distance over `scale`; own velocity over v_max; the UGV's velocity over
    v_max, from two estimates `lag` steps apart; and 1 - min(C / C*, 1) on rings around the UGV. The rings follow each
    other, counter-clockwise from the UAV, interpolated in the coverage patch.

    An action is the velocity one step later, over v_max. It is converted to the acceleration that reaches it, which
    the world limits to u_max.

    Args:
        step: Time between two observations [s].
        v_max: Maximum speed of the UAV [m/s].
        pixel: Pixel size of the coverage patch [m].
        rings: Radii of the rings [m].
        sectors: Points on each ring.
        lag: Steps between the two estimates.
        scale: Unit of the distance [m].

    Raises:
        ValueError: If an argument is not positive, or too large.
    """

    def __init__(
        self,
        *,
        step: float,
        v_max: float,
        pixel: float,
        rings: Sequence[float],
        sectors: int,
        lag: int,
        scale: float = 5.0,
    ) -> None:
        self._step, self._pixel = positive("step", step), positive("pixel", pixel)
        self._v_max, self._scale = positive("v_max", v_max), positive("scale", scale)
        self._lag, self._sectors = whole("lag", lag, 1000), whole("sectors", sectors, 1024)
        self._rings = row("rings", rings, SMALLEST, most=64)
        angles = 2.0 * np.pi * np.arange(self._sectors) / self._sectors
        radii = np.repeat(self._rings, self._sectors)
        self._points = (
            radii * np.tile(np.cos(angles), len(self._rings)),
            radii * np.tile(np.sin(angles), len(self._rings)),
        )
        self._track: Array = np.empty((0, 2))
        self._axis: Array = np.empty((0, 2))
        self._velocity: Array = np.empty((0, 2))
        self._known: Array = np.empty(0)

    def settings(self) -> dict[str, Any]:
        """Return the arguments."""
        return {
            "step": self._step,
            "v_max": self._v_max,
            "pixel": self._pixel,
            "rings": self._rings.tolist(),
            "sectors": self._sectors,
            "lag": self._lag,
            "scale": self._scale,
        }

    @property
    def size(self) -> int:
        """Return the number of entries."""
        return 6 + len(self._points[0])

    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space of the array."""
        row = space.spaces.get("row") if isinstance(space, spaces.Dict) else None
        picture = space.spaces.get("coverage") if isinstance(space, spaces.Dict) else None
        if not isinstance(row, spaces.Box) or row.shape != (len(UAV),) or picture is None:
            raise ValueError(f"EscortView needs a UAV's row and a coverage patch, got {space}")
        if not np.isclose(row.high[_V_X], self._v_max):
            raise ValueError(
                f"v_max = {row.high[_V_X]:g} m/s: EscortView was created with {self._v_max:g} m/s"
            )
        return spaces.Box(-_LARGEST, _LARGEST, (self.size,), np.float32)

    def action_space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space of velocities over v_max."""
        return spaces.Box(-1.0, 1.0, (2,), np.float32)

    def begin(self, observation: AgentObservation, worlds: Mask) -> Array:
        """Start an episode in these worlds."""
        if self._known.shape != worlds.shape:
            self._known = np.zeros(worlds.shape, dtype=np.bool_)
            self._track = np.zeros((self._lag + 1, *worlds.shape, 2))
            self._axis, self._velocity = np.zeros((*worlds.shape, 2)), np.zeros((*worlds.shape, 2))
            worlds = np.ones(worlds.shape, dtype=np.bool_)
        self._known[worlds] = False
        self._axis[worlds] = (1.0, 0.0)
        return self.update(observation, worlds)

    def apply(self, observation: AgentObservation) -> Array:
        """Return the observation of the next step."""
        return self.update(observation, np.ones(self._known.shape, dtype=np.bool_))

    def update(self, observation: AgentObservation, moving: Mask) -> Array:
        """Return the array of all worlds; only the worlds in `moving` advance by a step."""
        if not isinstance(observation, dict):
            raise ValueError("EscortView needs the row and the coverage patch")
        row = by_name(UAV, observation["row"].astype(np.float64))
        detected = row["detected"] > 0.0
        relative = np.stack((row["relative_x"], row["relative_y"]), axis=-1)
        position = np.stack((row["x"], row["y"]), axis=-1) - relative
        distance = np.sqrt(relative[..., 0] ** 2 + relative[..., 1] ** 2)
        turning = moving & (distance > _NEAR)
        self._axis[turning] = relative[turning] / distance[turning, None]
        self._track[:-1, moving] = self._track[1:, moving]
        self._track[-1, moving] = position[moving]
        first = moving & ~(self._known & detected)
        self._track[:, first] = position[first]
        self._known[moving] = detected[moving]
        self._velocity[moving] = np.stack((row["vx"], row["vy"]), axis=-1)[moving]

        ugv = (self._track[-1] - self._track[0]) / (self._lag * self._step)
        entries = [
            row["detected"][..., None],
            distance[..., None] / self._scale,
            self._turned(self._velocity) / self._v_max,
            self._turned(ugv) / self._v_max,
            self._lack(observation["coverage"], relative),
        ]
        shown: Array = np.clip(np.concatenate(entries, axis=-1), -_LARGEST, _LARGEST).astype(
            np.float32
        )
        return shown

    def _turned(self, vector: Array) -> Array:
        """Rotate a vector from the world frame to the escort frame."""
        c, s = self._axis[..., 0], self._axis[..., 1]
        x, y = vector[..., 0], vector[..., 1]
        return np.stack((c * x + s * y, c * y - s * x), axis=-1)

    def _lack(self, picture: Array, relative: Array) -> Array:
        """Return 1 - min(C / C*, 1) on the rings. Shape (..., points)."""
        c, s = self._axis[..., 0, None], self._axis[..., 1, None]
        ahead, left = self._points
        pixels = picture.shape[-1]
        middle = 0.5 * (pixels - 1)
        column = middle + (c * ahead - s * left - relative[..., 0, None]) / self._pixel
        row = middle + (s * ahead + c * left - relative[..., 1, None]) / self._pixel
        column, row = np.clip(column, 0.0, pixels - 1.001), np.clip(row, 0.0, pixels - 1.001)
        i, j = column.astype(np.intp), row.astype(np.intp)
        a, b = column - i, row - j
        flat = picture.reshape(*picture.shape[:-2], pixels * pixels).astype(np.float64)

        def at(rows: Array, columns: Array) -> Array:
            return np.take_along_axis(flat, rows * pixels + columns, axis=-1)

        low = (1.0 - a) * at(j, i) + a * at(j, i + 1)
        high = (1.0 - a) * at(j + 1, i) + a * at(j + 1, i + 1)
        lack: Array = 1.0 - ((1.0 - b) * low + b * high)
        return lack

    def action(self, action: Any) -> Any:  # noqa: ANN401 - the environment rejects invalid actions
        """Return the acceleration [m/s²] for a velocity, by the last observation."""
        wanted = np.asarray(action, dtype=np.float64)
        if wanted.shape != self._velocity.shape:
            return action
        size = np.sqrt(wanted[..., 0] ** 2 + wanted[..., 1] ** 2)[..., None]
        wanted = self._v_max * wanted / np.maximum(size, 1.0)
        c, s = self._axis[..., 0], self._axis[..., 1]
        x, y = wanted[..., 0], wanted[..., 1]
        return (np.stack((c * x - s * y, s * x + c * y), axis=-1) - self._velocity) / self._step
