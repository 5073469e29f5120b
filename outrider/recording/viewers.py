"""Standard channels for MCAP viewers (Foxglove, Lichtblick): frames, poses, a scene, the coverage grid, a log.

They hold a few poses per simulated second, as viewers interpolate. Outrider's own channels hold every tick.
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from bus.messages.buildings import Building
from bus.messages.ground import GroundMap, Hazard
from bus.messages.telemetry import CoverageMap
from bus.plugins import needs
from sim.scenario.types import Scenario
from sim.scene.altitude import ring_radius
from sim.scene.colors import HAZARDS, building, rgb
from sim.scene.known import scene_of
from sim.scene.model import Ring, Scene, SceneVehicle, observed_scene
from sim.scene.prism import prism

with needs("record"):
    import foxglove
    from foxglove import channels, messages

_VIEW_PERIOD = 0.2
"""Shortest simulated time between two poses [s]."""
_SCENE_PERIOD = 1.0
"""Simulated time between two scenes [s]; each scene is complete, as a viewer that seeks shows only the newest."""
_TRACK_ROOM = 200
"""Largest number of points of a track; then every second point is dropped."""
_MOST_HAZARDS = 500
"""Largest number of hazards shown, as each scene holds all of them."""
_UAV_HEIGHT, _UGV_HEIGHT = 1.0, 0.1
"""Heights at which viewers show UGVs, and UAVs without an altitude [m]."""

Place = Sequence[float]
"""Position [m], velocity [m/s], altitude [m] and heading [rad] of a vehicle: x, y, v_x, v_y, z, θ; NaN: none."""


def _color(code: str, opacity: float = 1.0) -> messages.Color:
    r, g, b = rgb(code)
    return messages.Color(r=r, g=g, b=b, a=opacity)


def _stamp(time_ns: int) -> messages.Timestamp:
    return messages.Timestamp(sec=time_ns // 1_000_000_000, nsec=time_ns % 1_000_000_000)


def _ring(ring: Ring, radius: float, z: float) -> messages.LinePrimitive:
    """Return a circle around a vehicle, in the vehicle's frame; `radius`, `z`: its size and height there [m]."""
    angles = [2.0 * math.pi * k / 96 for k in range(96)]
    kinds = messages.LinePrimitiveLineType
    return messages.LinePrimitive(
        type=kinds.LineList if ring.dashed else kinds.LineLoop,
        thickness=0.0375 * ring.width,
        points=[
            messages.Point3(x=radius * math.cos(angle), y=radius * math.sin(angle), z=z)
            for angle in angles
        ],
        color=_color(ring.color),
    )


def _outline(hazard: Hazard) -> messages.LinePrimitive:
    """Return the outline of a hazard on the ground."""
    angles = [2.0 * math.pi * k / 24 for k in range(24)]
    (x, y), r = hazard.middle, hazard.radius or 0.0
    edge = hazard.polygon or [(x + r * math.cos(a), y + r * math.sin(a)) for a in angles]
    return messages.LinePrimitive(
        type=messages.LinePrimitiveLineType.LineLoop,
        thickness=0.08,
        points=[messages.Point3(x=x, y=y, z=0.01) for x, y in edge],
        color=_color(HAZARDS[hazard.kind]),
    )


def _prism(one: Building, grey: str) -> messages.TriangleListPrimitive:
    """Return a building as a solid body."""
    return messages.TriangleListPrimitive(
        points=[messages.Point3(x=x, y=y, z=z) for x, y, z in prism(one)], color=_color(grey)
    )


class _Track:
    """Path of a vehicle: a line that becomes coarser as it becomes longer."""

    def __init__(self) -> None:
        self.points: list[messages.Point3] = []
        self._step, self._passed = 1, -1  # one point in `_step` is kept

    def follow(self, x: float, y: float, z: float) -> None:
        """Add the vehicle's current position [m]; without an altitude, its path is on the ground."""
        self._passed += 1
        if self._passed % self._step == 0:
            self.points.append(messages.Point3(x=x, y=y, z=0.02 if math.isnan(z) else z))
        if len(self.points) > _TRACK_ROOM:
            del self.points[1::2]
            self._step *= 2


