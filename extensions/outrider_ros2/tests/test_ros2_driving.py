"""UGVs that steer, seen and driven from ROS 2: a scripted node follows paths as Nav2's controller does."""

import math
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from path_follower import CORNER, CURVE, TOLERANCE, FollowerNode, PathFollower, path_of

import staging
from agents.warming import warm_up
from bus.credentials import new_credentials
from bus.keys import Role
from bus.messages.scenario import Limits
from bus.messages.vehicle import Teleoperation
from outrider.cli.stopping import Stop
from outrider.running.refused import Refused
from outrider_ros2.bridge import observe
from outrider_ros2.conversion import header
from outrider_ros2.headings import TurnRate
from outrider_ros2.interfaces import decode, encode, make
from outrider_ros2.ros_commands import TWISTS, velocity_command
from outrider_ros2.run_view import view_of
from outrider_ros2.topics import messages_of, wire_topic
from sim.scenario.loading import load_scenario
from sim.scene.known import geometry_of
from staging import raw_session, stage
from statuses import a_truth, a_vehicle

GIVEN = new_credentials("run", ["uav_0"], ["ugv_0"], extensions=["ros2"])
FAST = (
    "ugv.0.max_speed=0.5",
    "ugv.0.max_acceleration=0.5",
    "uav.0.max_speed=1.5",
    "uav.0.max_acceleration=1.0",
    "ugv.0.heading=0.0",
)
KINDS = {
    "differential": ("ugv.0.kinematics='differential'", "ugv.0.track=0.4"),
    "ackermann": ("ugv.0.kinematics='ackermann'", "ugv.0.max_curvature=1.5"),
}
SCENARIO = load_scenario("escort", overrides=[*FAST, *KINDS["differential"]])
HEADING = 2.0
ALONG = (-0.3 * math.cos(HEADING), -0.3 * math.sin(HEADING))


def _shown(heading: float, before: float) -> dict[str, Any]:
    """Return the messages of a UGV that reverses at 0.3 m/s, a tick after it had another heading."""
    view = view_of(SCENARIO.name, geometry_of(SCENARIO))
    uav = a_vehicle((3.0, 4.5))
    for time, angle in ((1.0, before), (1.05, heading)):
        turned = a_vehicle((5.0, 4.0), ALONG, heading=angle, acceleration=(0.0, 1.0))
        shown = dict(messages_of(view, a_truth(time, uav, turned)))
    kinds = {"/tf": "tf2_msgs/msg/TFMessage", "/ugv_0/odom": "nav_msgs/msg/Odometry",
             "/ugv_0/accel": "geometry_msgs/msg/AccelStamped", "/ugv_0/path": "nav_msgs/msg/Path"}  # fmt: skip
    return {name: decode(kind, shown[name]) for name, kind in kinds.items()}


def _yaw(rotation: Any) -> float:
    return 2.0 * math.atan2(rotation.z, rotation.w)


def test_odometry_of_a_ugv_that_steers_is_in_its_base_link() -> None:
    shown = _shown(HEADING, HEADING - 0.04)
    odometry = shown["/ugv_0/odom"]
    assert _yaw(odometry.pose.pose.orientation) == pytest.approx(HEADING)
    linear, angular = odometry.twist.twist.linear, odometry.twist.twist.angular
    assert (linear.x, linear.y) == pytest.approx((-0.3, 0.0), abs=1e-12)
    assert angular.z == pytest.approx(0.8)
    frames = {one.child_frame_id: one.transform for one in shown["/tf"].transforms}
    assert _yaw(frames["ugv_0/base_link"].rotation) == pytest.approx(HEADING)
    assert frames["uav_0/base_link"].rotation.w == 1.0
    assert _yaw(shown["/ugv_0/path"].poses[-1].pose.orientation) == pytest.approx(HEADING - 0.04)
    north = shown["/ugv_0/accel"].accel.linear
    assert (north.x, north.y) == pytest.approx((math.sin(HEADING), math.cos(HEADING)))


def test_turn_rate_is_measured_across_the_seam_and_not_across_gaps() -> None:
    turning = TurnRate()
    assert turning.update(0.0, 3.1) == 0.0
    assert turning.update(0.1, -3.1) == pytest.approx((2.0 * math.pi - 6.2) / 0.1)
    assert turning.update(0.1, -3.1) == pytest.approx((2.0 * math.pi - 6.2) / 0.1)
    assert turning.update(5.0, 1.0) == 0.0
    assert turning.update(0.0, 0.0) == 0.0


