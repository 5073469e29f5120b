"""View of a run in three dimensions: buildings, vehicles, camera cones and lines of sight."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from nicegui import ui
from nicegui.elements.scene.objects.box import Box
from nicegui.elements.scene.objects.cylinder import Cylinder
from nicegui.elements.scene.objects.ring import Ring as DrawnRing
from nicegui.elements.scene.objects.sphere import Sphere

from bus.messages.telemetry import EscortTruth, Truth
from outrider_dashboard.controls.widgets import html
from outrider_dashboard.hub import Hub
from sim.scene.altitude import altitudes_of, ring_radius, sight_of
from sim.scene.colors import GOOD, INK, LIMIT, RULE, building
from sim.scene.model import Scene

PERIOD = 0.1
"""Wall time between two updates [s]."""
_BACKGROUND, _PAPER = "#dfe4ea", "#f7f8f9"
_UPRIGHT = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
"""Rotation of a cylinder, whose axis is y, to the vertical z."""
_VEHICLE = 0.014
"""Size of a vehicle, as a share of the area's longer side."""
_SMALLEST = 0.3
"""Smallest size of a vehicle [m]."""
_HEAD = '<span class="title">View in 3-D</span>'
_LEGEND = """<div class="legend"><span><i class="line seen"></i>line of sight</span>
<span><i class="line limit"></i>hidden or out of range</span>
<span><i class="cone"></i>field of view</span></div>"""

Vector3 = tuple[float, float, float]


class _Uav(NamedTuple):
    """Objects of a UAV.

    Of the cone only the far side is drawn: the near side could hide the objects inside it, as their order of drawing
    follows from the distances of their centers.
    """

    body: Sphere
    cone: Cylinder
    """Its field of view on the ground."""
    sight: Cylinder
    """Line to its UGV."""


