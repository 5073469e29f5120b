"""A ROS 2 node that follows a path as Nav2's regulated pure pursuit controller does, over plain Zenoh.

It reads `nav_msgs/Odometry` and answers each with a `TwistStamped` on `cmd_vel`. As a program it prints, as JSON,
whether it arrived and the largest sideways velocity in the odometry. Arguments: endpoint, file of credentials, domain,
UGV, path (`corner` or `curve`).
"""

import json
import math
import sys
import threading
from itertools import pairwise
from pathlib import Path
from typing import Any

import zenoh

from bus.access import client_settings
from bus.credentials import read_credential
from outrider_ros2.conversion import base_link, header, pose_at
from outrider_ros2.interfaces import decode, encode, make
from outrider_ros2.ros_commands import TWISTS
from outrider_ros2.topics import wire_topic
from outrider_ros2.wire import Attachment

ODOMETRY = "nav_msgs/msg/Odometry"
SPEED, APPROACH_SPEED = 0.4, 0.08
"""Usual speed, and the lowest one near the goal [m/s]."""
LOOKAHEAD, TOLERANCE = 0.5, 0.15
"""Distance to the point that it drives to, and to the goal on arrival [m]."""
MIN_RADIUS = 0.9
"""Radius below which it slows down [m]."""
TURN_RATE, TURN_ACCELERATION = 0.8, 1.6
"""Turn rate in place [rad/s], and its change per second [rad/s²]."""
ROTATES_FROM = math.pi / 4.0
"""Angle from which it turns in place [rad]."""
PERIOD = 0.05
BESIDE = Attachment(sequence=1, time=0, gid=bytes(16)).encoded()

CORNER = ((7.0, 8.0), (7.0, 9.2), (8.4, 9.2))
"""Corners of a path with turns in place, for a UGV that starts at the first one and faces east."""
CURVE = (
    (7.0, 8.0),
    (8.0, 8.0),
    *(
        (8.0 + math.sin(0.05 * k * math.pi), 9.0 - math.cos(0.05 * k * math.pi))
        for k in range(1, 11)
    ),
    (9.0, 9.5),
)
"""Corners of a path with a quarter circle, for a car."""


def path_of(corners: Any, step: float = 0.05) -> Any:
    """Return a path through these corners, with a point every `step` [m]."""
    points = [corners[0]]
    for (x0, y0), (x1, y1) in pairwise(corners):
        count = math.ceil(math.hypot(x1 - x0, y1 - y0) / step)
        points += [
            (x0 + (x1 - x0) * k / count, y0 + (y1 - y0) * k / count) for k in range(1, count + 1)
        ]
    stamped = [
        make("geometry_msgs/msg/PoseStamped", header=header(0.0), pose=pose_at(one))
        for one in points
    ]
    return make("nav_msgs/msg/Path", header=header(0.0), poses=stamped)


class PathFollower:
    """Controller that follows a `nav_msgs/Path` by pure pursuit.

    Args:
        vehicle: Name of the UGV.
        path: Path in `map`.
        rotates: True to turn in place towards the path, which a car cannot.
    """

    def __init__(self, vehicle: str, path: Any, *, rotates: bool) -> None:
        self._vehicle, self._rotates = vehicle, rotates
        self._points = [(one.pose.position.x, one.pose.position.y) for one in path.poses]
        self.arrived = False

    def twist(self, odometry: Any) -> Any:
        """Return the answer to an odometry."""
        speed, turn_rate = self._command(odometry)
        linear = make("geometry_msgs/msg/Vector3", x=speed, y=0.0, z=0.0)
        angular = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=turn_rate)
        return make(
            TWISTS[0],
            header=make(
                "std_msgs/msg/Header",
                stamp=odometry.header.stamp,
                frame_id=base_link(self._vehicle),
            ),
            twist=make("geometry_msgs/msg/Twist", linear=linear, angular=angular),
        )

    def _command(self, odometry: Any) -> tuple[float, float]:
        pose = odometry.pose.pose
        heading = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
        local = [self._seen(point, pose.position, heading) for point in self._points]
        near = min(range(len(local)), key=lambda k: math.hypot(*local[k]))
        self._points, local = self._points[near:], local[near:]
        left = math.hypot(*local[-1])
        self.arrived = self.arrived or left < TOLERANCE
        if self.arrived:
            return 0.0, 0.0
        x, y = next((one for one in local if math.hypot(*one) >= LOOKAHEAD), local[-1])
        angle, now = math.atan2(y, x), odometry.twist.twist.angular.z
        if self._rotates and abs(angle) > ROTATES_FROM:
            change = TURN_ACCELERATION * PERIOD
            wanted = math.copysign(TURN_RATE, angle)
            return 0.0, max(now - change, min(wanted, now + change))
        curvature = 2.0 * y / (x * x + y * y)
        speed = SPEED * min(1.0, 1.0 / max(MIN_RADIUS * abs(curvature), 1e-9))
        speed = min(speed, max(APPROACH_SPEED, SPEED * left / LOOKAHEAD))
        return speed, speed * curvature

    @staticmethod
    def _seen(point: Any, own: Any, heading: float) -> tuple[float, float]:
        """Return a point in the base_link [m]."""
        x, y = point[0] - own.x, point[1] - own.y
        cos, sin = math.cos(heading), math.sin(heading)
        return x * cos + y * sin, y * cos - x * sin


class FollowerNode:
    """Node that reads the odometry of a UGV and drives it along a path.

    Args:
        session: Session of the node.
        domain: ROS 2 domain id.
        vehicle: Name of the UGV.
        follower: Controller.
    """

    def __init__(
        self, session: zenoh.Session, domain: int, vehicle: str, follower: PathFollower
    ) -> None:
        self._session, self._follower = session, follower
        self._answers = wire_topic(TWISTS[0], f"/{vehicle}/cmd_vel").key(domain)
        self.arrived = threading.Event()
        self.sideways = 0.0
        """Largest sideways velocity in the odometry [m/s]."""
        key = wire_topic(ODOMETRY, f"/{vehicle}/odom").key(domain)
        self._kept = session.declare_subscriber(key, self._act)

    def _act(self, sample: zenoh.Sample) -> None:
        odometry = decode(ODOMETRY, sample.payload.to_bytes())
        self.sideways = max(self.sideways, abs(odometry.twist.twist.linear.y))
        twist = self._follower.twist(odometry)
        self._session.put(self._answers, encode(TWISTS[0], twist), attachment=BESIDE)
        if self._follower.arrived and abs(odometry.twist.twist.linear.x) < 1e-6:
            self.arrived.set()


def main(endpoint: str, file: str, domain: str, vehicle: str, path: str) -> None:
    """Follow a path until arrival, for five minutes at most."""
    config = zenoh.Config()
    settings: dict[str, Any] = {"mode": "client", "connect/endpoints": [endpoint]}
    for key, value in (settings | client_settings(read_credential(Path(file)))).items():
        config.insert_json5(key, json.dumps(value))
    corners, rotates = (CORNER, True) if path == "corner" else (CURVE, False)
    follower = PathFollower(vehicle, path_of(corners), rotates=rotates)
    with zenoh.open(config) as session:
        node = FollowerNode(session, int(domain), vehicle, follower)
        arrived = node.arrived.wait(300.0)
    sys.stdout.write(json.dumps({"arrived": arrived, "sideways": node.sideways}))


if __name__ == "__main__":
    main(*sys.argv[1:6])
