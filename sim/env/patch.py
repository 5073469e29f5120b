"""The coverage around a UAV as a small picture, for policies that learn."""

from typing import NamedTuple

import numpy as np

from sim.kernels.compile import FloatArray
from sim.models.field import accumulate, sample
from sim.world import World


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


class OwnMaps:
    """The ground that each UAV has seen itself.

    One UAV's map is the world's, if it truly is where it is told that it is; each of several has one of its own.

    Args:
        world: At its start.
        needed: Whether anybody looks at the maps.
    """

    def __init__(self, world: World, *, needed: bool) -> None:
        own = len(world.uavs) > 1 or world.scenario.disturbed
        self._shared = not (needed and own)
        self._maps = [] if self._shared else [world.coverage.copy() for _ in world.uavs]

    def look(self, world: World) -> None:
        """Add what each UAV sees at this tick, as the world does (3)."""
        if self._shared:
            return
        parameters = world.parameters
        for own, (uav, _) in zip(self._maps, world.escorts, strict=True):
            x, y = world.reference_position[uav].tolist()
            accumulate(
                own,
                x,
                y,
                parameters.sensor,
                parameters.peak,
                parameters.reach,
                parameters.cell,
                parameters.dt,
            )

    def patch(self, escort: int, world: World, patch: CoveragePatch) -> FloatArray:
        """The picture around one UAV, row 0 in the south. Shape (pixels, pixels)."""
        x, y = world.reference_position[world.escorts[escort, 0]].tolist()
        picture = np.empty((patch.pixels, patch.pixels))
        parameters = world.parameters
        own = world.coverage if self._shared else self._maps[escort]
        sample(
            own, x, y, parameters.desired, parameters.cell, float(patch.meters_per_pixel), picture
        )
        return picture
