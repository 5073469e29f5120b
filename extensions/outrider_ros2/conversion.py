"""Telemetry as ROS 2 messages: pure functions, one a topic.

Frames by REP 103 and 105: `map` with x east, y north, z up, in metres; `uav_0/base_link` moves in it. Vehicles are
points in the plane and have no heading, so a base_link is never turned against the map: what stands in the one frame
can be read in the other, and a twist in `uav_0/base_link` is the velocity in `map`. Stamps are simulated time.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np

from bus.errors import ScenarioError
from bus.messages.base import Message, Vector
from bus.messages.ground import GroundMap, HazardOutline
from bus.messages.links import LinkStatus
from bus.messages.telemetry import CoverageMap, EscortTruth, Geometry, Status, Truth, VehicleStatus
from outrider_ros2.interfaces import RosMessage, make
from sim.scene.colors import FAINT, HAZARDS, LIMIT, rgb
from sim.scene.model import Scene, observed_scene

LATEST = (1 << 31) * 1_000_000_000 - 1
"""The latest time [ns]: ROS 2 counts seconds in 32 bits."""
MAP = "map"
_FLAT = 0.02
"""Thickness of what lies on the ground [m]."""
_CORNERS = 72
"""Of a circle."""
_CYLINDER, _LINE_STRIP, _TRIANGLES = 3, 4, 11
OK, WARN, ERROR = range(3)
"""Levels of `diagnostic_msgs`."""
_LATE, _MISSING_SHARE = 1.0, 0.05
_GRID = (-1, 0, 50, 100, 0, -1)
"""Occupancy of a tile by its code in a `GroundMap`: not seen, clear, rough, blocked, a find, seen and not told."""


def base_link(vehicle: str) -> str:
    """The frame of a vehicle."""
    return f"{vehicle}/base_link"


def sensor_frame(vehicle: str) -> str:
    """The frame of a UAV's downward sensor."""
    return f"{vehicle}/sensor"


@dataclass(slots=True)
class PathTrack:
    """The way that a vehicle has come, thinned out: as many points however long it is."""

    times: list[float] = field(default_factory=list)
    """[s]"""
    positions: list[Vector] = field(default_factory=list)
    """[m]"""
    step: float = 0.1
    """Least distance between two points [m]."""

    def add(self, time: float, position: Vector, most: int = 500) -> None:
        """Take a position down if it is far enough from the last.

        Args:
            time: When [s].
            position: Where [m].
            most: Points from which on every second one is forgotten.
        """
        if self.times and time < self.times[-1]:
            self.times, self.positions, self.step = [], [], PathTrack().step  # another flight
        if self.positions and math.dist(self.positions[-1], position) < self.step:
            return
        self.times.append(time)
        self.positions.append(position)
        if len(self.times) > most:
            self.times = self.times[::2]
            self.positions = self.positions[::2]
            self.step = 2.0 * self.step


@dataclass(slots=True, kw_only=True)
class RunView:
    """The facts about a run that conversion needs beside the message itself."""

    scene: Scene
    dt: float
    """Time between two ticks [s]."""
    tracks: dict[str, PathTrack] = field(default_factory=dict)
    hazards: tuple[HazardOutline, ...] = ()
    """Of the flight: a recording tells them in its first map alone."""
    own: tuple[RosMessage, ...] = ()
    """Diagnostics of the bridge itself."""

    def follow(self, message: Message | None) -> None:
        """Take down what later messages need: the vehicles' positions for their paths, and a flight's hazards."""
        match message:
            case Truth():
                for name, vehicle in message.vehicles.items():
                    self.tracks.setdefault(name, PathTrack()).add(message.time, vehicle.position)
            case GroundMap() if message.hazards:
                self.hazards = message.hazards


def view_of(name: str, geometry: Geometry) -> RunView:
    """The view of a run that observers have.

    Args:
        name: Of the scenario.
        geometry: What they are told of it.
    """
    scene = observed_scene(name, geometry, escorts=geometry.uavs, vehicles=geometry.limits)
    return RunView(scene=scene, dt=geometry.dt)


def stamp(seconds: float) -> RosMessage:
    """A simulated time.

    Raises:
        ScenarioError: If ROS 2 cannot tell it: it counts seconds in 32 bits.
    """
    nanoseconds = round(seconds * 1e9)
    if nanoseconds > LATEST:
        raise ScenarioError(
            f"time = {seconds:g} s: out of range of ROS 2; allowed up to {LATEST / 1e9:g}"
        )
    return make(
        "builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
    )


def header(seconds: float, frame: str = MAP) -> RosMessage:
    """A header in a frame."""
    return make("std_msgs/msg/Header", stamp=stamp(seconds), frame_id=frame)


def _point(position: Vector) -> RosMessage:
    return make("geometry_msgs/msg/Point", x=position[0], y=position[1], z=0.0)


