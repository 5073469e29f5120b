"""Teams as matplotlib artists: paths that show the roles, the cells of a team, and their legend."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from bus.messages.team import Role
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import choice
from sim.scene.colors import INK, UAV, mixed
from sim.scene.model import Point, Scene
from sim.scene.team import LOOKS, dashes_of, in_role, known_roles, team_cells

_WIDTH = 1.6
"""Width of the path of a UAV without a team [pt]."""
_CELLS: dict[str, Any] = {"colors": INK, "linewidths": 0.5, "alpha": 0.55}
"""Style of the borders between cells."""


class RoleTrack:
    """Path of a UAV in a team: the line shows the role at each point, the marker the present one.

    Args:
        axes: Axes to draw on.
        color: Color of the UAV.
    """

    def __init__(self, axes: Axes, color: str) -> None:
        self._color = color
        self._lines: dict[Role, Line2D] = {}
        for role, look in LOOKS.items():
            style: dict[str, Any] = {"linestyle": dashes_of(look), "alpha": look.opacity}
            (self._lines[role],) = axes.plot(
                [], [], color=color, linewidth=_WIDTH * look.width, zorder=4, **style
            )
        hollow: dict[str, Any] = {"markersize": 6, "color": "white", "markeredgecolor": color}
        (self._start,) = axes.plot([], [], "o", **hollow, markeredgewidth=1.5, zorder=6)
        (self._mark,) = axes.plot([], [], "o", markersize=8, zorder=7)
        self.artists: tuple[Line2D, ...] = (*self._lines.values(), self._start, self._mark)

    def move(self, path: FloatArray, roles: IntArray | None) -> None:
        """Show the path up to its last point [m], shape (points, 2), in the roles of its points, shape (points,)."""
        known = None if roles is None or not roles.any() else known_roles(roles)
        for role, line in self._lines.items():
            part = path if known is None else in_role(path, known, role)
            line.set_data(part[:, 0], part[:, 1])
            line.set_visible(role is Role.GUARD if known is None else not np.isnan(part).all())
        self._start.set_data(path[:1, 0], path[:1, 1])
        self._mark.set_data(path[-1:, 0], path[-1:, 1])
        look = mark_of(self._color, None if known is None else choice(Role, int(known[-1])))
        self._mark.set(**look)


def mark_of(color: str, role: Role | None) -> dict[str, Any]:
    """Return the look of the marker of a UAV: a guard's is full, and a scout's lighter; None: no role known."""
    if role is None or role is Role.GUARD:
        return {"color": color, "markeredgecolor": "white", "markeredgewidth": 1.2}
    light = mixed("#ffffff", color, 0.5 * LOOKS[role].opacity)
    return {"color": light, "markeredgecolor": color, "markeredgewidth": 1.2}


class DrawnCells:
    """Borders between the cells of all teams.

    Args:
        axes: Axes to draw on.
        scene: Scene with teams.
    """

    def __init__(self, axes: Axes, scene: Scene) -> None:
        self._scene = scene
        self.artist = LineCollection([], **_CELLS, zorder=3.2)
        axes.add_collection(self.artist)

    def show(self, positions: Mapping[str, Point]) -> None:
        """Show the cells for these positions of the vehicles [m]."""
        width, height = self._scene.width, self._scene.height
        borders = []
        for team in self._scene.teams:
            for cell in team_cells([positions[name] for name in team], width, height):
                borders.append([*cell, *cell[:1]])
        self.artist.set_segments(borders)


def legend_of_roles(scene: Scene, roles: Collection[Role]) -> list[Artist]:
    """Return the entries of the roles that occur, and of the cells; empty without a team or a known role."""
    if not scene.teams or not roles:
        return []
    keys: list[Artist] = []
    for role, look in LOOKS.items():
        if role in roles:
            style: dict[str, Any] = {"linestyle": dashes_of(look), "alpha": look.opacity}
            keys.append(
                Line2D(
                    [], [], color=UAV[0], label=role.lower(), linewidth=_WIDTH * look.width, **style
                )
            )
    keys.append(Line2D([], [], color=INK, linewidth=0.5, alpha=0.55, label="cell of a UAV"))
    return keys
