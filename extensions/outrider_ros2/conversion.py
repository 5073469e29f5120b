"""Conversion of telemetry to ROS 2 messages: one pure function per topic.

Frames follow REP 103 and 105: `map` with x east, y north, z up, in metres; `uav_0/base_link` moves in it. The base_link
of a UGV that steers has its heading as x axis. All other vehicles are points without a heading: their base_link has the
orientation of `map`, so a twist in it is the velocity in `map`. z is 0 except for UAVs with an altitude. Stamps are
simulated time.
"""

import math
from typing import Any

import numpy as np

from bus.errors import ScenarioError
from bus.messages.base import Vector
from bus.messages.telemetry import EscortTruth, Status, Truth
from outrider_ros2.headings import TurnRate, in_base_link
from outrider_ros2.interfaces import RosMessage, make
from outrider_ros2.places import Vector3, place_of
from outrider_ros2.run_view import PathTrack, RunView

LATEST = (1 << 31) * 1_000_000_000 - 1
"""Latest time that ROS 2 can represent [ns]: it counts seconds in 32 bits."""
MAP = "map"


def base_link(vehicle: str) -> str:
    """Return the frame of a vehicle."""
    return f"{vehicle}/base_link"


def sensor_frame(vehicle: str) -> str:
    """Return the frame of a UAV's downward sensor."""
    return f"{vehicle}/sensor"


def stamp(seconds: float) -> RosMessage:
    """Return a simulated time [s] as a ROS 2 time.

    Raises:
        ScenarioError: If the time exceeds the 32-bit seconds of ROS 2.
    """
    nanoseconds = round(seconds * 1e9)
    if nanoseconds > LATEST:
        raise ScenarioError(
            f"time = {seconds:g} s: out of range of ROS 2; allowed: up to {LATEST / 1e9:g}"
        )
    return make(
        "builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
    )


def header(seconds: float, frame: str = MAP) -> RosMessage:
    """Return a header with a simulated time [s] and a frame."""
    return make("std_msgs/msg/Header", stamp=stamp(seconds), frame_id=frame)


def point_at(position: Vector | Vector3) -> RosMessage:
    """Return a point [m], on the ground without a third coordinate."""
    x, y, z = (*position, 0.0)[:3]
    return make("geometry_msgs/msg/Point", x=x, y=y, z=z)


def vector(x: float, y: float, z: float = 0.0) -> RosMessage:
    """Return a vector."""
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _rotation(heading: float | None) -> RosMessage:
    """Return a rotation about the vertical axis to a heading [rad]; None: no rotation."""
    half = 0.5 * (heading or 0.0)
    return make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))


def pose_at(position: Vector | Vector3, heading: float | None = None) -> RosMessage:
    """Return a pose at a position [m], on the ground without a third coordinate; `heading`: None: no rotation."""
    return make(
        "geometry_msgs/msg/Pose", position=point_at(position), orientation=_rotation(heading)
    )


def _covariance(xx: float = 0.0, xy: float = 0.0, yy: float = 0.0) -> np.ndarray[Any, Any]:
    found = np.zeros(36)
    found[[0, 1, 6, 7]] = xx, xy, xy, yy
    return found


def clock(truth: Truth) -> RosMessage:
    """Return the simulated time, for nodes with `use_sim_time`."""
    return make("rosgraph_msgs/msg/Clock", clock=stamp(truth.time))


def transform(
    seconds: float,
    parent: str,
    child: str,
    position: Vector | Vector3,
    heading: float | None = None,
) -> RosMessage:
    """Return the transform from a parent to a child frame at a position [m] with a heading [rad]; None: no rotation."""
    return make(
        "geometry_msgs/msg/TransformStamped",
        header=header(seconds, parent),
        child_frame_id=child,
        transform=make(
            "geometry_msgs/msg/Transform",
            translation=vector(*position),
            rotation=_rotation(heading),
        ),
    )


def transforms(truth: Truth) -> RosMessage:
    """Return the true pose of each vehicle: `map` to its base_link."""
    found = [
        transform(truth.time, MAP, base_link(name), place_of(vehicle), vehicle.heading)
        for name, vehicle in truth.vehicles.items()
    ]
    return make("tf2_msgs/msg/TFMessage", transforms=found)


def static_transforms(view: RunView) -> RosMessage:
    """Return the transforms of the UAVs' downward sensors, whose x axes point at the ground."""
    half = math.sqrt(0.5)
    down = make("geometry_msgs/msg/Quaternion", x=0.0, y=half, z=0.0, w=half)
    found = []
    for vehicle in view.scene.vehicles:
        if vehicle.flies:
            one = transform(0.0, base_link(vehicle.name), sensor_frame(vehicle.name), (0.0, 0.0))
            one.transform.rotation = down
            found.append(one)
    return make("tf2_msgs/msg/TFMessage", transforms=found)


