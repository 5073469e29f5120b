"""Maps and markers of a run as ROS 2 messages."""

import math
from collections.abc import Iterable
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from bus.messages.base import Vector
from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap
from outrider_ros2.conversion import MAP, base_link, header, point_at, pose_at, stamp, vector
from outrider_ros2.interfaces import RosMessage, make
from outrider_ros2.run_view import RunView
from sim.scene.colors import FAINT, HAZARDS, LIMIT, rgb

_FLAT = 0.02
"""Thickness of what lies on the ground [m]."""
_CORNERS = 72
"""Of a circle."""
_CYLINDER, _LINE_STRIP, _TRIANGLES = 3, 4, 11
_GRID = (-1, 0, 50, 100, 0, -1)
"""Occupancy of a tile by its code in a `GroundMap`: not seen, clear, rough, blocked, a find, seen and not told."""


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
        pose=pose_at(position),
        scale=vector(*scale),
        color=colour,
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
        if outline.polygon:
            first, *rest = outline.polygon
            corners = [one for pair in pairwise(rest) for one in (first, *pair)]
            found.append(mark(shape=_TRIANGLES, points=corners))
        else:
            side = 2.0 * (outline.radius or 0.0)
            found.append(mark(shape=_CYLINDER, position=outline.middle, scale=(side, side, _FLAT)))
    return make("visualization_msgs/msg/MarkerArray", markers=found)
