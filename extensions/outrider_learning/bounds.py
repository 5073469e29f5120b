"""Bounds of the numbers in a saved policy's recipe.

A damaged or hostile file must neither exhaust the memory nor fail in flight.
"""

import operator
from collections.abc import Sequence

import numpy as np

from sim.env.observation import Array

LARGEST, SMALLEST = 1e12, 1e-9
"""Bounds of the magnitude of a positive number."""
_MOST_ENTRIES = 1 << 20
"""Largest number of entries of a table."""
MOST_TICKS = 100_000
"""Largest number of ticks for which an action is repeated."""


def whole(name: str, value: object, most: int) -> int:
    """Return a whole number from 1 to `most`.

    Raises:
        ValueError: If the value is another one.
    """
    try:
        number = 0 if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]  # checked here
    except TypeError:
        number = 0
    if not 1 <= number <= most:
        raise ValueError(f"{name} = {_shown(value)}; allowed: a whole number from 1 to {most}")
    return number


def positive(name: str, value: object) -> float:
    """Return a positive number from `SMALLEST` to `LARGEST`.

    Raises:
        ValueError: If the value is another one.
    """
    return float(row(name, [value], SMALLEST, most=1)[0])


def row(name: str, values: object, low: float, *, most: int, least: int = 1) -> Array:
    """Return a list of `least` to `most` numbers from `low` to `LARGEST` as an array.

    Raises:
        ValueError: If it is another list, or not a list.
    """
    if isinstance(values, Sequence | np.ndarray) and least <= len(values) <= most:
        numbers = [one for one in values if isinstance(one, int | float | np.number)]
        if len(numbers) == len(values) and all(low <= one <= LARGEST for one in numbers):
            return np.array(numbers, dtype=np.float64)
    shown = values[0] if most == 1 and isinstance(values, list) else values
    count = f"{most}" if least == most else f"{least} to {most}"
    kind = "a number" if most == 1 else f"{count} numbers"
    raise ValueError(f"{name} = {_shown(shown)}; allowed: {kind} from {low:g} to {LARGEST:g}")


def table(name: str, values: object, low: float) -> Array:
    """Return nested lists of equal lengths, with numbers from `low` to `LARGEST`, as an array.

    Raises:
        ValueError: If they are something else.
    """
    try:
        numbers = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(np.nan)
    is_table = numbers.ndim > 0 and 1 <= numbers.size <= _MOST_ENTRIES
    if is_table and bool(((numbers >= low) & (numbers <= LARGEST)).all()):
        return numbers
    allowed = f"nested lists of numbers from {low:g} to {LARGEST:g}"
    raise ValueError(f"{name} = {_shown(values)}; allowed: {allowed}")


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
