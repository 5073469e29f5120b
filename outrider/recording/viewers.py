"""What viewers of MCAP understand at once (Foxglove, Lichtblick): frames, poses, a scene, the grid, a log.

They are shown a few poses per simulated second: a viewer draws what lies between two of them by itself. Every tick
stands in our own channels.
"""

import math
from collections.abc import Mapping

from bus.errors import ScenarioError
from bus.messages import CoverageMap
from outrider import style
from outrider.recording.schemas import EXTRA, inner_radius
from sim.scenario.types import Scenario

try:  # an extra
    import foxglove
    from foxglove import channels, messages
except ImportError as absent:
    raise ScenarioError(EXTRA) from absent

_VIEW_PERIOD = 0.2
"""Simulated time between two poses [s], at least."""
_SCENE_PERIOD = 1.0
"""Simulated time between two scenes [s]; each holds everything, since a viewer that jumps sees only the newest."""
_TRACK_ROOM = 200
"""Points of a track; beyond that every second one is dropped."""
_UAV_HEIGHT, _UGV_HEIGHT = 1.0, 0.1
"""Where viewers show them [m]; the world itself is flat."""

Places = Mapping[str, tuple[float, float, float, float]]
"""Position [m] and velocity [m/s] of each vehicle: x, y, v_x, v_y."""


