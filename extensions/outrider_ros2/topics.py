"""THE table of ROS 2 topics: one row each. Publishing, bags and the page of the documentation are derived from it."""

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


Convert = Callable[[RunView, Any, str], Any]
"""Makes a ROS 2 message of the run, one of its own messages and the name of a vehicle; None: there is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicRow:
    """One topic, or one for each vehicle of a kind."""

    name: str
    """The last part, after the vehicle's name."""
    each: Each = Each.RUN
    interface: str
    """Such as `nav_msgs/msg/Odometry`."""
    qos: Qos = RELIABLE
    source: type[Message] | None = None
    """The message that it is made of; None: of what stays as it is."""
    convert: Convert = lambda _view, _message, _name: None
    """By default there is nothing to convert: a vehicle's own node does it itself."""
    period: float = 0.0
    """Time between two of them at least [s]: of the wall clock, in a bag of the simulated one."""
    about: str
    """One line, for the documentation."""

    def names(self, scene: Scene) -> Iterator[tuple[str, str]]:
        """The vehicle and the topic's name without namespace, for each vehicle that has one."""
        if self.each is Each.RUN:
            yield "", f"/{self.name}"
            return
        for vehicle in scene.vehicles:
            kind = Each.UAV if vehicle.flies else Each.UGV
            if self.each in (Each.VEHICLE, kind):
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
        about="Where each vehicle truly is: `map` to `uav_0/base_link`.",
    ),
    TopicRow(
        name="tf_static",
        interface="tf2_msgs/msg/TFMessage",
        qos=LATCHED,
        convert=lambda view, _message, _name: conversion.static_transforms(view),
        about="The UAVs' downward sensors: `uav_0/base_link` to `uav_0/sensor`, whose x axis looks at the ground.",
    ),
    TopicRow(
        name="odom",
        each=Each.VEHICLE,
        interface="nav_msgs/msg/Odometry",
        source=Truth,
        convert=lambda _view, truth, name: conversion.true_odometry(truth, name),
        about="Where a vehicle truly is, and its velocity.",
    ),
    TopicRow(
        name="accel",
        each=Each.VEHICLE,
        interface="geometry_msgs/msg/AccelStamped",
        source=Truth,
        convert=lambda _view, truth, name: conversion.acceleration(truth, name),
        about="The acceleration that was applied since the last tick, after the bounds.",
    ),
    TopicRow(
        name="path",
        each=Each.VEHICLE,
        interface="nav_msgs/msg/Path",
        qos=NEWEST,
        source=Truth,
        convert=conversion.path,
        period=1.0,
        about="The way that it has come, in at most 500 points.",
    ),
    TopicRow(
        name="detection",
        each=Each.UAV,
        interface="geometry_msgs/msg/PointStamped",
        qos=SENSOR,
        source=Truth,
        convert=lambda _view, truth, name: conversion.true_detection(truth, name),
        about="Where the UAV's detector has seen its UGV at this tick, with noise, from `uav_0/base_link`.",
    ),
    TopicRow(
        name="estimate",
        each=Each.UAV,
        interface="geometry_msgs/msg/PoseWithCovarianceStamped",
        source=Truth,
        convert=lambda _view, truth, name: conversion.estimate(truth, name),
        about="Where the UAV believes its UGV to be, with the covariance of its filter.",
    ),
    TopicRow(
        name="distance",
        each=Each.UAV,
        interface="std_msgs/msg/Float64",
        source=Truth,
        convert=lambda _view, truth, name: conversion.distance(truth, name),
        about="True distance from the UAV to its UGV, in m.",
    ),
    TopicRow(
        name="coverage_error",
        each=Each.UAV,
        interface="std_msgs/msg/Float64",
        source=Truth,
        convert=lambda _view, truth, name: conversion.coverage_error(truth, name),
        about="e(t) of (4), in m².",
    ),
    TopicRow(
        name="discs",
        interface="visualization_msgs/msg/MarkerArray",
        qos=LATCHED,
        convert=lambda view, _message, _name: pictures.discs(view),
        about="Limit of sight, range of the sensor, the vehicles, edge of the area; moving with the frames.",
    ),
    TopicRow(
        name="coverage",
        interface="nav_msgs/msg/OccupancyGrid",
        qos=LATCHED,
        source=CoverageMap,
        convert=lambda view, told, _name: pictures.coverage(view, told),
        about="Share of the desired coverage of each cell, in percent; at most five times a second.",
    ),
    TopicRow(
        name="ground",
        interface="nav_msgs/msg/OccupancyGrid",
        qos=LATCHED,
        source=GroundMap,
        convert=lambda view, told, _name: pictures.ground(view, told),
        about="The ground as the UGVs know it: -1 unknown, 0 clear, 50 rough, 100 blocked.",
    ),
    TopicRow(
        name="hazards",
        interface="visualization_msgs/msg/MarkerArray",
        qos=LATCHED,
        source=GroundMap,
        convert=lambda view, told, _name: pictures.hazards(view, told),
        about="The hazards as they truly lie on the ground; faint where no UGV knows of one, red where one was hit.",
    ),
    TopicRow(
        name="diagnostics",
        interface="diagnostic_msgs/msg/DiagnosticArray",
        source=Status,
        convert=lambda view, status, _name: diagnostics.diagnostics(status, view.own),
        about="The run, its links, its vehicles' processes; what is certified, and why not.",
    ),
)
"""Topics of observers: the truth. No vehicle may read any of them."""

