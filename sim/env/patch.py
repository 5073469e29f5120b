"""The coverage around a UAV as a small picture, for policies that learn."""

from typing import NamedTuple


class CoveragePatch(NamedTuple):
    """A square picture of the UAV's own map, centred on the UAV; rows go north, columns east."""

    pixels: int
    """Rows, and columns."""
    meters_per_pixel: float


def given_patch(given: CoveragePatch | tuple[int, float] | None) -> CoveragePatch | None:
    """The picture that is asked for, if one is.

    Raises:
        ValueError: If it has no pixels, or too many, or no size.
    """
    if given is None:
        return None
    pixels, size = given
    if not (1 <= pixels <= 1024 and pixels == int(pixels)):
        raise ValueError(
            f"coverage_patch: pixels = {pixels!r}; must be a whole number from 1 to 1024"
        )
    if not 0.0 < size < 1e6:
        raise ValueError(
            f"coverage_patch: meters_per_pixel = {size!r}; must be positive and finite"
        )
    return CoveragePatch(int(pixels), float(size))


TILE_PATCH = 21
"""Tiles on each side of the picture of the ground that a UGV observes, by default."""


def check_tile_patch(side: int) -> int:
    """Refuse a side of a UGV's picture of the ground that cannot be.

    Raises:
        ValueError: If it is no odd number from 1 to 255: the UGV's own tile is in the middle.
    """
    if isinstance(side, bool) or not (1 <= side <= 255 and side % 2 == 1):
        raise ValueError(f"tile_patch = {side!r}; must be an odd whole number from 1 to 255")
    return int(side)
