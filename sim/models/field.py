r"""Coverage field on a grid: sensor (2), accumulation (3), error (4), density (9) and the integral of (6).

The grid's cells are squares with centers at (i + ½)·cell; arrays are [row, column], row 0 at y = 0. The kernels visit
the rows that a disc meets and, in each, the chord. Sums use a row buffer and a fixed number of lanes, so that the bits
depend neither on the caller nor on the compiler's loop order.
"""

from typing import NamedTuple

import numpy as np

from sim.compiling.compile import FloatArray, compiled
from sim.compiling.lanes import LANES, lane_sum, widened
from sim.models.grid import disc_chords
from sim.models.sensor import SensorParameters, sensor_quality, sensor_slope
from sim.models.shadows import Occlusion, cast_shadow


class Demand(NamedTuple):
    """Demand for coverage around a UGV: weight and desired value of the coverage error (4)."""

    p_x: float
    p_y: float
    """Position of the UGV [m]."""
    r_o: float
    """Radius of the density (9) [m]."""
    desired: float
    """C*."""


@compiled
def penalty(lack: float) -> float:
    r"""Return the penalty $h(x) = \max(0, x)^2$ of (4)."""
    return lack * lack if lack > 0.0 else 0.0


@compiled
def penalty_slope(lack: float) -> float:
    r"""Return $h'(x) = 2 \max(0, x)$ of (6)."""
    return 2.0 * lack if lack > 0.0 else 0.0


@compiled
def density(rho2: float, r_o: float) -> float:
    r"""Return the density at squared distance $\rho^2$ from the UGV, Klodt 2015, eq. (9).

    $$ \phi = \cos(\pi \rho / r_o) + 1 \text{ inside } r_o, \quad 0 \text{ outside} $$

    Computed as $(1 - s)^2 g(s)$ with $s = (\rho/r_o)^2$ and g a polynomial (Chebyshev interpolation on [0, 1]): no
    cosine, no root, never negative, and within 2e-13 of the formula.

    Args:
        rho2: Squared distance from the UGV [m²].
        r_o: Radius r_v + r, the farthest ground that the UAV can observe while the UGV is visible [m].
    """
    s = rho2 / (r_o * r_o)
    rest = 1.0 - s if s < 1.0 else 0.0
    g = -1.1866978791794382e-07
    g = g * s + 4.015015824839582e-06
    g = g * s - 9.641667903338588e-05
    g = g * s + 1.7326615035514177e-03
    g = g * s - 2.2245115569201e-02
    g = g * s + 1.8910772506711293e-01
    g = g * s - 9.34802200532295e-01
    g = g * s + 1.9999999999999032
    return rest * rest * g


@compiled
def _in_registers(sensor: SensorParameters) -> SensorParameters:
    """Return a copy of the parameters, so that a loop that writes does not reload them for each cell."""
    return SensorParameters(sensor.model, sensor.peak, sensor.sensing_range)


@compiled
def _accumulate_row(
    cells: FloatArray,
    first: int,
    p_x: float,
    d_y: float,
    sensor: SensorParameters,
    cell: float,
    duration: float,
) -> None:
    """Add the coverage of the cells of a row, from column `first` on, at the distance d_y from the sensor [m]."""
    for i in range(cells.size):
        d_x = (first + i + 0.5) * cell - p_x
        cells[i] += sensor_quality(sensor, d_x * d_x + d_y * d_y) * duration


@compiled
def accumulate(
    coverage: FloatArray,
    p_x: float,
    p_y: float,
    sensor: SensorParameters,
    cell: float,
    duration: float,
    occlusion: Occlusion | None = None,
) -> None:
    r"""Add the coverage by a sensor at one position, Klodt 2015, eq. (3).

    $$ C(q, t) = \int_0^t S_a(p_a(\tau), q)\, d\tau \quad\Rightarrow\quad C \leftarrow C + S_a(p_a, q)\, \Delta t $$

    Args:
        coverage: C on the grid; changed.
        p_x, p_y: Position of the UAV [m].
        sensor: The sensor.
        cell: Width of a cell [m].
        duration: Time at this position [s].
        occlusion: Buildings; the cells that they hide gain nothing. None: no buildings, and nothing is compiled for
            them.
    """
    (rows, columns), seeing = coverage.shape, _in_registers(sensor)
    first_row, chords = disc_chords(p_x, p_y, seeing.sensing_range, cell, rows, columns)
    if occlusion is not None:
        shadow = cast_shadow(occlusion, p_x, p_y, seeing.sensing_range, cell, first_row, chords)
    for n in range(chords.shape[1]):
        j, first, end = first_row + n, chords[0, n], chords[1, n]
        cells, d_y = coverage[j, first:end], (j + 0.5) * cell - p_y
        if occlusion is None:
            _accumulate_row(cells, first, p_x, d_y, seeing, cell, duration)
        elif shadow.span[0, n] >= shadow.span[1, n]:
            _accumulate_row(cells, first, p_x, d_y, seeing, cell, duration)
        else:
            winding = shadow.winding[n, LANES:]
            for i in range(cells.size):
                d_x = (first + i + 0.5) * cell - p_x
                gain = sensor_quality(seeing, d_x * d_x + d_y * d_y) * duration
                cells[i] += gain if winding[i] <= 0 else 0.0