OBSERVATION = TopicRow(
    name=f"{PILOT}/observation",
    each=Each.VEHICLE,
    interface="std_msgs/msg/String",
    about="All that the vehicle is told at a tick, as JSON: nothing is lost.",
)
BRIEFING = TopicRow(
    name=f"{PILOT}/briefing",
    each=Each.VEHICLE,
    interface="std_msgs/msg/String",
    qos=LATCHED,
    about="All that the vehicle was told when it joined, as JSON.",
)
OWN_ODOMETRY = TopicRow(
    name=f"{PILOT}/odom",
    each=Each.VEHICLE,
    interface="nav_msgs/msg/Odometry",
    about="Position and velocity as the vehicle is told them.",
)
OWN_DETECTION = TopicRow(
    name=f"{PILOT}/detection",
    each=Each.UAV,
    interface="geometry_msgs/msg/PointStamped",
    about="Each detection that has come to the UAV's computer.",
)
PILOT_TOPICS = (OBSERVATION, BRIEFING, OWN_ODOMETRY, OWN_DETECTION)
"""Topics of a vehicle's own node: its observation, and nothing else. Nobody else may read them."""
PILOT_COMMANDS = (
    TopicRow(
        name=f"{PILOT}/command",
        each=Each.VEHICLE,
        interface="std_msgs/msg/String",
        about="The whole command as JSON, with radio messages and motions: nothing is lost.",
    ),
    TopicRow(
        name=f"{PILOT}/accel",
        each=Each.VEHICLE,
        interface="geometry_msgs/msg/AccelStamped",
        about="The commanded acceleration; its stamp is that of the observation which it answers.",
    ),
)
"""Answers of a vehicle's own node, in one form or the other: the first of them counts."""


def wire_topic(interface: str, name: str, namespace: str = "") -> WireTopic:
    """A topic of a type as it travels.

    Args:
        interface: Such as `nav_msgs/msg/Odometry`.
        name: Absolute, without namespace.
        namespace: Such as `/fleet`; empty: none.
    """
    return WireTopic(name=f"{namespace}{name}", interface=interface, hash=type_hash(interface))


def messages_of(
    view: RunView, message: Message | None, *, wanted: Iterable[str] | None = None
) -> Iterator[tuple[str, bytes]]:
    """Converts one of our messages: the name of each topic that is made of it, without namespace, and the CDR for it.

    Args:
        view: The run that it is of.
        message: What the simulator tells; None: what stays as it is.
        wanted: Names of topics, without namespace; None: all.
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