def _vector(x: float, y: float, z: float = 0.0) -> RosMessage:
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _upright() -> RosMessage:
    return make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)


def _pose(position: Vector) -> RosMessage:
    return make("geometry_msgs/msg/Pose", position=_point(position), orientation=_upright())


def _covariance(xx: float = 0.0, xy: float = 0.0, yy: float = 0.0) -> np.ndarray[Any, Any]:
    found = np.zeros(36)
    found[[0, 1, 6, 7]] = xx, xy, xy, yy
    return found


def clock(truth: Truth) -> RosMessage:
    """Simulated time, for nodes with `use_sim_time`."""
    return make("rosgraph_msgs/msg/Clock", clock=stamp(truth.time))


def transform(seconds: float, parent: str, child: str, position: Vector) -> RosMessage:
    """The place of a frame in another."""
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=header(seconds, parent),
        child_frame_id=child,
        transform=make(
            "geometry_msgs/msg/Transform", translation=_vector(*position), rotation=_upright()
        ),
    )


def transforms(truth: Truth) -> RosMessage:
    """True pose of each vehicle: `map` to its base_link."""
    found = [
        transform(truth.time, MAP, base_link(name), vehicle.position)
        for name, vehicle in truth.vehicles.items()
    ]
    return make("tf2_msgs/msg/TFMessage", transforms=found)


def static_transforms(view: RunView) -> RosMessage:
    """The UAVs' downward sensors: their x axis looks at the ground."""
    half = math.sqrt(0.5)
    down = make("geometry_msgs/msg/Quaternion", x=0.0, y=half, z=0.0, w=half)
    found = []
    for vehicle in view.scene.vehicles:
        if vehicle.flies:
            one = transform(0.0, base_link(vehicle.name), sensor_frame(vehicle.name), (0.0, 0.0))
            one.transform.rotation = down
            found.append(one)
    return make("tf2_msgs/msg/TFMessage", transforms=found)


def odometry(seconds: float, vehicle: str, position: Vector, velocity: Vector) -> RosMessage:
    """A vehicle's position and velocity.

    Args:
        seconds: When [s].
        vehicle: Its name.
        position: In `map` [m].
        velocity: In its base_link, which is never turned [m/s].
    """
    twist = make("geometry_msgs/msg/Twist", linear=_vector(*velocity), angular=_vector(0.0, 0.0))
    return make(
        "nav_msgs/msg/Odometry",
        header=header(seconds),
        child_frame_id=base_link(vehicle),
        pose=make(
            "geometry_msgs/msg/PoseWithCovariance", pose=_pose(position), covariance=_covariance()
        ),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=_covariance()),
    )


def true_odometry(truth: Truth, vehicle: str) -> RosMessage:
    """True pose and velocity of a vehicle."""
    state = truth.vehicles[vehicle]
    return odometry(truth.time, vehicle, state.position, state.velocity)


def acceleration(truth: Truth, vehicle: str) -> RosMessage:
    """Acceleration applied since the last tick, after the bounds [m/s²]."""
    return make(
        "geometry_msgs/msg/AccelStamped",
        header=header(truth.time, base_link(vehicle)),
        accel=make(
            "geometry_msgs/msg/Accel",
            linear=_vector(*truth.vehicles[vehicle].acceleration),
            angular=_vector(0.0, 0.0),
        ),
    )


def path(view: RunView, truth: Truth, vehicle: str) -> RosMessage:
    """The way that a vehicle has come."""
    track = view.tracks.get(vehicle, PathTrack())
    poses = [
        make("geometry_msgs/msg/PoseStamped", header=header(time), pose=_pose(position))
        for time, position in zip(track.times, track.positions, strict=True)
    ]
    return make("nav_msgs/msg/Path", header=header(truth.time), poses=poses)


def escort_of(truth: Truth, uav: str) -> EscortTruth | None:
    """The relation of a UAV to its UGV; None where it escorts none."""
    return next((one for one in truth.escorts if one.uav == uav), None)


def detection(seconds: float, uav: str, relative_position: Vector) -> RosMessage:
    """Place at which a UAV has seen its UGV, from itself: -p_delta.

    Args:
        seconds: When it was taken [s].
        uav: Its name.
        relative_position: p_delta = p_a - p_g with noise [m].
    """
    x, y = relative_position
    return make(
        "geometry_msgs/msg/PointStamped",
        header=header(seconds, base_link(uav)),
        point=_point((-x, -y)),
    )


def true_detection(truth: Truth, uav: str) -> RosMessage:
    """Detection of a UAV at this tick; None: it has none."""
    escort = escort_of(truth, uav)
    if escort is None or escort.detection is None:
        return None
    return detection(truth.time, uav, escort.detection)


