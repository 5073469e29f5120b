"""Maps and markers of a run as ROS 2 messages."""

import math
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from bus.messages.base import Vector
from bus.messages.buildings import Building
from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap, Truth
from outrider_ros2.conversion import MAP, base_link, header, point_at, pose_at, stamp, vector
from outrider_ros2.interfaces import RosMessage, make
from outrider_ros2.places import Vector3, place_of
from outrider_ros2.run_view import RunView
from sim.scene.altitude import altitudes_of, ring_radius, sight_of
from sim.scene.colors import FAINT, GOOD, HAZARDS, LIMIT, building, rgb
from sim.scene.prism import prism

_FLAT = 0.02
"""Thickness of markers on the ground [m]."""
_CORNERS = 72
"""Number of corners of a circle."""
_CYLINDER, _LINE_STRIP, _TRIANGLES = 3, 4, 11
_GRID = (-1, 0, 50, 100, 0, -1)
"""Occupancy by the tile codes of `GroundMap`: unknown, clear, rough, blocked, find, observed but not reported."""


def _grid(seconds: float, cell: float, cells: np.ndarray[Any, Any]) -> RosMessage:
    rows, columns = cells.shape
    info = make(
        "nav_msgs/msg/MapMetaData",
        map_load_time=stamp(0.0),
        resolution=cell,
        width=columns,
        height=rows,
        origin=pose_at((0.0, 0.0)),
    )
    return make(
        "nav_msgs/msg/OccupancyGrid",
        header=header(seconds),
        info=info,
        data=cells.reshape(-1).astype(np.int8),
    )


def _cells(raw: bytes, rows: int, columns: int) -> np.ndarray[Any, Any]:
    return np.frombuffer(raw, np.uint8).reshape(rows, columns)


def coverage(view: RunView, source: CoverageMap) -> RosMessage:
    """Return the coverage of each cell as a share of its desired coverage [%]."""
    shares = _cells(source.cells, source.rows, source.columns).astype(np.uint16)
    return _grid(view.dt * source.tick, source.cell, (shares * 100 + 127) // 255)


def ground(view: RunView, source: GroundMap) -> RosMessage:
    """Return the ground known to the UGVs: -1 unknown, 0 clear, 50 rough, 100 blocked."""
    codes = _cells(source.tiles, source.rows, source.columns)
    return _grid(view.dt * source.tick, source.tile, np.array(_GRID, np.int8)[codes])


def _color(code: str, opacity: float) -> RosMessage:
    r, g, b = rgb(code)
    return make("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=opacity)


def marker(
    *,
    frame: str,
    name: str,
    number: int = 0,
    shape: int,
    color: RosMessage,
    position: Vector = (0.0, 0.0),
    scale: Vector3 = (1.0, 1.0, 1.0),
    points: Iterable[Vector | Vector3] = (),
) -> RosMessage:
    """Return a marker that moves with its frame until one with the same name and number replaces it."""
    return make(
        "visualization_msgs/msg/Marker",
        header=header(0.0, frame),
        ns=name,
        id=number,
        type=shape,
        action=0,
        pose=pose_at(position),
        scale=vector(*scale),
        color=color,
        lifetime=make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=True,
        points=[point_at(corner) for corner in points],
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
    """Return markers for the radii around the vehicles, the vehicles with their headings, and the edge of the area.

    Radii that depend on a UAV's altitude are in `sight`.
    """
    scene = view.scene
    still = [ring for ring in scene.rings if scene.space.camera is None or ring.symbol == "r_s"]
    found = [
        marker(
            frame=base_link(ring.around),
            name=f"{ring.around}/{ring.symbol}",
            shape=_LINE_STRIP,
            color=_color(ring.color, 0.9),
            scale=(0.05, 0.0, 0.0),
            points=_circle(ring.radius),
        )
        for ring in still
    ]
    found += [
        marker(
            frame=base_link(vehicle.name),
            name=f"{vehicle.name}/body",
            shape=_CYLINDER,
            color=_color(vehicle.color, 1.0),
            scale=(0.4, 0.4, 0.15),
        )
        for vehicle in scene.vehicles
    ]
    found += [
        marker(
            frame=base_link(vehicle.name),
            name=f"{vehicle.name}/heading",
            shape=_LINE_STRIP,
            color=_color(vehicle.color, 1.0),
            scale=(0.08, 0.0, 0.0),
            points=((0.0, 0.0), (0.5, 0.0)),
        )
        for vehicle in scene.vehicles
        if vehicle.steers
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
            color=_color(LIMIT, 0.5),
            scale=(0.05, 0.0, 0.0),
            points=corners,
        )
    )
    return make("visualization_msgs/msg/MarkerArray", markers=found)


def _circle(radius: float, center: Vector = (0.0, 0.0)) -> list[Vector]:
    angles = [2.0 * math.pi * k / _CORNERS for k in range(_CORNERS + 1)]
    x, y = center
    return [(x + radius * math.cos(angle), y + radius * math.sin(angle)) for angle in angles]


def buildings(found: Sequence[Building]) -> RosMessage:
    """Return solid markers for buildings, the taller the darker; None without buildings."""
    markers = [
        marker(
            frame=MAP,
            name="building",
            number=number,
            shape=_TRIANGLES,
            color=_color(building(one.height, found), 1.0),
            points=prism(one),
        )
        for number, one in enumerate(found)
    ]
    return make("visualization_msgs/msg/MarkerArray", markers=markers) if markers else None


def sight(view: RunView, truth: Truth) -> RosMessage:
    """Return markers for what UAVs with an altitude see; None if all fly in the plane.

    Fields of view and visibility radii are on the ground. The line from a UAV to its UGV is green while the UGV is
    visible, else red.
    """
    scene, altitudes = view.scene, altitudes_of(truth.vehicles)
    if scene.space.camera is None or not altitudes:
        return None
    mark = partial(marker, frame=MAP, shape=_LINE_STRIP, scale=(0.05, 0.0, 0.0))
    found = [
        mark(
            name=f"{ring.around}/{ring.symbol}",
            color=_color(ring.color, 0.9),
            points=_circle(
                ring_radius(scene, ring, altitudes), truth.vehicles[ring.around].position
            ),
        )
        for ring in scene.rings
        if ring.symbol != "r_s" and ring.around in truth.vehicles
    ]
    for one in truth.escorts:
        ends = [place_of(truth.vehicles[name]) for name in (one.uav, one.ugv)]
        color = _color(LIMIT if sight_of(one, math.inf).lost else GOOD, 1.0)
        found.append(mark(name=f"{one.uav}/line of sight", color=color, points=ends))
    return make("visualization_msgs/msg/MarkerArray", markers=found)


def hazards(view: RunView, source: GroundMap) -> RosMessage:
    """Return markers for the true hazards except buildings; hazards unknown to the UGVs are faint."""
    found = []
    for number, (outline, state) in enumerate(zip(view.hazards, source.states, strict=False)):
        if number in source.building_rows and state <= 1:
            continue
        color = _color(LIMIT if state > 1 else HAZARDS[outline.kind], 1.0 if state else FAINT)
        mark = partial(marker, frame=MAP, name=outline.kind, number=number, color=color)
        if outline.polygon:
            first, *rest = outline.polygon
            corners = [one for pair in pairwise(rest) for one in (first, *pair)]
            found.append(mark(shape=_TRIANGLES, points=corners))
        else:
            side = 2.0 * (outline.radius or 0.0)
            found.append(mark(shape=_CYLINDER, position=outline.middle, scale=(side, side, _FLAT)))
    return make("visualization_msgs/msg/MarkerArray", markers=found)
