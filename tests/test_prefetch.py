"""The hint which cells come next: what it names is what the kernels touch."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from properties import PROPERTY
from sim.kernels.prefetch import disc_widths, fetch_disc, fetch_rows

from sim.kernels.compile import FloatArray, released
from sim.models.field import disc_chords

ROWS, COLUMNS = 90, 110


@given(
    x=st.floats(-3.0, 30.0),
    y=st.floats(-3.0, 25.0),
    radius=st.floats(0.05, 9.75),
    cell=st.sampled_from([0.1, 0.2, 0.25, 0.3, 1.0]),
)
@settings(PROPERTY)
def test_a_disc_lies_within_its_widths_and_they_are_not_much_wider(x, y, radius, cell):
    widths = disc_widths(radius, cell)
    column, lowest = int(x / cell), int(y / cell) - len(widths) // 2
    first_row, chords = disc_chords(x, y, radius, cell, ROWS, COLUMNS)
    for n, (first, end) in enumerate(chords.T.tolist()):
        if end > first and x >= 0.0 and y >= 0.0:  # a vehicle is never outside
            width = widths[first_row + n - lowest]
            assert column - width <= first
            assert end - 1 <= column + width
    assert np.sum(2 * widths + 1) <= np.pi * (radius / cell + 1.5) ** 2


def test_a_hint_changes_nothing_wherever_it_points() -> None:
    grid = np.random.default_rng(3).uniform(size=(20, 30))
    before = grid.copy()
    for x, y in ((0.0, 0.0), (7.4, 4.9), (-50.0, 80.0), (7.5, 5.0)):
        for part in range(4):
            fetch_disc(grid, x, y, 0.25, disc_widths(5.0, 0.25), part, 4)
    assert np.array_equal(grid, before)


@released
def _hint_rows(first: FloatArray, second: FloatArray, k: int) -> None:
    fetch_rows((first, second), k)  # type: ignore[call-arg]


def test_a_hint_of_rows_changes_nothing_for_rows_of_any_length() -> None:
    first, second = np.ones((5, 3, 40)), np.zeros((5, 0))
    for k in range(5):
        _hint_rows(first, second, k)
    assert (first == 1.0).all()
