"""Table of the ROS 2 topics, from which publication, bags and documentation are derived."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from bus.messages.base import Message
from bus.messages.ground import GroundMap
from bus.messages.telemetry import CoverageMap, Status, Truth
from outrider_ros2 import conversion, diagnostics, pictures
from outrider_ros2.interfaces import encode, type_hash
from outrider_ros2.roles import PILOT
from outrider_ros2.run_view import RunView
from outrider_ros2.wire import (
    CLOCK,
    LATCHED,
    NEWEST,
    RELIABLE,
    SENSOR,
    Qos,
    WireTopic,
)
from sim.scene.model import Scene


class Each(StrEnum):
    """The owners of a topic: there is one topic for each of them."""

    RUN = "run"
    VEHICLE = "vehicle"
    UAV = "uav"
    UGV = "ugv"
    TEAM_UAV = "team_uav"
    """UAVs that belong to a team."""


Convert = Callable[[RunView, Any, str], Any]
"""Function that converts a message of the run for a vehicle to a ROS 2 message, or returns None."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicRow:
    """One topic, or one topic per vehicle of a kind."""

    name: str
    """Last part of the topic name, after the vehicle's name."""
    each: Each = Each.RUN
    interface: str
    """Type, such as `nav_msgs/msg/Odometry`."""
    qos: Qos = RELIABLE
    source: type[Message] | None = None
    """Message that is converted; None for a static topic."""
    convert: Convert = lambda _view, _message, _name: None
    """Conversion; by default none, since the pilot of a vehicle converts its own messages."""
    period: float = 0.0
    """Minimum time between two messages [s]: wall time, or simulated time in a bag."""
    about: str
    """Description, for the documentation."""

    def names(self, scene: Scene) -> Iterator[tuple[str, str]]:
        """Yield vehicle and topic name (without namespace) for each vehicle with this topic."""
        if self.each is Each.RUN:
            yield "", f"/{self.name}"
            return
        teamed = {name for team in scene.teams for name in team}
        for vehicle in scene.vehicles:
            kind = Each.UAV if vehicle.flies else Each.UGV
            in_team = self.each is Each.TEAM_UAV and vehicle.name in teamed
            if in_team or self.each in (Each.VEHICLE, kind):
                yield vehicle.name, f"/{vehicle.name}/{self.name}"