def _ugv(color: messages.Color) -> dict[str, Any]:
    return {
        "cubes": [messages.CubePrimitive(size=messages.Vector3(x=0.7, y=0.45, z=0.3), color=color)]
    }


def _uav(color: messages.Color) -> dict[str, Any]:
    size = messages.Vector3(x=0.6, y=0.6, z=0.12)
    body = messages.CylinderPrimitive(size=size, bottom_scale=1.0, top_scale=1.0, color=color)
    nose = messages.ArrowPrimitive(
        shaft_length=0.4, shaft_diameter=0.06, head_length=0.15, head_diameter=0.15, color=color
    )
    return {"cylinders": [body], "arrows": [nose]}


class Viewers:
    """Channels for viewers of one file.

    Args:
        context: Context of the file.
    """

    def __init__(self, context: foxglove.Context) -> None:
        self._context = context
        self._tf = channels.FrameTransformsChannel("/tf", context=context)
        scene = messages.SceneUpdate.get_schema()
        self._scenes = foxglove.Channel(
            "/scene", schema=scene, message_encoding="protobuf", context=context
        )
        self._grid = channels.GridChannel("/grid", context=context)
        self._log = channels.LogChannel("/log", context=context)
        self._poses: dict[str, channels.PoseInFrameChannel] = {}
        self.begin(None)

    def begin(self, scenario: Scenario | None) -> None:
        """Start a flight."""
        self._scene: Scene | None = None if scenario is None else scene_of(scenario)
        self._tracks = defaultdict[str, _Track](_Track)
        self._yaw: dict[str, float] = {}
        self._altitudes: dict[str, float] = {}
        self._bodies = self._hazards = self._houses = b""
        self._buildings: tuple[Building, ...] = ()
        self._next_view = self._next_scene = -math.inf

    def due(self, time: float) -> bool:
        """Return true if the next pose is due at this simulated time [s]."""
        return time >= self._next_view

    def show(
        self, time: float, places: Mapping[str, Place], escorts: Mapping[str, str], time_ns: int
    ) -> None:
        """Write the poses of all vehicles.

        Args:
            time: Simulated time of this flight [s].
            places: Positions and velocities of all vehicles.
            escorts: UGV of each UAV.
            time_ns: The same time on the file's clock [ns].
        """
        self._next_view = time + _VIEW_PERIOD * (1.0 - 1e-6)
        stamp = _stamp(time_ns)
        transforms = [
            self._place(name, place, name in escorts, stamp, time_ns)
            for name, place in places.items()
        ]
        self._tf.log(messages.FrameTransforms(transforms=transforms), log_time=time_ns)
        if time >= self._next_scene:
            self._next_scene = time + _SCENE_PERIOD * (1.0 - 1e-6)
            self._draw(escorts, stamp, time_ns)

    def _place(
        self,
        name: str,
        place: Place,
        is_uav: bool,
        stamp: messages.Timestamp,
        time_ns: int,
    ) -> messages.FrameTransform:
        """Write one vehicle's pose, and return it as a transform."""
        x, y, v_x, v_y, z, heading = place
        if not math.isnan(z):
            self._altitudes[name] = z
        if not math.isnan(heading):
            self._yaw[name] = heading
        elif v_x * v_x + v_y * v_y > 1e-6:
            self._yaw[name] = math.atan2(v_y, v_x)
        half = 0.5 * self._yaw.get(name, 0.0)
        turn = messages.Quaternion(z=math.sin(half), w=math.cos(half))
        height = self._altitudes.get(name, _UAV_HEIGHT if is_uav else _UGV_HEIGHT)
        spot = messages.Vector3(x=x, y=y, z=height)
        if name not in self._poses:
            self._poses[name] = channels.PoseInFrameChannel(f"/pose/{name}", context=self._context)
        pose = messages.Pose(position=spot, orientation=turn)
        self._poses[name].log(
            messages.PoseInFrame(timestamp=stamp, frame_id="world", pose=pose), log_time=time_ns
        )
        self._tracks[name].follow(x, y, z)
        return messages.FrameTransform(
            timestamp=stamp,
            parent_frame_id="world",
            child_frame_id=name,
            translation=spot,
            rotation=turn,
        )

    def _draw(self, escorts: Mapping[str, str], stamp: messages.Timestamp, time_ns: int) -> None:
        if self._scene is None:
            self._scene = observed_scene("", None, escorts=escorts, vehicles=self._tracks)
        if (
            not self._bodies or self._altitudes
        ):  # in the plane, bodies in their vehicle's frame never change
            entities = [self._entity(self._scene, vehicle) for vehicle in self._scene.vehicles]
            self._bodies = messages.SceneUpdate(entities=entities).encode()
        tracks = []
        for name, track in self._tracks.items():
            line = messages.LinePrimitive(
                type=messages.LinePrimitiveLineType.LineStrip,
                thickness=0.05,
                points=track.points,
                color=_color(self._scene.color_of(name), 0.8),
            )
            tracks.append(
                messages.SceneEntity(
                    timestamp=stamp, frame_id="world", id=f"{name} track", lines=[line]
                )
            )
        moving = messages.SceneUpdate(entities=tracks).encode()
        # protobuf concatenates the lists of entities
        scene = self._hazards + self._houses + self._bodies + moving
        self._scenes.log(scene, log_time=time_ns)

    def buildings(self, buildings: tuple[Building, ...]) -> None:
        """Show these buildings from the next scene on."""
        if buildings == self._buildings:
            return
        self._buildings = buildings
        bodies = [_prism(one, building(one.height, buildings)) for one in buildings]
        entity = messages.SceneEntity(frame_id="world", id="buildings", triangles=bodies)
        self._houses = messages.SceneUpdate(entities=[entity]).encode()

    def hazards(self, ground: GroundMap) -> None:
        """Show the hazards of a map from the next scene on, apart from its buildings."""
        others = [one for k, one in enumerate(ground.hazards) if k not in ground.building_rows]
        outlines = [_outline(hazard) for hazard in others[:_MOST_HAZARDS]]
        entity = messages.SceneEntity(frame_id="world", id="hazards", lines=outlines)
        self._hazards = messages.SceneUpdate(entities=[entity]).encode()

    def _entity(self, scene: Scene, vehicle: SceneVehicle) -> messages.SceneEntity:
        """Return the entity of a vehicle with the circles around it, which are on the ground."""
        color, z = _color(vehicle.color), self._altitudes.get(vehicle.name)
        height = 0.0 if z is None else 0.02 - z
        rings = [ring for ring in scene.rings if ring.around == vehicle.name]
        return messages.SceneEntity(
            frame_id=vehicle.name,
            id=vehicle.name,
            frame_locked=True,
            lines=[
                _ring(ring, ring_radius(scene, ring, self._altitudes), height) for ring in rings
            ],
            **(_uav(color) if vehicle.flies else _ugv(color)),
        )

    def coverage(self, ground: CoverageMap, time_ns: int) -> None:
        """Write the coverage map."""
        pose = messages.Pose(
            position=messages.Vector3(z=-0.01), orientation=messages.Quaternion(w=1.0)
        )
        share = messages.PackedElementField(
            name="coverage", type=messages.PackedElementFieldNumericType.Uint8
        )
        grid = messages.Grid(
            timestamp=_stamp(time_ns),
            frame_id="world",
            pose=pose,
            column_count=ground.columns,
            cell_size=messages.Vector2(x=ground.cell, y=ground.cell),
            row_stride=ground.columns,
            cell_stride=1,
            fields=[share],
            data=ground.cells,
        )
        self._grid.log(grid, log_time=time_ns)

    def log(self, line: str, time_ns: int, *, warning: bool) -> None:
        """Write a log line."""
        level = messages.LogLevel.Warning if warning else messages.LogLevel.Info
        self._log.log(
            messages.Log(timestamp=_stamp(time_ns), level=level, message=line, name="outrider"),
            log_time=time_ns,
        )
