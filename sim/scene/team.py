"""Teams in pictures: the look of a UAV in its role, and the cells by which the UAVs of a team divide the ground."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bus.messages.team import Role
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import code
from sim.scene.model import Point


class RoleLook(NamedTuple):
    """Look of a UAV in one role."""

    width: float
    """Width of its path, relative to a UAV without a team [1]."""
    dashes: tuple[float, ...]
    """Lengths of dashes and gaps [pt]; empty: a solid path."""
    opacity: float
    """Opacity of path and marker."""


LOOKS: Mapping[Role, RoleLook] = MappingProxyType(
    {
        Role.GUARD: RoleLook(1.25, (), 1.0),
        Role.SCOUT: RoleLook(0.8, (), 0.5),
        Role.RELIEF: RoleLook(0.9, (4.0, 1.8), 0.75),
        Role.AWAY: RoleLook(0.8, (1.0, 2.2), 0.5),
    }
)
"""A guard is solid, scouts are lighter, a relief is dashed, and a UAV that is away is dotted."""


def known_roles(roles: IntArray) -> IntArray:
    """Return the role codes of a path without gaps: a missing one is the last known, or else the first known one.

    Args:
        roles: Code of the role at each point, 0: unknown. Shape (points, ...).
    """
    rows = np.arange(len(roles)).reshape(-1, *(1,) * (roles.ndim - 1))
    last = np.maximum.accumulate(np.where(roles > 0, rows, -1), axis=0)
    first = np.argmax(roles > 0, axis=0)
    found: IntArray = np.take_along_axis(roles, np.where(last < 0, first, last), axis=0)
    return found


def occurring(roles: Mapping[str, IntArray]) -> tuple[Role, ...]:
    """Return the roles that occur, from their codes by UAV."""
    codes = {int(one) for row in roles.values() for one in np.unique(row)}
    return tuple(role for role in Role if code(role) in codes)


def in_role(values: FloatArray, roles: IntArray, role: Role) -> FloatArray:
    """Return values with NaN wherever the UAV has another role; one more value joins it to the next role's.

    Args:
        values: Values over time. Shape (points, ...).
        roles: Code of the role at each point, without gaps. Shape (points,).
        role: The role.
    """
    has: npt.NDArray[np.bool_] = roles == code(role)
    has[1:] |= has[:-1].copy()
    shape = (-1, *(1,) * (values.ndim - 1))
    found: FloatArray = np.where(has.reshape(shape), values, np.nan)
    return found


def team_cells(positions: Sequence[Point], width: float, height: float) -> list[list[Point]]:
    """Return the part of an area that is nearest to each position (Voronoi cells), as corners of polygons [m].

    Args:
        positions: Position of each UAV of a team [m].
        width: Width of the area [m].
        height: Height of the area [m].
    """
    area = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
    cells = []
    for own in positions:
        cell = area
        for other in positions:
            if other != own:
                cell = _nearer(cell, own, other)
        cells.append(cell)
    return cells


def _nearer(polygon: list[Point], own: Point, other: Point) -> list[Point]:
    """Return the part of a convex polygon that is nearer to the first point than to the second."""
    n_x, n_y = other[0] - own[0], other[1] - own[1]
    offset = 0.5 * (n_x * (own[0] + other[0]) + n_y * (own[1] + other[1]))
    beyond = [n_x * x + n_y * y - offset for x, y in polygon]
    found: list[Point] = []
    for k, (x, y) in enumerate(polygon):
        before = k - 1
        if (beyond[before] > 0.0) != (beyond[k] > 0.0):
            share = beyond[before] / (beyond[before] - beyond[k])
            b_x, b_y = polygon[before]
            found.append((b_x + share * (x - b_x), b_y + share * (y - b_y)))
        if beyond[k] <= 0.0:
            found.append((x, y))
    return found


def dashes_of(look: RoleLook) -> Any:  # noqa: ANN401 - matplotlib's line style
    """Return the line style of a role for matplotlib."""
    return (0, look.dashes) if look.dashes else "-"