def estimate(truth: Truth, uav: str) -> RosMessage:
    """A UAV's estimate of its UGV's place, with its covariance; None: it says nothing."""
    escort = escort_of(truth, uav)
    report = None if escort is None else escort.report
    if report is None:
        return None
    return make(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        header=header(truth.time),
        pose=make(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=_pose(report.estimate),
            covariance=_covariance(*report.covariance),
        ),
    )


def distance(truth: Truth, uav: str) -> RosMessage:
    """|p_a - p_g| of a UAV and its UGV [m]."""
    escort = escort_of(truth, uav)
    return None if escort is None else make("std_msgs/msg/Float64", data=escort.distance)


def coverage_error(truth: Truth, uav: str) -> RosMessage:
    """e(t) of (4) [m²]."""
    escort = escort_of(truth, uav)
    return None if escort is None else make("std_msgs/msg/Float64", data=escort.coverage_error)


def _grid(seconds: float, cell: float, cells: np.ndarray[Any, Any]) -> RosMessage:
    rows, columns = cells.shape
    info = make(
        "nav_msgs/msg/MapMetaData",
        map_load_time=stamp(0.0),
        resolution=cell,
        width=columns,
        height=rows,
        origin=_pose((0.0, 0.0)),
    )
    return make(
        "nav_msgs/msg/OccupancyGrid",
        header=header(seconds),
        info=info,
        data=cells.reshape(-1).astype(np.int8),
    )


def _cells(raw: bytes, rows: int, columns: int) -> np.ndarray[Any, Any]:
    return np.frombuffer(raw, np.uint8).reshape(rows, columns)


