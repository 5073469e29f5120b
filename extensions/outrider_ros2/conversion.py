"""Telemetry as ROS 2 messages: pure functions, one a topic.

Frames by REP 103 and 105: `map` with x east, y north, z up, in metres; `uav_0/base_link` moves in it. Vehicles are
points in the plane and have no heading, so a base_link is never turned against the map: what stands in the one frame
can be read in the other, and a twist in `uav_0/base_link` is the velocity in `map`. Stamps are simulated time.
"""

import math
from typing import Any

import numpy as np

from bus.errors import ScenarioError
from bus.messages.base import Vector
from bus.messages.telemetry import EscortTruth, Truth
from outrider_ros2.interfaces import RosMessage, make
from outrider_ros2.run_view import PathTrack, RunView

LATEST = (1 << 31) * 1_000_000_000 - 1
"""The latest time [ns]: ROS 2 counts seconds in 32 bits."""
MAP = "map"


def base_link(vehicle: str) -> str:
    """The frame of a vehicle."""
    return f"{vehicle}/base_link"


def sensor_frame(vehicle: str) -> str:
    """The frame of a UAV's downward sensor."""
    return f"{vehicle}/sensor"


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


def point_at(position: Vector) -> RosMessage:
    """Return a point on the ground [m]."""
    return make("geometry_msgs/msg/Point", x=position[0], y=position[1], z=0.0)


def vector(x: float, y: float, z: float = 0.0) -> RosMessage:
    """Return a vector."""
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _upright() -> RosMessage:
    return make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)


def pose_at(position: Vector) -> RosMessage:
    """Return the pose of what stands there, not turned [m]."""
    return make("geometry_msgs/msg/Pose", position=point_at(position), orientation=_upright())


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
            "geometry_msgs/msg/Transform", translation=vector(*position), rotation=_upright()
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
    twist = make("geometry_msgs/msg/Twist", linear=vector(*velocity), angular=vector(0.0, 0.0))
    return make(
        "nav_msgs/msg/Odometry",
        header=header(seconds),
        child_frame_id=base_link(vehicle),
        pose=make(
            "geometry_msgs/msg/PoseWithCovariance", pose=pose_at(position), covariance=_covariance()
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
            linear=vector(*truth.vehicles[vehicle].acceleration),
            angular=vector(0.0, 0.0),
        ),
    )


def path(view: RunView, truth: Truth, vehicle: str) -> RosMessage:
    """The way that a vehicle has come."""
    track = view.tracks.get(vehicle, PathTrack())
    poses = [
        make("geometry_msgs/msg/PoseStamped", header=header(time), pose=pose_at(position))
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
        point=point_at((-x, -y)),
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
            pose=pose_at(report.estimate),
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
