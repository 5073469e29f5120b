"""Map of the UGV and its surroundings from above, in characters."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from bus.messages.ground import GroundMap
from bus.messages.team import Role
from bus.messages.telemetry import CoverageMap, Truth
from outrider.view.terminal.canvas import Canvas
from outrider.view.terminal.palette import (
    BACKGROUND,
    COVERED,
    EDGE,
    FAINT,
    HAZARDS,
    LIMIT,
    TILES,
    UAV,
    UGV,
    UNKNOWN,
)
from outrider.view.terminal.teleoperation import DriveView
from sim.scene.ground_map import HIT
from sim.scene.model import Scene
from sim.scene.team import team_cells

_SHOWN = 1.35
"""Half the size of the map around the UGV [r_v]."""
_KEPT = 400
_TRAIL_STEP = 0.15
"""Distance between two points of a trail [m]."""
_COVERED = tuple(COVERED[round(level / 255.0 * (len(COVERED) - 1))] for level in range(256))
"""Color of the ground by its coverage, 0 to 255."""


@dataclass(slots=True)
class Trails:
    """Paths of the vehicles so far."""

    points: dict[str, deque[tuple[float, float]]] = field(default_factory=dict)
    tick: int = 0

    def follow(self, truth: Truth) -> None:
        """Add the current positions; clear the trails when a flight restarts."""
        if truth.tick < self.tick:
            self.points.clear()
        self.tick = truth.tick
        for name, vehicle in truth.vehicles.items():
            trail = self.points.setdefault(name, deque(maxlen=_KEPT))
            if not trail or math.dist(trail[-1], vehicle.position) >= _TRAIL_STEP:
                trail.append(vehicle.position)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Window:
    """Visible part of the ground."""

    x: float
    """Position of the center [m]."""
    y: float
    scale: float
    """Scale [m per dot]."""
    width: int
    """Width [dots]."""
    height: int

    def dot(self, point: tuple[float, float]) -> tuple[float, float]:
        return self.width / 2 + (point[0] - self.x) / self.scale, self.height / 2 - (
            point[1] - self.y
        ) / self.scale

    def point(self, x: float, y: float) -> tuple[float, float]:
        return self.x + (x - self.width / 2) * self.scale, self.y - (
            y - self.height / 2
        ) * self.scale


def draw(
    view: DriveView, vehicle: str, trails: Trails, *, width: int, height: int, wide: bool
) -> Canvas:
    """Draw the map.

    Args:
        view: State of the run.
        vehicle: UGV in the center.
        trails: Paths of the vehicles.
        width: Width [cells].
        height: Height [cells].
        wide: True: show the whole area instead of the UGV's surroundings.
    """
    canvas = Canvas(width, height, BACKGROUND)
    truth, scene = view.truth, view.scene
    if truth is None or scene is None or vehicle not in truth.vehicles:
        canvas.letter(4, 4, "no position yet", FAINT)
        return canvas
    limits = [ring for ring in scene.rings if ring.around == vehicle]
    shown = None if wide or not limits else _SHOWN * max(ring.radius for ring in limits)
    window = _window(scene, truth.vehicles[vehicle].position, canvas, shown)
    coverage = view.coverage
    if coverage is not None and len(coverage.cells) == coverage.rows * coverage.columns:
        _paint_grid(canvas, window, coverage, coverage.cell, coverage.cells, _COVERED)
    _paint_cells(canvas, window, scene, truth)
    _paint_area(canvas, window, scene)
    has_hazards = view.status is not None and view.status.mission is not None
    hazards = view.ground if has_hazards else None
    if hazards is not None:
        _paint_grid(canvas, window, hazards, hazards.tile, hazards.tiles, TILES)
        _paint_hazards(canvas, window, hazards)
    roles = {} if view.status is None else view.status.roles
    flies = {one.name: one.flies for one in scene.vehicles}
    for name, trail in trails.points.items():
        for point in trail:
            canvas.dot(*window.dot(point), UAV[1] if flies.get(name) else UGV[1])
    dot = window.dot(truth.vehicles[vehicle].position)
    for ring in limits:
        canvas.circle(*dot, ring.radius / window.scale, LIMIT, dashed=ring.dashed)
    if hazards is not None:
        for route in hazards.routes.values():
            for start, end in pairwise(map(window.dot, route)):
                canvas.line(*start, *end, UGV[0], dashed=True)
        _mark_hazards(canvas, window, hazards)
    for one in scene.vehicles:
        for goal in one.goals:
            canvas.letter(*window.dot(goal), "×", UGV[0])
    for one in sorted(scene.vehicles, key=lambda one: (one.flies, one.name == vehicle)):
        mark, color = ("▲", UAV[0]) if one.flies else ("■", UGV[0])
        if roles.get(one.name, Role.GUARD) is not Role.GUARD:
            mark = "△"
        if one.name in truth.vehicles:
            own = truth.vehicles[one.name]
            x, y = window.dot(own.position)
            if own.heading is not None:
                tip = x + 8.0 * math.cos(own.heading), y - 8.0 * math.sin(own.heading)
                canvas.line(x, y, *tip, color)
            canvas.letter(x, y, mark, color)
    if view.wanted is not None:
        _paint_arrow(canvas, dot, view.wanted)
    _paint_scale(canvas, window)
    return canvas


def _window(
    scene: Scene, middle: tuple[float, float], canvas: Canvas, shown: float | None
) -> _Window:
    """Return the window within `shown` [m] of a point; None: the whole area."""
    width, height = 2 * canvas.width, 4 * canvas.height
    if shown is not None:
        scale = 2.0 * shown / min(width, height)
        return _Window(x=middle[0], y=middle[1], scale=scale, width=width, height=height)
    scale = max(scene.width / max(width - 4, 1), scene.height / max(height - 4, 1))
    return _Window(x=scene.width / 2, y=scene.height / 2, scale=scale, width=width, height=height)


def _paint_grid(
    canvas: Canvas,
    window: _Window,
    grid: CoverageMap | GroundMap,
    side: float,
    codes: bytes,
    shades: Sequence[str],
) -> None:
    """Color the ground by a grid with cells of `side` [m]; an empty shade leaves the color."""
    for row in range(canvas.height):
        for column in range(canvas.width):
            x, y = window.point(2 * column + 1, 4 * row + 2)
            i, j = int(x // side), int(y // side)
            if 0 <= i < grid.columns and 0 <= j < grid.rows:
                shade = shades[codes[j * grid.columns + i]]
                if shade:
                    canvas.ground(column, row, shade)


def _paint_hazards(canvas: Canvas, window: _Window, ground: GroundMap) -> None:
    """Draw the hazards; those unknown to the UGVs are faint."""
    for hazard, state in zip(ground.hazards, ground.states, strict=True):
        color = LIMIT if state == HIT else (HAZARDS if state else UNKNOWN)[hazard.kind]
        if hazard.polygon:
            corners = [window.dot(corner) for corner in hazard.polygon]
            for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
                canvas.line(*start, *end, color)
        elif hazard.kind != "find":
            canvas.circle(*window.dot(hazard.middle), (hazard.radius or 0.0) / window.scale, color)


def _mark_hazards(canvas: Canvas, window: _Window, ground: GroundMap) -> None:
    """Mark objects to find with a star, and hazards that a UGV has hit with a cross."""
    for hazard, state in zip(ground.hazards, ground.states, strict=True):
        if hazard.kind == "find":
            color = (HAZARDS if state else UNKNOWN)[hazard.kind]
            canvas.letter(*window.dot(hazard.middle), "★" if state else "☆", color)
        elif state == HIT:
            canvas.letter(*window.dot(hazard.middle), "✗", LIMIT)


def _paint_area(canvas: Canvas, window: _Window, scene: Scene) -> None:
    step = _round_length(14.0 * window.scale)
    left, low = window.point(0, window.height)
    right, high = window.point(window.width, 0)
    width, height = scene.width, scene.height
    for i in range(math.ceil(max(left, 0.0) / step), math.floor(min(right, width) / step) + 1):
        for j in range(math.ceil(max(low, 0.0) / step), math.floor(min(high, height) / step) + 1):
            canvas.dot(*window.dot((i * step, j * step)), EDGE)
    corners = ((0.0, 0.0), (width, 0.0), (width, height), (0.0, height))
    for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
        canvas.line(*window.dot(start), *window.dot(end), FAINT)


def _paint_cells(canvas: Canvas, window: _Window, scene: Scene, truth: Truth) -> None:
    """Draw the borders between the cells of each team."""
    for team in scene.teams:
        positions = [truth.vehicles[name].position for name in team if name in truth.vehicles]
        for cell in team_cells(positions, scene.width, scene.height):
            corners = [window.dot(corner) for corner in cell]
            for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
                canvas.line(*start, *end, EDGE)


_ARROWS = "→↗↑↖←↙↓↘"


def _paint_arrow(canvas: Canvas, start: tuple[float, float], wanted: tuple[float, float]) -> None:
    angle = math.atan2(wanted[1], wanted[0])
    x, y = start[0] + 6.0 * math.cos(angle), start[1] - 7.0 * math.sin(angle)
    canvas.letter(x, y, _ARROWS[round(4.0 * angle / math.pi) % 8], UGV[0])


def _paint_scale(canvas: Canvas, window: _Window) -> None:
    length = _round_length(14.0 * window.scale)
    cells = max(round(length / window.scale / 2.0), 1)
    label = f" {length:g} m "
    canvas.letter(2, 4 * canvas.height - 1, "╶" + "─" * max(cells - 2, 0) + "╴" + label, FAINT)


def _round_length(least: float) -> float:
    """Return the smallest 1, 2 or 5 times a power of ten that is not below `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(
        factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= least * 0.999
    )
