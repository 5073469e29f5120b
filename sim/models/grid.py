"""Cells of a grid: squares with centers at (i + ½)·cell; arrays are [row, column], row 0 at y = 0."""

import math

import numpy as np

from sim.compiling.compile import IntArray, compiled


@compiled
def chord(center: float, half: float, cell: float, count: int) -> tuple[int, int]:
    """Return the range of cells with centers within `half` of `center`: first, and end; at most `count` cells."""
    first = math.ceil((center - half) / cell - 0.5)
    last = math.floor((center + half) / cell - 0.5)
    return max(0, int(first)), min(count, int(last) + 1)


@compiled
def half_chord(radius: float, offset: float) -> float:
    """Return half the length [m] of a circle's chord at this distance [m] from its center."""
    return math.sqrt(max(0.0, radius * radius - offset * offset))


@compiled
def disc_chords(
    p_x: float, p_y: float, radius: float, cell: float, rows: int, columns: int
) -> tuple[int, IntArray]:
    """Return the cells with centers in a disc.

    All chords are computed at once, vectorized: row by row, each would make the processor wait for a root and a
    quotient before the length of its loop is known.

    Args:
        p_x, p_y: Center of the disc [m].
        radius: Radius of the disc [m].
        cell: Width of a cell [m].
        rows, columns: Size of the grid.

    Returns:
        The first row that the disc meets; and for each row from there on, its first column and the one after the last,
        shape (2, rows).
    """
    first_row, end_row = chord(p_y, radius, cell, rows)
    met = max(0, end_row - first_row)
    chords = np.empty((2, met), dtype=np.int64)
    for n in range(met):
        offset = (first_row + n + 0.5) * cell - p_y
        chords[0, n], chords[1, n] = chord(p_x, half_chord(radius, offset), cell, columns)
    return first_row, chords