def _color(code: str, opacity: float = 1.0) -> messages.Color:
    r, g, b = (int(code[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    return messages.Color(r=r, g=g, b=b, a=opacity)


def _stamp(time_ns: int) -> messages.Timestamp:
    return messages.Timestamp(sec=time_ns // 1_000_000_000, nsec=time_ns % 1_000_000_000)


def _ring(
    radius: float, color: messages.Color, *, dashed: bool = False, thickness: float = 0.06
) -> messages.LinePrimitive:
    """A circle around a vehicle, in its own frame."""
    angles = [2.0 * math.pi * k / 96 for k in range(96)]
    return messages.LinePrimitive(
        type=messages.LinePrimitiveLineType.LineList
        if dashed
        else messages.LinePrimitiveLineType.LineLoop,
        thickness=thickness,
        points=[
            messages.Point3(x=radius * math.cos(angle), y=radius * math.sin(angle))
            for angle in angles
        ],
        color=color,
    )


class _Track:
    """Where a vehicle went: a line that gets coarser as it gets longer."""

    def __init__(self) -> None:
        self.points: list[messages.Point3] = []
        self._step, self._passed = 1, -1  # every so manieth point is kept

    def follow(self, x: float, y: float) -> None:
        """It has come here."""
        self._passed += 1
        if self._passed % self._step == 0:
            self.points.append(messages.Point3(x=x, y=y, z=0.02))
        if len(self.points) > _TRACK_ROOM:
            del self.points[1::2]
            self._step *= 2


class Viewers:
    """The channels for viewers of one file.

    Args:
        context: The file's.
    """

    def __init__(self, context: foxglove.Context) -> None:
        self._context = context
        self._tf = channels.FrameTransformsChannel("/tf", context=context)
        scene = messages.SceneUpdate.get_schema()
        self._scene = foxglove.Channel(
            "/scene", schema=scene, message_encoding="protobuf", context=context
        )
        self._grid = channels.GridChannel("/grid", context=context)
        self._log = channels.LogChannel("/log", context=context)
        self._poses: dict[str, channels.PoseInFrameChannel] = {}
        self.begin(None)

    def begin(self, scenario: Scenario | None) -> None:
        """Another flight begins."""
        self._scenario = scenario
        self._tracks: dict[str, _Track] = {}
        self._colors: dict[str, str] = {}
        self._yaw: dict[str, float] = {}
        self._bodies = b""
        self._next_view = self._next_scene = -math.inf

    def due(self, time: float) -> bool:
        """Whether they want to be shown this simulated time [s]."""
        return time >= self._next_view

    def show(self, time: float, places: Places, escorts: Mapping[str, str], time_ns: int) -> None:
        """Show where everybody is.

        Args:
            time: Simulated, of this flight [s].
            places: Of all vehicles.
            escorts: Each UAV, and the UGV it escorts.
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
        place: tuple[float, float, float, float],
        is_uav: bool,
        stamp: messages.Timestamp,
        time_ns: int,
    ) -> messages.FrameTransform:
        """Show one vehicle's pose; the same as a transform."""
        x, y, v_x, v_y = place
        if v_x * v_x + v_y * v_y > 1e-6:
            self._yaw[name] = math.atan2(v_y, v_x)
        half = 0.5 * self._yaw.get(name, 0.0)
        turn = messages.Quaternion(z=math.sin(half), w=math.cos(half))
        spot = messages.Vector3(x=x, y=y, z=_UAV_HEIGHT if is_uav else _UGV_HEIGHT)
        if name not in self._poses:
            self._poses[name] = channels.PoseInFrameChannel(f"/pose/{name}", context=self._context)
        pose = messages.Pose(position=spot, orientation=turn)
        self._poses[name].log(
            messages.PoseInFrame(timestamp=stamp, frame_id="world", pose=pose), log_time=time_ns
        )
        if name not in self._tracks:
            self._tracks[name] = _Track()
        self._tracks[name].follow(x, y)
        return messages.FrameTransform(
            timestamp=stamp,
            parent_frame_id="world",
            child_frame_id=name,
            translation=spot,
            rotation=turn,
        )

    def _draw(self, escorts: Mapping[str, str], stamp: messages.Timestamp, time_ns: int) -> None:
        if not self._bodies:
            self._bodies = messages.SceneUpdate(entities=self._entities(escorts)).encode()
        tracks = []
        for name, track in self._tracks.items():
            line = messages.LinePrimitive(
                type=messages.LinePrimitiveLineType.LineStrip,
                thickness=0.05,
                points=track.points,
                color=_color(self._colors[name], 0.8),
            )
            tracks.append(
                messages.SceneEntity(
                    timestamp=stamp, frame_id="world", id=f"{name} track", lines=[line]
                )
            )
        moving = messages.SceneUpdate(entities=tracks).encode()
        self._scene.log(
            self._bodies + moving, log_time=time_ns
        )  # protobuf joins the two lists of entities

    def _entities(self, escorts: Mapping[str, str]) -> list[messages.SceneEntity]:
        """Vehicles and circles: each hangs on its vehicle's frame, so they are made once."""
        uavs, ugvs = sorted(escorts), sorted(self._tracks.keys() - escorts.keys())
        self._colors = {name: style.color(style.UGV, k) for k, name in enumerate(ugvs)}
        self._colors |= {name: style.color(style.UAV, k) for k, name in enumerate(uavs)}
        followed = set(escorts.values())
        return [
            *(self._ugv(name, seen=name in followed) for name in ugvs),
            *(self._uav(name) for name in uavs),
        ]

    def _ugv(self, name: str, *, seen: bool) -> messages.SceneEntity:
        body = messages.CubePrimitive(
            size=messages.Vector3(x=0.7, y=0.45, z=0.3), color=_color(self._colors[name])
        )
        lines = self._sight(name) if seen else []
        return messages.SceneEntity(
            frame_id=name, id=name, frame_locked=True, cubes=[body], lines=lines
        )

    def _uav(self, name: str) -> messages.SceneEntity:
        color = _color(self._colors[name])
        size = messages.Vector3(x=0.6, y=0.6, z=0.12)
        body = messages.CylinderPrimitive(size=size, bottom_scale=1.0, top_scale=1.0, color=color)
        nose = messages.ArrowPrimitive(
            shaft_length=0.4, shaft_diameter=0.06, head_length=0.15, head_diameter=0.15, color=color
        )
        reach = (
            [_ring(self._scenario.sensor.range, color, thickness=0.03)] if self._scenario else []
        )
        return messages.SceneEntity(
            frame_id=name, id=name, frame_locked=True, cylinders=[body], arrows=[nose], lines=reach
        )

    def _sight(self, ugv: str) -> list[messages.LinePrimitive]:
        """r_v, and r_s where it is a circle of its own."""
        if self._scenario is None:
            return []
        r_v, red = self._scenario.visibility.radius, _color(style.LIMIT)
        lines = [_ring(r_v, red)]
        r_s = inner_radius(self._scenario, ugv)
        return [*lines, _ring(r_s, red, dashed=True, thickness=0.04)] if r_s is not None else lines

    def coverage(self, ground: CoverageMap, time_ns: int) -> None:
        """What was seen of the ground."""
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
        """A line for a person."""
        level = messages.LogLevel.Warning if warning else messages.LogLevel.Info
        self._log.log(
            messages.Log(timestamp=_stamp(time_ns), level=level, message=line, name="outrider"),
            log_time=time_ns,
        )