@compiled
def accumulate_with_gain(
    coverage: FloatArray,
    p_x: float,
    p_y: float,
    demand: Demand,
    sensor: SensorParameters,
    cell: float,
    duration: float,
    occlusion: Occlusion | None = None,
) -> float:
    r"""Update as `accumulate`, and return the decrease of e(t) of (4) for a fixed UGV.

    $$ \int_{Q_r} \left[ h(C^* - C) - h(C^* - C - S_a \Delta t) \right] \phi(q, p_g)\, dq
       \;\approx\; \Delta t \int_{Q_r} h'(C^* - C)\, S_a\, \phi\, dq $$

    Only the sensor's disc is visited, whereas `coverage_error` needs the whole support of the density.

    Args:
        coverage: C on the grid; changed, bit for bit as by `accumulate`.
        p_x, p_y, sensor, cell, duration, occlusion: As in `accumulate`.
        demand: Demand for coverage around the UGV.

    Returns:
        The decrease of e [m²]; never negative.
    """
    (rows, columns), seeing = coverage.shape, _in_registers(sensor)
    r_o, desired = demand.r_o, demand.desired
    terms = np.empty(columns + LANES)
    total = 0.0
    first_row, chords = disc_chords(p_x, p_y, seeing.sensing_range, cell, rows, columns)
    if occlusion is not None:
        shadow = cast_shadow(occlusion, p_x, p_y, seeing.sensing_range, cell, first_row, chords)
    for n in range(chords.shape[1]):
        j, first, end = first_row + n, chords[0, n], chords[1, n]
        y = (j + 0.5) * cell
        d_y, g_y = y - p_y, y - demand.p_y
        if end <= first:
            continue
        start, stop = widened(first, end, columns)
        cells = coverage[j, start:stop]
        if occlusion is not None:
            winding = shadow.winding[n, LANES + start - first :]
        for i in range(cells.size):
            x = (start + i + 0.5) * cell
            d_x, g_x = x - p_x, x - demand.p_x
            before = cells[i]
            gain = sensor_quality(seeing, d_x * d_x + d_y * d_y) * duration
            if occlusion is not None:
                gain = gain if winding[i] <= 0 else 0.0
            after = before + gain
            cells[i] = after if first <= start + i < end else before
            fall = penalty(desired - before) - penalty(desired - after)
            terms[i] = fall * density(g_x * g_x + g_y * g_y, r_o)
        total += lane_sum(terms, first - start, end - first)
    return total * (cell * cell)


@compiled
def coverage_error(
    coverage: FloatArray, p_gx: float, p_gy: float, r_o: float, desired: float, cell: float
) -> float:
    r"""Return the coverage error around the UGV, Klodt 2015, eq. (4).

    $$ e(t) = \int_Q h(C^* - C(q, t))\, \phi(q, p_g)\, dq $$

    Args:
        coverage: C on the grid.
        p_gx, p_gy: Position of the UGV [m].
        r_o: Radius of the density (9) [m].
        desired: C*.
        cell: Width of a cell [m].

    Returns:
        Coverage error e [m²].
    """
    rows, columns = coverage.shape
    terms = np.empty(columns + LANES)
    total = 0.0
    first_row, chords = disc_chords(p_gx, p_gy, r_o, cell, rows, columns)
    for n in range(chords.shape[1]):
        j, first, end = first_row + n, chords[0, n], chords[1, n]
        d_y = (j + 0.5) * cell - p_gy
        if end <= first:
            continue
        start, stop = widened(first, end, columns)
        cells = coverage[j, start:stop]
        for i in range(cells.size):
            d_x = (start + i + 0.5) * cell - p_gx
            terms[i] = penalty(desired - cells[i]) * density(d_x * d_x + d_y * d_y, r_o)
        total += lane_sum(terms, first - start, end - first)
    return total * (cell * cell)


