"""The field's kernels once more, slow and plain: whole grids and masks in NumPy.

The tests hold the compiled kernels against it, and `outrider bench` measures against it. Arguments and units are those of
`sim.field`.
"""

import numpy as np
import numpy.typing as npt

from sim.compile import FloatArray
from sim.field import PLATEAU

_Bools = npt.NDArray[np.bool_]


def _squared_distance(shape: tuple[int, ...], x: float, y: float, cell: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Offsets of all cell centres from a point, and their squared length, each of the grid's shape."""
    rows, columns = shape
    d_x, d_y = np.meshgrid((np.arange(columns) + 0.5) * cell - x, (np.arange(rows) + 0.5) * cell - y)
    return d_x, d_y, d_x**2 + d_y**2


def quality(sensor: int, rho2: FloatArray, peak: float, reach: float) -> FloatArray:
    """(2), and the second sensor."""
    inside: _Bools = rho2 <= reach**2
    share = (rho2 / reach**2) ** 2 if sensor == PLATEAU else rho2 / reach**2
    return np.where(inside, peak * (share - 1.0) ** 2, 0.0)


def slope(sensor: int, rho2: FloatArray, peak: float, reach: float) -> FloatArray:
    """dS/d(rho²)."""
    inside: _Bools = rho2 <= reach**2
    if sensor == PLATEAU:
        return np.where(inside, 4.0 * peak / reach**4 * rho2 * ((rho2 / reach**2) ** 2 - 1.0), 0.0)
    return np.where(inside, 2.0 * peak / reach**4 * (rho2 - reach**2), 0.0)


def density(rho2: FloatArray, r_o: float) -> FloatArray:
    """(9) as it is printed."""
    return np.where(rho2 <= r_o**2, np.cos(np.pi * np.sqrt(rho2) / r_o) + 1.0, 0.0)


def accumulate(
    coverage: FloatArray, p_x: float, p_y: float, sensor: int, peak: float, reach: float, cell: float, duration: float
) -> None:
    """(3)."""
    coverage += quality(sensor, _squared_distance(coverage.shape, p_x, p_y, cell)[2], peak, reach) * duration


def coverage_error(coverage: FloatArray, p_gx: float, p_gy: float, r_o: float, desired: float, cell: float) -> float:
    """(4)."""
    weight = density(_squared_distance(coverage.shape, p_gx, p_gy, cell)[2], r_o)
    return float((np.maximum(0.0, desired - coverage) ** 2 * weight).sum() * cell**2)


def coverage_gradient(
    coverage: FloatArray,
    p_ax: float,
    p_ay: float,
    p_gx: float,
    p_gy: float,
    r_o: float,
    desired: float,
    sensor: int,
    peak: float,
    reach: float,
    cell: float,
) -> tuple[float, float]:
    """(6) with k = 1."""
    d_x, d_y, rho2 = _squared_distance(coverage.shape, p_ax, p_ay, cell)
    weight = density(_squared_distance(coverage.shape, p_gx, p_gy, cell)[2], r_o)
    terms = 2.0 * np.maximum(0.0, desired - coverage) * 2.0 * slope(sensor, rho2, peak, reach) * weight * cell**2
    return float((terms * -d_x).sum()), float((terms * -d_y).sum())
