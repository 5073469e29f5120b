"""Random buildings in rows, with streets between them and around them.

Along each axis, the area is divided into alternating streets and blocks of random sides. A block has a building with a
given probability. The layout is a pure function of the key.

A building keeps the width of a street from the border and from every other one, and no start or goal is near it. If a
street is wider than two buildings' margins, no building blocks a route: the blocked tiles of a building touch neither
other blocked tiles nor the border, so that a path leads around them on all sides.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

from sim.models.randomness import BUILDING_HEIGHT, BUILDING_SIDE, Key, uniform

_ROUNDING = 1e-6
"""Share of a block by which rounding may lengthen an axis."""


class BlockLayout(NamedTuple):
    """Parameters of one field of buildings."""

    smallest: float
    largest: float
    """Smallest and largest side of a block [m]."""
    street: float
    """Width of a street [m]."""
    lowest: float
    highest: float
    """Smallest and largest height of a building [m]."""
    share: float
    """Probability that a block is built."""


class Block(NamedTuple):
    """Rectangular building."""

    left: float
    low: float
    right: float
    high: float
    """Sides of its footprint [m]."""
    height: float
    """Height of its roof [m]."""


def most_blocks(layout: BlockLayout, length: float) -> float:
    """Return the largest number of blocks along an axis of this length [m]; a whole number, or infinite."""
    count = (length - layout.street) / (layout.smallest + layout.street) + _ROUNDING
    return max(0.0, float(math.floor(count))) if count < math.inf else count


def draw_blocks(
    layout: BlockLayout, field: int, area: tuple[float, float], key: Key
) -> Iterator[Block]:
    """Draw the buildings of a field, column by column.

    Args:
        layout: Parameters of the field.
        field: Number of the field.
        area: Width and height of the area [m].
        key: Key of the random numbers.
    """
    columns, rows = (_draw_sides(layout, 2 * field + axis, area[axis], key) for axis in (0, 1))
    for i, (left, right) in enumerate(columns):
        for j, (low, high) in enumerate(rows):
            n = 2 * (i * len(rows) + j)
            built, share = (uniform(key, BUILDING_HEIGHT, field, n + k) for k in (0, 1))
            if built < layout.share:
                height = layout.lowest + share * (layout.highest - layout.lowest)
                yield Block(left, low, right, high, height)


def _draw_sides(
    layout: BlockLayout, line: int, length: float, key: Key
) -> list[tuple[float, float]]:
    """Draw the begin and the end of each block along an axis [m]; the outer streets share the rest of the length."""
    sides: list[tuple[float, float]] = []
    at = layout.street
    while True:
        share = uniform(key, BUILDING_SIDE, line, len(sides))
        side = layout.smallest + share * (layout.largest - layout.smallest)
        if at + side + layout.street > length:
            break
        sides.append((at, at + side))
        at += side + layout.street
    rest = 0.5 * (length - at) if sides else 0.0
    return [(begin + rest, end + rest) for begin, end in sides]