def _drive(message: Any, interface: str = TWISTS[0], steering: Any = ("ugv_0",)) -> Teleoperation:
    key = wire_topic(interface, "/ugv_0/cmd_vel").key(0)
    ugvs = {"ugv_0": Limits(max_speed=0.5, max_acceleration=0.5)}
    payload = encode(interface, message)
    command = velocity_command(key, payload, domain=0, namespace="", ugvs=ugvs, steering=steering)
    return command.drive


def _twist(frame: str = "ugv_0/base_link", **values: float) -> Any:
    linear, angular = (
        make(
            "geometry_msgs/msg/Vector3",
            **{axis: values.get(f"{part}_{axis}", 0.0) for axis in "xyz"},
        )
        for part in ("linear", "angular")
    )
    twist = make("geometry_msgs/msg/Twist", linear=linear, angular=angular)
    return make(TWISTS[0], header=header(0.0, frame), twist=twist)


@pytest.mark.parametrize("frame", ["", "ugv_0/base_link"])
def test_a_twist_is_speed_and_turn_rate_of_a_ugv_that_steers(frame: str) -> None:
    message = _twist(frame, linear_x=-0.4, angular_z=0.7)
    drive = Teleoperation(operator="ROS 2", speed=-0.4, turn_rate=0.7)
    assert _drive(message) == drive
    assert _drive(message.twist, TWISTS[1]) == drive


@pytest.mark.parametrize(
    ("message", "cause"),
    [
        (_twist("map", linear_x=0.1), "another frame"),
        (_twist(linear_x=-0.6), "beyond the limits"),
        (_twist(angular_z=1e7), "beyond the limits"),
        (_twist(angular_z=math.nan), "not finite"),
        *[
            (_twist(linear_x=0.1, **{part: 0.1}), "not along the heading")
            for part in ("linear_y", "linear_z", "angular_x", "angular_y")
        ],
    ],
)
def test_a_twist_off_the_heading_is_refused(message: Any, cause: str) -> None:
    with pytest.raises(Refused) as refused:
        _drive(message)
    assert refused.value.cause == cause


@pytest.mark.parametrize("kind", KINDS)
def test_a_path_is_followed_to_its_end_in_sight_of_the_uav(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """A node answers the odometry on cmd_vel as Nav2's regulated pure pursuit controller does."""
    monkeypatch.setattr(staging, "GIVEN", GIVEN)
    for role in (Role.UAV, Role.UGV):
        warm_up(role)
    corners = CORNER if kind == "differential" else CURVE
    overrides = [*FAST, *KINDS[kind], "duration=300.0", "ugv.0.driver=teleop"]
    scenario = load_scenario("escort", overrides=overrides)
    follower = PathFollower("ugv_0", path_of(corners), rotates=kind == "differential")
    nodes: list[FollowerNode] = []
    over = lambda: bool(nodes) and nodes[0].arrived.is_set()  # noqa: E731
    stop = Stop()
    with stage(tmp_path, 0, scenario=scenario, realtime=2.0, stop=over) as run:
        run.start_both()
        bridge = run.client("operator")
        nodes.append(
            FollowerNode(raw_session(run.endpoint, GIVEN.of("ros2_operator")), 0, "ugv_0", follower)
        )
        options = {"domain": 0, "namespace": "", "every_tick": False}
        with ThreadPoolExecutor(1) as threads:
            bridging = threads.submit(lambda: observe(bridge, stop, **options))
            try:
                flight = run.fly()
            finally:
                stop.handle(signal.SIGTERM, None)
            observer, _ = bridging.result()
    assert over()
    states = flight.recorder.states[:, flight.world.names.index("ugv_0")]
    assert math.dist(states[-1, :2], corners[-1]) < TOLERANCE + 0.05
    assert observer.commands is not None
    assert observer.commands.accepted > 20
    assert not observer.refusals.counts
    assert nodes[0].sideways < 1e-9
    assert np.hypot(states[:, 2], states[:, 3]).max() > 0.3
    assert flight.recorder.escorts[:, 0, 0].max() < scenario.visibility.radius
