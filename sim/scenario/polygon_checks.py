"""Checks of polygons."""

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from bus.messages.base import Vector
from bus.messages.ground import SAME_CORNER, distinct_corners
from sim.compiling.compile import FloatArray, IntArray
from sim.input.faults import Fault

BoolArray = npt.NDArray[np.bool_]

_LEAST_AREA = 1e-9
"""Smallest area of a polygon [m²]."""


@lru_cache(maxsize=8)
def _apart(count: int) -> tuple[IntArray, IntArray]:
    """Return all pairs of a polygon's sides without a common corner."""
    one, other = np.triu_indices(count, 2)
    apart = other - one < count - 1
    return one[apart], other[apart]


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _meet(a: FloatArray, d: FloatArray, b: FloatArray, e: FloatArray) -> BoolArray:
    """Return whether the segments from a by d and from b by e have a common point. Shapes (..., 2), broadcast."""
    # each segment's ends lie on both sides of the other one, or on it
    across = np.sign(_cross(d, b - a)) * np.sign(_cross(d, b + e - a)) <= 0.0
    across &= np.sign(_cross(e, a - b)) * np.sign(_cross(e, a + d - b)) <= 0.0
    low, high = np.minimum(a, a + d), np.maximum(a, a + d)
    met: BoolArray = across & ((np.minimum(b, b + e) <= high) & (np.maximum(b, b + e) >= low)).all(
        axis=-1
    )
    return met


def polygon_faults(path: str, polygon: tuple[Vector, ...]) -> Iterator[Fault]:
    """Check that a polygon has three or more corners, an area, and sides that meet only at corners."""
    corners = np.array(distinct_corners(polygon))
    count = len(corners)
    if count < 3:
        yield Fault(
            path, polygon, f"{count} corners", "three or more, more than a millimetre apart"
        )
        return
    sides = np.roll(corners, -1, axis=0) - corners
    met = _sides_that_meet(corners, sides)
    from_first = corners - corners[0]
    twice_the_area = float(_cross(from_first, np.roll(from_first, -1, axis=0)).sum())
    if met is not None:
        wrong = f"crosses itself: the sides from corners {met[0]} and {met[1]} meet"
        yield Fault(path, polygon, wrong, "corners in order around the polygon")
    elif abs(twice_the_area) <= 2.0 * _LEAST_AREA:
        yield Fault(path, polygon, "has no area", "corners that are not collinear")


def _sides_that_meet(corners: FloatArray, sides: FloatArray) -> tuple[int, int] | None:
    """Return two sides of a polygon that meet outside a common corner; None: there are none."""
    one, other = _apart(len(corners))
    a, d, b, e = corners[one], sides[one], corners[other], sides[other]
    found = np.flatnonzero(_meet(a, d, b, e))
    if found.size:
        return int(one[found[0]]), int(other[found[0]])
    after = np.roll(sides, -1, axis=0)
    back = np.flatnonzero((_cross(sides, after) == 0.0) & ((sides * after).sum(axis=1) < 0.0))
    if back.size and len(corners) > 3:
        return int(back[0]), (int(back[0]) + 1) % len(corners)
    return None


def _distance2(p: FloatArray, a: FloatArray, d: FloatArray) -> FloatArray:
    """Return the squared distance of points p from the segments from a by d [m²]. Shapes (..., 2), broadcast."""
    along = ((p - a) * d).sum(axis=-1) / (d * d).sum(axis=-1)
    off = p - a - along.clip(0.0, 1.0)[..., None] * d
    distance2: FloatArray = (off * off).sum(axis=-1)
    return distance2


def _crossings(p: FloatArray, a: FloatArray, d: FloatArray) -> BoolArray:
    """Return whether the rays from points p to the right cross the segments from a by d. Shapes (..., 2), broadcast."""
    up, length = p[..., 1] - a[..., 1], d[..., 1]
    with np.errstate(divide="ignore", invalid="ignore"):  # horizontal segments are not crossed
        at = a[..., 0] + d[..., 0] * up / length
    crossed: BoolArray = ((up < 0.0) != (up < length)) & (p[..., 0] < at)
    return crossed


def first_contact(polygons: Sequence[FloatArray]) -> tuple[int, int] | None:
    """Return two polygons that overlap or touch, with a tolerance of `SAME_CORNER`; None: there are none.

    Args:
        polygons: Corners of simple polygons [m]. Shape (corners, 2) each.
    """
    low = np.array([one.min(axis=0) for one in polygons]).reshape(-1, 2) - SAME_CORNER
    high = np.array([one.max(axis=0) for one in polygons]).reshape(-1, 2) + SAME_CORNER
    for k in range(len(polygons)):
        later = slice(k + 1, None)
        near = np.flatnonzero(((low[later] <= high[k]) & (high[later] >= low[k])).all(axis=1))
        contact = _contact_with(polygons[k], [polygons[k + 1 + n] for n in near.tolist()])
        if contact is not None:
            return k, k + 1 + int(near[contact])
    return None


def _contact_with(one: FloatArray, others: Sequence[FloatArray]) -> int | None:
    """Return the first of several polygons that overlaps or touches one of them; None: there are none."""
    if not others:
        return None
    owner = np.repeat(np.arange(len(others)), [len(other) for other in others])
    a, d = one, np.roll(one, -1, axis=0) - one
    b = np.concatenate(others)
    e = np.concatenate([np.roll(other, -1, axis=0) - other for other in others])
    low, high = np.minimum(b, b + e) - SAME_CORNER, np.maximum(b, b + e) + SAME_CORNER
    begin, end = np.minimum(a, a + d), np.maximum(a, a + d)
    near = np.ones((len(a), len(b)), dtype=np.bool_)
    for axis in (0, 1):
        near &= begin[:, axis, None] <= high[:, axis]
        near &= end[:, axis, None] >= low[:, axis]
    i, j = np.nonzero(near)
    meet = _meet(a[i], d[i], b[j], e[j])
    for p, start, side in ((b[j], a[i], d[i]), (a[i], b[j], e[j])):
        meet |= _distance2(p, start, side) <= SAME_CORNER**2
    touched = np.zeros(len(others), dtype=np.bool_)
    touched[owner[j[meet]]] = True
    firsts = np.array([other[0] for other in others])
    touched |= _crossings(firsts, a[:, None], d[:, None]).sum(axis=0) % 2 == 1
    touched |= np.bincount(owner, weights=_crossings(one[0], b, e)) % 2.0 == 1.0
    return int(touched.argmax()) if touched.any() else None