class SpaceView:
    """View of one browser; created once the run is known to have altitudes.

    Args:
        hub: State of the run.
    """

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._place = ui.element("div").classes("card").props("hidden")
        self._scene: Scene | None = None
        self._view: ui.scene | None = None
        self._tick = -1

    def show(self) -> None:
        """Show the newest state; a run without altitudes has no view."""
        status, truth = self._hub.status, self._hub.truth
        if status is None or truth is None or status.geometry is None:
            return
        if status.geometry.camera is None or truth.tick == self._tick:
            self._remove(wanted=status.geometry.camera is not None)
            return
        scene = self._hub.scene
        if scene is None or not {name for pair in scene.escorts for name in pair} <= set(
            truth.vehicles
        ):
            return
        if scene != self._scene:
            self._remove(wanted=False)
            self._build(scene, truth)
        self._tick = truth.tick
        self._update(scene, truth)

    def _remove(self, *, wanted: bool) -> None:
        """Remove the view of another run, unless it is wanted."""
        if wanted or self._scene is None:
            return
        self._scene, self._view, self._tick = None, None, -1
        self._place.clear()
        self._place.classes(remove="space").props("hidden")

    def _build(self, scene: Scene, truth: Truth) -> None:
        self._scene = scene
        self._place.classes("space").props(remove="hidden")
        with self._place:
            with ui.element("div").classes("head"):
                with ui.element("div"):
                    html(_HEAD)
                    self._altitudes = ui.label().classes("muted")
                with ui.element("div"):
                    for name, on_click in (
                        ("Overview", self._look_at_all),
                        ("Pair", self._look_at_pair),
                    ):
                        ui.button(name, on_click=on_click).props("flat dense")
            with ui.element("div").classes("space-place"):
                self._view = ui.scene(
                    grid=False,
                    background_color=_BACKGROUND,
                    camera=ui.scene.perspective_camera(fov=45),
                    fps=15,
                )
                with self._view:
                    self._add_ground(self._view, scene)
                    self._add_vehicles(self._view, scene)
            html(_LEGEND)
        self._look_at_all(duration=0.0)

    @staticmethod
    def _add_ground(view: ui.scene, scene: Scene) -> None:
        width, height, deep = scene.width, scene.height, 0.1
        plate = view.box(width, height, deep).material(_PAPER)
        plate.move(0.5 * width, 0.5 * height, -0.5 * deep - 0.02)
        step = 10.0 ** math.floor(math.log10(max(width, height) / 2.0))
        for k in range(math.floor(width / step) + 1):
            view.line([k * step, 0.0, 0.0], [k * step, height, 0.0]).material(RULE)
        for k in range(math.floor(height / step) + 1):
            view.line([0.0, k * step, 0.0], [width, k * step, 0.0]).material(RULE)
        buildings = scene.space.buildings
        for one in buildings:
            outline = [list(corner) for corner in one.corners]
            view.extrusion(outline, one.height).material(building(one.height, buildings))
            view.extrusion(outline, one.height, wireframe=True).material(INK)

    def _add_vehicles(self, view: ui.scene, scene: Scene) -> None:
        size = max(_SMALLEST, _VEHICLE * max(scene.width, scene.height))
        self._ugvs: dict[str, Box] = {}
        self._uavs: dict[str, _Uav] = {}
        for one in scene.vehicles:
            if one.flies:
                body = view.sphere(size).material(one.color)
                cone = view.cylinder(0.0, 1.0, 1.0, 48).material(one.color, 0.16, "back")
                sight = view.cylinder(0.2 * size, 0.2 * size, 1.0).material(GOOD)
                self._uavs[one.name] = _Uav(body, cone.rotate_R(_UPRIGHT), sight)
            else:
                self._ugvs[one.name] = view.box(1.8 * size, 1.4 * size, size).material(one.color)
            for x, y in one.goals:
                mark = view.cylinder(0.0, 0.5 * size, 1.6 * size, 16).material(one.color, 0.7)
                mark.rotate_R(_UPRIGHT).move(x, y, 0.8 * size)
        self._size, self._rings = size, list[DrawnRing]()
        for ring in scene.rings:
            drawn = view.ring(0.985, 1.015, 64).material(ring.color, 0.9, "both")
            self._rings.append(drawn)

    def _update(self, scene: Scene, truth: Truth) -> None:
        altitudes = altitudes_of(truth.vehicles)
        several = len(altitudes) > 1
        self._altitudes.text = ", ".join(
            f"{f'{name} ' if several else ''}z = {z:.1f} m" for name, z in altitudes.items()
        )
        for ring, drawn in zip(scene.rings, self._rings, strict=True):
            radius = max(ring_radius(scene, ring, altitudes), 1e-3)
            x, y = truth.vehicles[ring.around].position
            drawn.move(x, y, 0.03).scale(radius, radius, 1.0)
        for name, box in self._ugvs.items():
            own = truth.vehicles[name]
            box.move(*own.position, 0.5 * self._size)
            if own.heading is not None:
                box.rotate(0.0, 0.0, own.heading)
        for escort in truth.escorts:
            if escort.uav in altitudes and escort.uav in self._uavs:
                self._show_uav(scene, truth, escort, altitudes)

    def _show_uav(
        self, scene: Scene, truth: Truth, escort: EscortTruth, altitudes: Mapping[str, float]
    ) -> None:
        """Place a UAV, its field of view, and its line of sight."""
        drawn, z = self._uavs[escort.uav], altitudes[escort.uav]
        x, y = truth.vehicles[escort.uav].position
        drawn.body.move(x, y, z)
        radius = next(
            ring_radius(scene, ring, altitudes)
            for ring in scene.rings
            if ring.symbol == "r" and ring.around == escort.uav
        )
        drawn.cone.scale(radius, max(z, 1e-3), radius).move(x, y, 0.5 * z)
        color = LIMIT if sight_of(escort, math.inf).lost else GOOD
        end = (*truth.vehicles[escort.ugv].position, scene.space.markers.get(escort.ugv, 0.0))
        _stretch(drawn.sight.material(color), (x, y, z), end)

    def _look_at_all(self, *, duration: float = 0.5) -> None:
        """Show the whole area."""
        scene, view = self._scene, self._view
        if scene is None or view is None:
            return
        width, height = scene.width, scene.height
        far = max(width, height)
        view.move_camera(
            x=0.5 * width,
            y=-0.5 * far,
            z=0.72 * far,
            look_at_x=0.5 * width,
            look_at_y=0.4 * height,
            look_at_z=0.0,
            duration=duration,
        )

    def _look_at_pair(self) -> None:
        """Show the first UAV and its UGV from nearby."""
        truth, view = self._hub.truth, self._view
        if truth is None or view is None or not truth.escorts:
            return
        escort = truth.escorts[0]
        (x, y), uav = truth.vehicles[escort.ugv].position, truth.vehicles[escort.uav]
        z = uav.altitude or 0.0
        view.move_camera(
            x=x, y=y - 1.5 * z - 5.0, z=1.1 * z + 2.0, look_at_x=x, look_at_y=y, look_at_z=0.4 * z
        )


def _stretch(line: Cylinder, start: Vector3, end: Vector3) -> None:
    """Place a cylinder of length 1 along y between two points."""
    offset = tuple(b - a for a, b in zip(start, end, strict=True))
    length = max(math.hypot(*offset), 1e-6)
    along = tuple(part / length for part in offset)
    flat = math.hypot(along[0], along[1])
    across = (along[1] / flat, -along[0] / flat, 0.0) if flat > 1e-9 else (1.0, 0.0, 0.0)
    third = (
        across[1] * along[2] - across[2] * along[1],
        across[2] * along[0] - across[0] * along[2],
        across[0] * along[1] - across[1] * along[0],
    )
    line.rotate_R([list(row) for row in zip(across, along, third, strict=True)])
    line.scale(1.0, length, 1.0)
    line.move(*(0.5 * (a + b) for a, b in zip(start, end, strict=True)))