TOPICS: tuple[TopicRow, ...] = (
    TopicRow(
        name="clock",
        interface="rosgraph_msgs/msg/Clock",
        qos=CLOCK,
        source=Truth,
        convert=lambda _view, truth, _name: conversion.clock(truth),
        about="Simulated time, for nodes with `use_sim_time`.",
    ),
    TopicRow(
        name="tf",
        interface="tf2_msgs/msg/TFMessage",
        qos=Qos(depth=100),
        source=Truth,
        convert=lambda _view, truth, _name: conversion.transforms(truth),
        about="True pose of each vehicle: `map` to `uav_0/base_link`.",
    ),
    TopicRow(
        name="tf_static",
        interface="tf2_msgs/msg/TFMessage",
        qos=LATCHED,
        convert=lambda view, _message, _name: conversion.static_transforms(view),
        about="Downward sensors of the UAVs: `uav_0/base_link` to `uav_0/sensor`, whose x axis points at the ground.",
    ),
    TopicRow(
        name="odom",
        each=Each.VEHICLE,
        interface="nav_msgs/msg/Odometry",
        source=Truth,
        convert=conversion.true_odometry,
        about="True pose and velocity of a vehicle, the latter in its base_link.",
    ),
    TopicRow(
        name="accel",
        each=Each.VEHICLE,
        interface="geometry_msgs/msg/AccelStamped",
        source=Truth,
        convert=lambda _view, truth, name: conversion.acceleration(truth, name),
        about="Acceleration applied since the last tick, after clipping to the bounds, in base_link.",
    ),
    TopicRow(
        name="path",
        each=Each.VEHICLE,
        interface="nav_msgs/msg/Path",
        qos=NEWEST,
        source=Truth,
        convert=conversion.path,
        period=1.0,
        about="Path of the vehicle so far, with at most 500 points.",
    ),
    TopicRow(
        name="detection",
        each=Each.UAV,
        interface="geometry_msgs/msg/PointStamped",
        qos=SENSOR,
        source=Truth,
        convert=lambda _view, truth, name: conversion.true_detection(truth, name),
        about="Detection of the UGV at this tick, with noise, relative to `uav_0/base_link`.",
    ),
    TopicRow(
        name="estimate",
        each=Each.UAV,
        interface="geometry_msgs/msg/PoseWithCovarianceStamped",
        source=Truth,
        convert=lambda _view, truth, name: conversion.estimate(truth, name),
        about="Estimated position of the UGV, with its covariance.",
    ),
    TopicRow(
        name="distance",
        each=Each.UAV,
        interface="std_msgs/msg/Float64",
        source=Truth,
        convert=lambda _view, truth, name: conversion.distance(truth, name),
        about="True distance between the UAV and its UGV, in m.",
    ),
    TopicRow(
        name="coverage_error",
        each=Each.UAV,
        interface="std_msgs/msg/Float64",
        source=Truth,
        convert=lambda _view, truth, name: conversion.coverage_error(truth, name),
        about="Coverage error e(t), eq. (4), in m².",
    ),
    TopicRow(
        name="role",
        each=Each.TEAM_UAV,
        interface="std_msgs/msg/String",
        source=Status,
        convert=lambda _view, status, name: conversion.role(status, name),
        about="Role in the team: SCOUT, RELIEF, GUARD or AWAY.",
    ),
    TopicRow(
        name="number",
        each=Each.TEAM_UAV,
        interface="std_msgs/msg/UInt64",
        source=Status,
        convert=lambda _view, status, name: conversion.number(status, name),
        about="Stored number in the team, 0 before the UAV has guarded; the largest ones guard.",
    ),
    TopicRow(
        name="battery",
        each=Each.TEAM_UAV,
        interface="sensor_msgs/msg/BatteryState",
        source=Status,
        convert=lambda _view, status, name: conversion.battery(status, name),
        about="Charge as a share of the endurance; nothing for unlimited flight times.",
    ),
    TopicRow(
        name="discs",
        interface="visualization_msgs/msg/MarkerArray",
        qos=LATCHED,
        convert=lambda view, _message, _name: pictures.discs(view),
        about="Visibility radius, sensor range, vehicles and edge of the area, moving with their frames.",
    ),
    TopicRow(
        name="buildings",
        interface="visualization_msgs/msg/MarkerArray",
        qos=LATCHED,
        convert=lambda view, _message, _name: pictures.buildings(view.scene.space.buildings),
        about="Buildings as solid bodies, the taller the darker.",
    ),
    TopicRow(
        name="sight",
        interface="visualization_msgs/msg/MarkerArray",
        qos=NEWEST,
        source=Truth,
        convert=lambda view, truth, _name: pictures.sight(view, truth),
        period=0.1,
        about="Field of view and visibility radius of UAVs with an altitude, and their lines of sight: red if hidden.",
    ),
    TopicRow(
        name="coverage",
        interface="nav_msgs/msg/OccupancyGrid",
        qos=LATCHED,
        source=CoverageMap,
        convert=lambda view, message, _name: pictures.coverage(view, message),
        about="Coverage of each cell as a share of its desired coverage, in percent; at most 5 Hz.",
    ),
    TopicRow(
        name="ground",
        interface="nav_msgs/msg/OccupancyGrid",
        qos=LATCHED,
        source=GroundMap,
        convert=lambda view, message, _name: pictures.ground(view, message),
        about="Ground known to the UGVs: -1 unknown, 0 clear, 50 rough, 100 blocked.",
    ),
    TopicRow(
        name="hazards",
        interface="visualization_msgs/msg/MarkerArray",
        qos=LATCHED,
        source=GroundMap,
        convert=lambda view, message, _name: pictures.hazards(view, message),
        about="True hazards on the ground: faint if unknown to the UGVs, red if hit.",
    ),
    TopicRow(
        name="diagnostics",
        interface="diagnostic_msgs/msg/DiagnosticArray",
        source=Status,
        convert=lambda view, status, _name: diagnostics.diagnostics(status, view.own),
        about="State of the run, its links and vehicle processes; certificates, with reasons if not certified.",
    ),
)
"""Topics with the truth, for observers only; no vehicle may read them."""

