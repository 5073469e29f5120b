"""Pictures of the coverage around a UAV and of the ground around a UGV, for learned policies."""

from typing import Any, NamedTuple


class CoveragePatch(NamedTuple):
    """Square picture of the UAV's own map, centered on the UAV; rows increase northwards, columns eastwards."""

    pixels: int
    """Number of rows, and of columns."""
    meters_per_pixel: float


MOST_PIXELS = 1024
"""Largest number of rows of a coverage picture."""


def given_patch(given: Any) -> CoveragePatch | None:  # noqa: ANN401 - a user's argument
    """Check the picture that a user requests; None: no picture.

    Raises:
        ValueError: If it has no pixels, too many, or no size.
    """
    if given is None:
        return None
    try:
        pixels, size = given
    except (TypeError, ValueError):
        raise ValueError(
            f"coverage_patch = {given!r}: not a pair; allowed: (pixels, meters_per_pixel), such as (32, 0.5), or None"
        ) from None
    if not (1 <= pixels <= MOST_PIXELS and pixels == int(pixels)):
        raise ValueError(
            f"coverage_patch: pixels = {pixels!r}; allowed: a whole number from 1 to {MOST_PIXELS}"
        )
    if not 0.0 < size < 1e6:
        raise ValueError(
            f"coverage_patch: meters_per_pixel = {size!r}; allowed: a positive, finite number"
        )
    return CoveragePatch(int(pixels), float(size))


TILE_PATCH = 21
"""Default number of tiles per side of a UGV's picture of the ground."""


def check_tile_patch(side: int) -> int:
    """Check the side of a UGV's picture of the ground.

    Raises:
        ValueError: If it is not an odd number from 1 to 255: the UGV's own tile is in the middle.
    """
    if isinstance(side, bool) or not (1 <= side <= 255 and side % 2 == 1):
        raise ValueError(f"tile_patch = {side!r}; allowed: an odd whole number from 1 to 255")
    return int(side)