def coverage(view: RunView, told: CoverageMap) -> RosMessage:
    """The share of the desired coverage that each cell has [%]."""
    shares = _cells(told.cells, told.rows, told.columns).astype(np.uint16)
    return _grid(view.dt * told.tick, told.cell, (shares * 100 + 127) // 255)


def ground(view: RunView, told: GroundMap) -> RosMessage:
    """The ground as the UGVs know it: -1 not known, 0 clear, 50 rough, 100 blocked."""
    codes = _cells(told.tiles, told.rows, told.columns)
    return _grid(view.dt * told.tick, told.tile, np.array(_GRID, np.int8)[codes])


def _colour(code: str, opacity: float) -> RosMessage:
    r, g, b = rgb(code)
    return make("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=opacity)


def marker(
    *,
    frame: str,
    name: str,
    number: int = 0,
    shape: int,
    colour: RosMessage,
    position: Vector = (0.0, 0.0),
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
    points: Iterable[Vector] = (),
) -> RosMessage:
    """A marker that stays until another one with its name and number comes, and moves with its frame."""
    return make(
        "visualization_msgs/msg/Marker",
        header=header(0.0, frame),
        ns=name,
        id=number,
        type=shape,
        action=0,
        pose=_pose(position),
        scale=_vector(*scale),
        color=colour,
        lifetime=make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=True,
        points=[_point(corner) for corner in points],
        colors=[],
        texture_resource="",
        texture=make(
            "sensor_msgs/msg/CompressedImage",
            header=header(0.0, ""),
            format="",
            data=np.zeros(0, np.uint8),
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=make("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
    )


def discs(view: RunView) -> RosMessage:
    """Circles that move with the vehicles, the vehicles themselves, and the edge of the ground."""
    scene = view.scene
    found = [
        marker(
            frame=base_link(ring.around),
            name=f"{ring.around}/{ring.symbol}",
            shape=_LINE_STRIP,
            colour=_colour(ring.color, 0.9),
            scale=(0.05, 0.0, 0.0),
            points=_circle(ring.radius),
        )
        for ring in scene.rings
    ]
    found += [
        marker(
            frame=base_link(vehicle.name),
            name=f"{vehicle.name}/body",
            shape=_CYLINDER,
            colour=_colour(vehicle.color, 1.0),
            scale=(0.4, 0.4, 0.15),
        )
        for vehicle in scene.vehicles
    ]
    corners = [
        (0.0, 0.0),
        (scene.width, 0.0),
        (scene.width, scene.height),
        (0.0, scene.height),
        (0.0, 0.0),
    ]
    found.append(
        marker(
            frame=MAP,
            name="area",
            shape=_LINE_STRIP,
            colour=_colour(LIMIT, 0.5),
            scale=(0.05, 0.0, 0.0),
            points=corners,
        )
    )
    return make("visualization_msgs/msg/MarkerArray", markers=found)


def _circle(radius: float) -> list[Vector]:
    angles = [2.0 * math.pi * k / _CORNERS for k in range(_CORNERS + 1)]
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]


def hazards(view: RunView, told: GroundMap) -> RosMessage:
    """The hazards as they truly lie on the ground; faint those that no UGV knows of."""
    found = []
    for number, (outline, state) in enumerate(zip(view.hazards, told.states, strict=False)):
        colour = _colour(LIMIT if state > 1 else HAZARDS[outline.kind], 1.0 if state else FAINT)
        mark = partial(marker, frame=MAP, name=outline.kind, number=number, colour=colour)
        if outline.radius > 0.0:
            side = 2.0 * outline.radius
            found.append(mark(shape=_CYLINDER, position=outline.center, scale=(side, side, _FLAT)))
        else:
            first, *rest = outline.corners
            corners = [one for pair in pairwise(rest) for one in (first, *pair)]
            found.append(mark(shape=_TRIANGLES, points=corners))
    return make("visualization_msgs/msg/MarkerArray", markers=found)


def _fields(message: Message, *names: str) -> dict[str, object]:
    """Some fields of one of our messages, by their names."""
    return {name: getattr(message, name) for name in names}


def _told(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "-" if value is None else str(value)


def diagnostic(
    name: str, values: Mapping[str, object], *, level: int = OK, message: str = "ok"
) -> RosMessage:
    """The state of one part of the run.

    Args:
        name: Of the part.
        values: Numbers and words, by name.
        level: One of OK, WARN and ERROR.
        message: In a few words.
    """
    return make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=f"outrider: {name}",
        message=message,
        hardware_id="outrider",
        values=[
            make("diagnostic_msgs/msg/KeyValue", key=key, value=_told(value))
            for key, value in values.items()
        ],
    )


def _run_diagnostic(status: Status) -> RosMessage:
    warnings = (*status.warnings, *status.refusals[-1:])
    words = "over" if status.over else "paused" if status.paused else "flying"
    pace = ("realtime_factor", "wanted_factor", "late_ticks")
    return diagnostic(
        "run",
        _fields(status, "scenario", "seed", "tick", "ticks", "law", *pace)
        | {f"driver of {name}": driver for name, driver in status.drivers.items()},
        level=WARN if warnings else OK,
        message="; ".join((words, *warnings)),
    )


def _link_diagnostic(name: str, link: LinkStatus) -> RosMessage:
    ratio = link.delivery_ratio
    bad = ratio is not None and ratio < 1.0 - _MISSING_SHARE
    words = ["loses messages"] if bad else []
    if link.age is not None and link.age > _LATE:
        words.append(f"its newest is {link.age:.1f} s old")
    counts, ages = ("sent", "delivered", "waiting", "flying"), ("age", "mean_age", "max_age")
    return diagnostic(
        f"link {name}",
        _fields(link, *counts, "delivery_ratio", *ages)
        | {f"lost: {cause}": count for cause, count in link.lost.items()},
        level=WARN if words else OK,
        message=", ".join(words) or "ok",
    )


def _vehicle_diagnostic(name: str, vehicle: VehicleStatus, *, over: bool) -> RosMessage:
    gone = not vehicle.present and not over
    faulty = bool(vehicle.missing_commands or vehicle.refused or vehicle.last_fault)
    faults = ("missing_commands", "stale_commands", "shortened_commands", "lost", "rejoined")
    return diagnostic(
        f"vehicle {name}",
        _fields(vehicle, "present", *faults)
        | {f"refused: {cause}": count for cause, count in vehicle.refused.items()},
        level=ERROR if gone else WARN if faulty else OK,
        message="its process is away" if gone else vehicle.last_fault or "ok",
    )


def diagnostics(status: Status, own: Iterable[RosMessage] = ()) -> RosMessage:
    """The run, its links, its vehicles' processes, and what is certified or why it is not.

    Args:
        status: What the simulator tells.
        own: More of them.
    """
    found = [_run_diagnostic(status)]
    found += [
        diagnostic(
            f"certificate {name}",
            {"certified": certified},
            level=OK if certified else WARN,
            message="sight is certified to be kept"
            if certified
            else f"not certified: {status.uncertified[name].text}",
        )
        for name, certified in status.certified.items()
    ]
    if status.mission is not None:
        told, hits = msgspec.structs.asdict(status.mission), status.mission.hazards_hit
        of_ugvs = told.pop("guarantees")
        found.append(diagnostic("mission", told, level=WARN if hits else OK))
        found += [
            diagnostic(
                f"known ground {name}",
                msgspec.structs.asdict(one),
                level=WARN if one.certificate_broken else OK,
            )
            for name, one in of_ugvs.items()
        ]
    found += [
        _vehicle_diagnostic(name, vehicle, over=status.over)
        for name, vehicle in status.vehicles.items()
    ]
    found += [_link_diagnostic(name, link) for name, link in status.links.items()]
    return make(
        "diagnostic_msgs/msg/DiagnosticArray",
        header=header(status.time, ""),
        status=[*found, *own],
    )