OBSERVATION = TopicRow(
    name=f"{PILOT}/observation",
    each=Each.VEHICLE,
    interface="std_msgs/msg/String",
    about="Complete observation of the vehicle at a tick, as JSON.",
)
BRIEFING = TopicRow(
    name=f"{PILOT}/briefing",
    each=Each.VEHICLE,
    interface="std_msgs/msg/String",
    qos=LATCHED,
    about="Complete briefing of the vehicle when it joined, as JSON.",
)
OWN_ODOMETRY = TopicRow(
    name=f"{PILOT}/odom",
    each=Each.VEHICLE,
    interface="nav_msgs/msg/Odometry",
    about="Position, velocity and heading in the vehicle's observation.",
)
OWN_DETECTION = TopicRow(
    name=f"{PILOT}/detection",
    each=Each.UAV,
    interface="geometry_msgs/msg/PointStamped",
    about="Each detection received by the UAV's computer.",
)
OWN_BUILDINGS = TopicRow(
    name=f"{PILOT}/buildings",
    each=Each.VEHICLE,
    interface="visualization_msgs/msg/MarkerArray",
    qos=LATCHED,
    about="Buildings that the vehicle knows, from its briefing or, for a UAV, by discovery.",
)
PILOT_TOPICS = (OBSERVATION, BRIEFING, OWN_ODOMETRY, OWN_DETECTION, OWN_BUILDINGS)
"""Topics for the node of a vehicle: the vehicle's own information. No other party may read them."""
PILOT_COMMANDS = (
    TopicRow(
        name=f"{PILOT}/command",
        each=Each.VEHICLE,
        interface="std_msgs/msg/String",
        about="Complete command as JSON, with radio messages and backup trajectories.",
    ),
    TopicRow(
        name=f"{PILOT}/accel",
        each=Each.VEHICLE,
        interface="geometry_msgs/msg/AccelStamped",
        about="Commanded acceleration, with the stamp of the observation that it answers.",
    ),
)
"""Answers of the node of a vehicle, in one of two forms; the first answer counts."""


def wire_topic(interface: str, name: str, namespace: str = "") -> WireTopic:
    """Return a topic with the hash of its type.

    Args:
        interface: Type, such as `nav_msgs/msg/Odometry`.
        name: Absolute name, without namespace.
        namespace: Namespace, such as `/fleet`; empty: none.
    """
    return WireTopic(name=f"{namespace}{name}", interface=interface, hash=type_hash(interface))


def messages_of(
    view: RunView, message: Message | None, *, wanted: Iterable[str] | None = None
) -> Iterator[tuple[str, bytes]]:
    """Yield name (without namespace) and CDR of each topic converted from a message.

    Args:
        view: Context of the run.
        message: Message of the run; None for the static topics.
        wanted: Names of topics to convert, without namespace; None: all.
    """
    view.follow(message)
    source = None if message is None else type(message)
    for row in TOPICS:
        if row.source is not source:
            continue
        for vehicle, name in row.names(view.scene):
            if wanted is not None and name not in wanted:
                continue
            made = row.convert(view, message, vehicle)
            if made is not None:
                yield name, encode(row.interface, made)
