"""Nearest point that lacks coverage, the goal of the symmetry breaker (7)."""

import math

from sim.compiling.compile import FloatArray, compiled
from sim.models.grid import disc_chords
from sim.models.randomness import NEAREST_POINT, Key, uniform

NEAREST_TIE = 1e-9
"""Relative difference of squared distances below which uncovered points count as equally near."""


@compiled
def is_uncovered(
    coverage: FloatArray,
    q_x: float,
    q_y: float,
    p_gx: float,
    p_gy: float,
    r_o: float,
    desired: float,
    cell: float,
) -> bool:
    """Return whether the cell around q lacks coverage, within the support of the density: conditions 1, 2 of (7)."""
    rows, columns = coverage.shape
    i = min(max(int(q_x / cell), 0), columns - 1)
    j = min(max(int(q_y / cell), 0), rows - 1)
    d_x, d_y = q_x - p_gx, q_y - p_gy
    return coverage[j, i] < desired and d_x * d_x + d_y * d_y < r_o * r_o


@compiled
def nearest_uncovered(
    coverage: FloatArray,
    p_ax: float,
    p_ay: float,
    p_gx: float,
    p_gy: float,
    r_o: float,
    desired: float,
    cell: float,
    key: Key,
    tick: int,
) -> tuple[bool, float, float]:
    r"""Find the nearest point that lacks coverage within the support of the density, $\tilde q$ of (7).

    Of several equally near points, one is drawn at random.

    Args:
        coverage, p_ax, p_ay, p_gx, p_gy, r_o, desired, cell: As in `coverage_gradient`.
        key, tick: Random key and tick of the draw.

    Returns:
        True if there is such a point, and its x and y [m].
    """
    rows, columns = coverage.shape
    nearest, ties, q_x, q_y = math.inf, 0, 0.0, 0.0
    first_row, chords = disc_chords(p_gx, p_gy, r_o, cell, rows, columns)
    for n in range(chords.shape[1]):
        j, first, end = first_row + n, chords[0, n], chords[1, n]
        y = (j + 0.5) * cell
        for i in range(first, end):
            if coverage[j, i] >= desired:
                continue
            x = (i + 0.5) * cell
            if (x - p_gx) * (x - p_gx) + (y - p_gy) * (y - p_gy) >= r_o * r_o:
                continue
            d2 = (x - p_ax) * (x - p_ax) + (y - p_ay) * (y - p_ay)
            if d2 < nearest - NEAREST_TIE * nearest or ties == 0:
                nearest, ties, q_x, q_y = d2, 1, x, y
            elif d2 <= nearest + NEAREST_TIE * nearest:
                ties += 1  # keeps each of n equally near points with probability 1/n
                if uniform(key, NEAREST_POINT, tick, ties) * ties < 1.0:
                    q_x, q_y = x, y
    return ties > 0, q_x, q_y
