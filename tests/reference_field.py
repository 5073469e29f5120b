"""Reference implementation of `sim.models.field`: the paper's equations in NumPy on the whole grid, with masks."""

import numpy as np
import numpy.typing as npt

from bus.registry import SENSORS

HILL, PLATEAU = (tuple(SENSORS).index(name) for name in ("hill", "plateau"))

FloatGrid = npt.NDArray[np.float64]

_QUALITY = {
    HILL: lambda rho, peak, r: peak / r**4 * (rho**2 - r**2) ** 2,
    PLATEAU: lambda rho, peak, r: peak * (1.0 - rho**4 / r**4) ** 2,
}
_SLOPE = {  # dS/d(rho²)
    HILL: lambda rho, peak, r: 2.0 * peak / r**4 * (rho**2 - r**2),
    PLATEAU: lambda rho, peak, r: -4.0 * peak * rho**2 / r**4 * (1.0 - rho**4 / r**4),
}


def centres(coverage: FloatGrid, cell: float) -> tuple[FloatGrid, FloatGrid]:
    """Return x and y of the cell centres [m], each in the shape of the grid."""
    rows, columns = coverage.shape
    x, y = np.meshgrid((np.arange(columns) + 0.5) * cell, (np.arange(rows) + 0.5) * cell)
    return x, y


def distances(coverage: FloatGrid, p_x: float, p_y: float, cell: float) -> FloatGrid:
    """Return the distance of each cell centre from a point [m]."""
    x, y = centres(coverage, cell)
    return np.sqrt((x - p_x) ** 2 + (y - p_y) ** 2)


def sensor_quality(sensor: int, rho: FloatGrid, peak: float, r: float) -> FloatGrid:
    """Return S of (2) at the distances rho [m]."""
    return np.where(rho <= r, _QUALITY[sensor](rho, peak, r), 0.0)


def density(rho: FloatGrid, r_o: float) -> FloatGrid:
    """Return phi of (9) at the distances rho [m]."""
    return np.where(rho <= r_o, np.cos(rho / r_o * np.pi) + 1.0, 0.0)


def accumulate(
    coverage: FloatGrid,
    p_x: float,
    p_y: float,
    sensor: int,
    peak: float,
    r: float,
    cell: float,
    duration: float,
) -> FloatGrid:
    """Return C after one sensing step, (3); arguments as in `sim.models.field.accumulate`, but C is not changed."""
    return (
        coverage + sensor_quality(sensor, distances(coverage, p_x, p_y, cell), peak, r) * duration
    )


def coverage_error(
    coverage: FloatGrid, p_gx: float, p_gy: float, r_o: float, desired: float, cell: float
) -> float:
    """Return e(t) [m²], (4); arguments as in `sim.models.field.coverage_error`."""
    phi = density(distances(coverage, p_gx, p_gy, cell), r_o)
    return float((np.maximum(0.0, desired - coverage) ** 2 * phi).sum() * cell**2)


def coverage_gradient(
    coverage: FloatGrid,
    p_ax: float,
    p_ay: float,
    p_gx: float,
    p_gy: float,
    r_o: float,
    desired: float,
    sensor: int,
    peak: float,
    r: float,
    cell: float,
) -> tuple[float, float]:
    """Return u_cov with k = 1, (6); arguments as in `sim.models.field.coverage_gradient`."""
    x, y = centres(coverage, cell)
    rho = distances(coverage, p_ax, p_ay, cell)
    slope = np.where(rho <= r, 2.0 * _SLOPE[sensor](rho, peak, r), 0.0)
    lack = 2.0 * np.maximum(0.0, desired - coverage)
    weight = lack * slope * density(distances(coverage, p_gx, p_gy, cell), r_o)
    return float((weight * (p_ax - x)).sum() * cell**2), float(
        (weight * (p_ay - y)).sum() * cell**2
    )