@compiled
def coverage_gradient(
    coverage: FloatArray,
    p_ax: float,
    p_ay: float,
    p_gx: float,
    p_gy: float,
    r_o: float,
    desired: float,
    sensor: SensorParameters,
    cell: float,
    occlusion: Occlusion | None = None,
) -> tuple[float, float, float]:
    r"""Return the direction of the most uncovered ground, with k = 1, Klodt 2015, eq. (6).

    $$ u_{cov} = k \int_{Q_r} h'(C^* - C)\; 2 \frac{dS_a}{d\rho^2}\, (p_a - q)\, \phi(q, p_g)\, dq $$

    For the paper's sensor (2) this equals

    $$ k\frac{4M}{r^4}\int h'(\cdot)(\|p_a-q\|^2 - r^2)(p_a-q)\phi\,dq $$

    Args:
        coverage: C on the grid.
        p_ax, p_ay: Position of the UAV [m].
        p_gx, p_gy: Position of the UGV, or its estimate [m].
        r_o, desired: Radius of the density (9) [m], and C*.
        sensor, cell, occlusion: As in `accumulate`.

    Returns:
        u_cov, x and y, and the size of its integrand (r times the sum of the magnitudes), the scale for "u_cov = 0".
    """
    (rows, columns), seeing = coverage.shape, _in_registers(sensor)
    pulls = np.empty(columns + LANES)
    weights = np.empty(columns + LANES)
    sum_x, sum_y, size = 0.0, 0.0, 0.0
    first_row, chords = disc_chords(p_ax, p_ay, seeing.sensing_range, cell, rows, columns)
    if occlusion is not None:
        shadow = cast_shadow(occlusion, p_ax, p_ay, seeing.sensing_range, cell, first_row, chords)
    for n in range(chords.shape[1]):
        j, first, end = first_row + n, chords[0, n], chords[1, n]
        y = (j + 0.5) * cell
        d_y, g_y = p_ay - y, p_gy - y
        if end <= first:
            continue
        start, stop = widened(first, end, columns)
        cells = coverage[j, start:stop]
        if occlusion is not None:
            winding = shadow.winding[n, LANES + start - first :]
        for i in range(cells.size):
            x = (start + i + 0.5) * cell
            d_x, g_x = p_ax - x, p_gx - x
            slope = 2.0 * sensor_slope(seeing, d_x * d_x + d_y * d_y)
            weight = penalty_slope(desired - cells[i]) * slope * density(g_x * g_x + g_y * g_y, r_o)
            if occlusion is not None:
                weight = weight if winding[i] <= 0 else 0.0
            weights[i] = weight
            pulls[i] = weight * d_x
        row_weight = lane_sum(weights, first - start, end - first)
        sum_x += lane_sum(pulls, first - start, end - first)
        sum_y += row_weight * d_y
        size += abs(row_weight) * seeing.sensing_range
    area = cell * cell
    return sum_x * area, sum_y * area, size * area


@compiled
def coverage_shares(coverage: FloatArray, desired: float) -> tuple[float, float]:
    """Return the share of cells with C >= C*, and the mean of min(C / C*, 1).

    Args:
        coverage: C on the grid.
        desired: C*.
    """
    rows, columns = coverage.shape
    terms, covered, seen = np.zeros(columns + LANES), 0, 0.0
    for j in range(rows):
        cells = coverage[j]
        for i in range(columns):
            terms[i] = min(cells[i] / desired, 1.0)
            covered += 1 if cells[i] >= desired else 0
        seen += lane_sum(terms, 0, columns)
    return covered / (rows * columns), seen / (rows * columns)


def empty_coverage(width: float, height: float, cell: float) -> FloatArray:
    """Return a grid over [0, width] x [0, height] without coverage, shape (rows, columns)."""
    return np.zeros((round(height / cell), round(width / cell)))


def cover(
    coverage: FloatArray,
    lower: tuple[float, float],
    upper: tuple[float, float],
    cell: float,
    value: float,
) -> None:
    """Raise the coverage of every cell with its center in the rectangle to at least `value`."""
    rows, columns = coverage.shape
    x = (np.arange(columns) + 0.5) * cell
    y = (np.arange(rows) + 0.5) * cell
    inside = np.outer((y >= lower[1]) & (y <= upper[1]), (x >= lower[0]) & (x <= upper[0]))
    np.maximum(coverage, value, out=coverage, where=inside)


@compiled
def sample(
    coverage: FloatArray,
    p_x: float,
    p_y: float,
    desired: float,
    cell: float,
    scale: float,
    picture: FloatArray,
) -> None:
    """Fill a picture centered at (p_x, p_y) [m] with min(C / C*, 1) of the cell at each pixel's center; 1 outside Q."""
    rows, columns = coverage.shape
    count = picture.shape[0]
    middle = 0.5 * (count - 1)
    for j in range(count):
        row = np.floor((p_y + (j - middle) * scale) / cell)
        for i in range(count):
            column = np.floor((p_x + (i - middle) * scale) / cell)
            if 0.0 <= row < rows and 0.0 <= column < columns:
                picture[j, i] = min(coverage[int(row), int(column)] / desired, 1.0)
            else:
                picture[j, i] = 1.0
