"""Parameters as rows of structured arrays: compiled code reads `rows[k].name`, one array crosses the call.

A named tuple costs some 0.1 µs a number each time that Python hands it to a compiled function, an array costs
0.15 µs however much is in it.
"""

import functools
from collections.abc import Sequence
from typing import Any, get_type_hints

import numpy as np
import numpy.typing as npt

RecordArray = npt.NDArray[np.void]
"""A structured array, one row each."""

_KINDS = {float: np.float64, int: np.int64, bool: np.bool_, np.uint64: np.uint64}


@functools.cache
def record_type(fields: type) -> np.dtype[np.void]:
    """The columns of a table of such named tuples or data classes: one for each field that is a number or a flag."""
    hints = get_type_hints(fields).items()
    columns = [(name, _KINDS[hint]) for name, hint in hints if hint in _KINDS]
    return np.dtype((np.record, np.dtype(columns, align=True)))


def records(fields: type, rows: Sequence[Any]) -> RecordArray:
    """A table with a row for each of these. Shape (rows,)."""
    kind = record_type(fields)
    table = np.zeros(len(rows), dtype=kind)
    for name in kind.names or ():
        table[name] = [getattr(row, name) for row in rows]
    return table


def columns(row: Any) -> Any:  # noqa: ANN401 - a type of named tuples, and one whose fields are whole numbers
    """The place of each field of a row: a row whose values are their own places."""
    return row._make(range(len(row._fields)))