def odometry(
    seconds: float,
    vehicle: str,
    position: Vector3,
    velocity: Vector3,
    heading: float | None = None,
    turn_rate: float = 0.0,
) -> RosMessage:
    """Return the odometry of a vehicle, with its twist in its base_link.

    Args:
        seconds: Simulated time [s].
        vehicle: Name of the vehicle.
        position: Position in `map` [m].
        velocity: Velocity in `map` [m/s].
        heading: Heading of a UGV that steers [rad]; None: the vehicle is a point.
        turn_rate: Its turn rate [rad/s].
    """
    v_x, v_y, climb = velocity
    twist = make(
        "geometry_msgs/msg/Twist",
        linear=vector(*in_base_link((v_x, v_y), heading), climb),
        angular=vector(0.0, 0.0, turn_rate),
    )
    return make(
        "nav_msgs/msg/Odometry",
        header=header(seconds),
        child_frame_id=base_link(vehicle),
        pose=make(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=pose_at(position, heading),
            covariance=_covariance(),
        ),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=_covariance()),
    )


def true_odometry(view: RunView, truth: Truth, vehicle: str) -> RosMessage:
    """Return the true pose and velocity of a vehicle; the turn rate is that since the previous message."""
    state = truth.vehicles[vehicle]
    return odometry(
        truth.time,
        vehicle,
        place_of(state),
        (*state.velocity, state.climb_rate),
        state.heading,
        view.turn_rates.get(vehicle, TurnRate()).value,
    )


def acceleration(truth: Truth, vehicle: str) -> RosMessage:
    """Return the acceleration applied since the last tick, after clipping to the bounds [m/s²]."""
    state = truth.vehicles[vehicle]
    return make(
        "geometry_msgs/msg/AccelStamped",
        header=header(truth.time, base_link(vehicle)),
        accel=make(
            "geometry_msgs/msg/Accel",
            linear=vector(
                *in_base_link(state.acceleration, state.heading), state.vertical_acceleration
            ),
            angular=vector(0.0, 0.0),
        ),
    )


def path(view: RunView, truth: Truth, vehicle: str) -> RosMessage:
    """Return the path of a vehicle so far."""
    track = view.tracks.get(vehicle, PathTrack())
    poses = [
        make("geometry_msgs/msg/PoseStamped", header=header(time), pose=pose_at(position, heading))
        for time, position, heading in zip(
            track.times, track.positions, track.headings, strict=True
        )
    ]
    return make("nav_msgs/msg/Path", header=header(truth.time), poses=poses)


def escort_of(truth: Truth, uav: str) -> EscortTruth | None:
    """Return the escort of a UAV; None if it escorts no UGV."""
    return next((one for one in truth.escorts if one.uav == uav), None)


def detection(
    seconds: float, uav: str, relative_position: Vector, altitude: float | None = None
) -> RosMessage:
    """Return a detection as the position of the UGV relative to its UAV, -p_delta, on the ground.

    Args:
        seconds: Simulated time of the detection [s].
        uav: Name of the UAV.
        relative_position: p_delta = p_a - p_g with noise [m].
        altitude: Altitude of the UAV [m]; None: it flies in the plane.
    """
    x, y = relative_position
    return make(
        "geometry_msgs/msg/PointStamped",
        header=header(seconds, base_link(uav)),
        point=point_at((-x, -y, -(altitude or 0.0))),
    )


def true_detection(truth: Truth, uav: str) -> RosMessage:
    """Return the detection of a UAV at this tick; None without a detection."""
    escort = escort_of(truth, uav)
    if escort is None or escort.detection is None:
        return None
    return detection(truth.time, uav, escort.detection, truth.vehicles[uav].altitude)


def estimate(truth: Truth, uav: str) -> RosMessage:
    """Return a UAV's estimate of its UGV's position, with its covariance; None without a report."""
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
    """Return the true distance |p_a - p_g| between a UAV and its UGV [m]; None if it escorts no UGV."""
    escort = escort_of(truth, uav)
    return None if escort is None else make("std_msgs/msg/Float64", data=escort.distance)


def role(status: Status, uav: str) -> RosMessage:
    """Return the role of a UAV in its team; None if it has reported none."""
    found = status.roles.get(uav)
    return None if found is None else make("std_msgs/msg/String", data=found.value)


def number(status: Status, uav: str) -> RosMessage:
    """Return the stored number of a UAV in its team; None without a team."""
    found = None if status.team is None else status.team.numbers.get(uav)
    return None if found is None else make("std_msgs/msg/UInt64", data=found)


def battery(status: Status, uav: str) -> RosMessage:
    """Return the charge of a UAV as a share of its endurance; None for an unlimited flight time."""
    charge = None if status.team is None else status.team.charges.get(uav)
    endurance = None if status.geometry is None else status.geometry.endurances.get(uav)
    if charge is None or endurance is None:
        return None
    measured = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity")
    kind = "sensor_msgs/msg/BatteryState"
    nothing: Any = np.zeros(0, dtype=np.float32)
    return make(
        kind,
        header=header(status.time, base_link(uav)),
        **dict.fromkeys(measured, math.nan),
        percentage=charge / endurance,
        power_supply_status=0,
        power_supply_health=0,
        power_supply_technology=0,
        present=True,
        cell_voltage=nothing,
        cell_temperature=nothing,
        location="",
        serial_number="",
    )


def coverage_error(truth: Truth, uav: str) -> RosMessage:
    """Return the coverage error e(t), eq. (4) [m²]; None if the UAV escorts no UGV."""
    escort = escort_of(truth, uav)
    return None if escort is None else make("std_msgs/msg/Float64", data=escort.coverage_error)
