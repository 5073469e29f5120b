"""Parameters and state as structured arrays: compiled code reads `rows[k].name`.

A call from Python passes one array for all fields, and a record needs no reference counting.
"""

import functools
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from enum import Enum
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import compiled

RecordArray = npt.NDArray[np.void]
"""Structured array, one record per element."""

Pair = Annotated[npt.NDArray[np.float64], (2,)]
"""Vector in a record, x before y."""

_T = TypeVar("_T")
_E = TypeVar("_E", bound=Enum)
_UNUSED = "unused"
"""Column of a record of a class without fields, as numba cannot nest an empty one."""
_KINDS = {float: np.float64, int: np.int64, bool: np.bool_, np.uint64: np.uint64}


@functools.cache
def record_type(fields: type) -> np.dtype[np.void]:
    """Return the dtype of a class: one column for each number, flag, choice, vector, fixed array or nested class.

    An enum member is its `code`. A vector is a tuple of two floats; `Annotated[IntArray, (6,)]` holds six numbers.
    Other fields are omitted. The fields that a class adds come before the fields of its bases: numba would treat a
    record that starts with all fields of another one as that record.
    """
    hints = get_type_hints(fields, include_extras=True)
    names = dict.fromkeys(
        name for one in fields.__mro__ for name in vars(one).get("__annotations__", {})
    )
    columns = [(name, *column) for name in names if (column := _column(hints[name]))]
    return np.dtype(columns or [(_UNUSED, np.uint8)], align=True)


def nested_type(parts: Mapping[str, type]) -> np.dtype[np.void]:
    """Return the dtype of a record that nests one record of each class."""
    return np.dtype([(name, record_type(fields)) for name, fields in parts.items()], align=True)


def _column(hint: Any) -> tuple[Any, ...]:  # noqa: ANN401 - a type, as it is annotated
    """Return the type of a column, and its shape; empty for an omitted field."""
    if hint in _KINDS:
        return (_KINDS[hint],)
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        shapes = [part for part in parts[1:] if isinstance(part, tuple)]
        if shapes:  # a NumPy array type, whose second parameter is its dtype
            return (get_args(get_args(parts[0])[1])[0], shapes[0])
        return _column(parts[0])
    if origin in (Union, UnionType):
        return _column(next(part for part in parts if part is not type(None)))
    if isinstance(hint, type) and issubclass(hint, Enum):
        return (np.int64,)
    if origin is tuple and [_column(part) for part in parts] == [(np.float64,)] * 2:
        return (np.float64, (2,))
    if isinstance(hint, type) and origin is None and "__annotations__" in vars(hint):
        nested = record_type(hint)
        return (nested,) if nested.names != (_UNUSED,) else ()
    return ()


def code(member: Enum) -> int:
    """Return the number of an enum member in a record, from 1; 0 is None."""
    return 1 + list(type(member)).index(member)


@functools.cache
def _members(kinds: type[_E]) -> tuple[_E, ...]:
    return tuple(kinds)


def choice(kinds: type[_E], number: int) -> _E | None:
    """Return the enum member with this `code`; None for 0."""
    return _members(kinds)[number - 1] if number else None


def fill(row: Any, value: Any) -> None:  # noqa: ANN401 - a record, and what its class was made from
    """Write an object into a record, field by field; None becomes infinity."""
    for name in row.dtype.names:
        if name == _UNUSED:
            continue
        given = getattr(value, name)
        if row.dtype[name].names:
            fill(row[name], given)
        else:
            row[name] = math.inf if given is None else given


def records(fields: type, rows: Sequence[Any]) -> RecordArray:
    """Return a table with one record for each object. Shape (rows,)."""
    table = np.zeros(len(rows), dtype=record_type(fields))
    for row, value in zip(table, rows, strict=True):
        fill(row, value)
    return table


@compiled
def row_of(rows: int, world: int) -> int:
    """Return the row of a world in a table with one row for all worlds, or with one for each."""
    return min(world, rows - 1)


@functools.cache
def _places(fields: Callable[..., Any], dtype: np.dtype[Any]) -> Callable[[Any], tuple[Any, ...]]:
    """Return a function that picks the fields of a struct out of the values of a record."""
    names = dtype.names or ()
    return operator.itemgetter(
        *(names.index(name) for name in getattr(fields, "__struct_fields__", ()))
    )


def struct_of(fields: Callable[..., _T], row: Any) -> _T:  # noqa: ANN401 - a record
    """Return the struct of a record with all its fields, and possibly more; it has at least two."""
    values = _places(fields, row.dtype)(row.tolist())
    return fields(*(tuple(one.tolist()) if isinstance(one, np.ndarray) else one for one in values))


def fresh(fields: type, shape: tuple[int, ...] = (1,)) -> RecordArray:
    """Return a table of new records: each field has the default of the class, or 0."""
    table = np.zeros(shape, dtype=record_type(fields))
    for name in table.dtype.names or ():
        table[name] = getattr(fields, name, 0)
    return table


def fresh_nested(parts: Mapping[str, type], shape: tuple[int, ...]) -> RecordArray:
    """Return a table of records that nest one new record of each class."""
    table = np.zeros(shape, dtype=nested_type(parts))
    for name, fields in parts.items():
        table[name] = fresh(fields, shape)
    return table
