"""Every entry scaled by its bounds."""

from typing import Any, cast

import numpy as np
from gymnasium import spaces

from outrider.envs.observations.transformation import EachArray, Part, inside_box
from sim.env.observation import Array
from sim.env.spaces import check_dtype


class Normalized(EachArray):
    r"""Every entry scaled by its bounds to [-1, 1].

    With both bounds, $y = (x - m) / h$ with their middle m and half their distance h, or 0 where they are the same.
    Without any, $y = x / (s + |x|)$: 0 at 0, ±1/2 at ±s, never beyond ±1. With one, the distance d from it, $y = d / (s
    + d)$ from 0 to 1 brought to [-1, 1]. A coverage picture lies in [0, 1] already, and a picture of bytes is what
    networks for images take: both keep their values, and the first gets the type.

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
        check_dtype(dtype)
        self._scale, self._dtype = float(scale), dtype

    def settings(self) -> dict[str, Any]:
        """Scale and type."""
        return {"scale": self._scale, "dtype": np.dtype(self._dtype).name}

    def _part(self, box: spaces.Box, *, picture: bool) -> Part:
        if box.dtype.kind != "f":
            return _Cast(box, box.dtype.type)
        return _Cast(box, self._dtype) if picture else _Scale(box, self._scale, self._dtype)


class _Cast(Part):
    """Another type, the same values."""

    def __init__(self, box: spaces.Box, dtype: type[np.generic]) -> None:
        self.box = spaces.Box(
            box.low.astype(dtype), box.high.astype(dtype), dtype=cast("Any", dtype)
        )

    def apply(self, array: Array) -> Array:
        """The array in the type."""
        return inside_box(array, self.box)


class _Scale(Part):
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
        return inside_box(y, self.box)
