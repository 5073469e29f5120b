"""ROS 2's wire format, and our telemetry as its messages."""

import importlib
import math
import struct
from pathlib import Path

import msgspec
import numpy as np
import pytest

from bus.errors import ScenarioError
from bus.messages.buildings import Building
from bus.messages.decision import NotCertified
from bus.messages.ground import GroundMap
from bus.messages.links import LinkStatus
from bus.messages.team import Role
from bus.messages.telemetry import CoverageMap, TeamStatus, VehicleStatus
from outrider.running.refused import Refused
from outrider_ros2.conversion import stamp
from outrider_ros2.interfaces import decode, encode, gid_of, make, type_hash
from outrider_ros2.roles import PILOT
from outrider_ros2.run_view import PathTrack, RunView
from outrider_ros2.topics import PILOT_COMMANDS, PILOT_TOPICS, TOPICS, messages_of, wire_topic
from outrider_ros2.wire import (
    LATCHED,
    SENSOR,
    Attachment,
    Endpoint,
    Node,
    Qos,
    check_domain,
    check_namespace,
)
from sim.scenario.loading import load_scenario
from sim.scene.known import geometry_of, scene_of
from stamps import seconds_of
from statuses import a_status, a_truth, a_vehicle, truth_at

NODE = Node(domain=7, zid="8a1f", name="outrider", namespace="/fleet")


def _view():
    return RunView(scene=scene_of(load_scenario("escort")), dt=0.05)


def _by_topic(message, view=None):
    view = view or _view()
    rows = {name: row for row in TOPICS for _, name in row.names(view.scene)}
    payloads = messages_of(view, message)
    return {name: decode(rows[name].interface, payload) for name, payload in payloads}


def test_a_key_and_tokens_are_those_that_rmw_zenoh_makes():
    topic = wire_topic("std_msgs/msg/String", "/chatter")
    assert topic.key(0) == (
        "0/chatter/std_msgs::msg::dds_::String_/"
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )
    assert NODE.token() == "@ros2_lv/7/8a1f/0/0/NN/%/%fleet/outrider"
    assert NODE.endpoint_token(Endpoint.PUBLISHER, 3, topic, Qos(depth=7)) == (
        "@ros2_lv/7/8a1f/0/3/MP/%/%fleet/outrider/%chatter/std_msgs::msg::dds_::String_/"
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,7:,:,:,,"
    )


def test_qos_leaves_out_what_is_rmw_zenohs_default():
    assert LATCHED.encoded() == ":1:,1:,:,:,,"
    assert SENSOR.encoded() == "2::,5:,:,:,,"
    assert Qos(depth=42).encoded() == "::,:,:,:,,"


def test_a_gid_is_the_hash_of_the_token_with_its_low_half_first():
    low, high = struct.unpack("<QQ", gid_of(""))
    assert (high << 64) + low == 0x99AA06D3014798D86001C324468D497F  # XXH3-128 of nothing


def test_an_attachment_is_read_back_and_another_length_is_none():
    attachment = Attachment(sequence=5, time=123456789012345, gid=bytes(range(16)))
    raw = attachment.encoded()
    assert raw[:8] == struct.pack("<q", 5)
    assert raw[16] == 16
    assert Attachment.decoded(raw) == attachment
    assert Attachment.decoded(raw[:-1]) is None
    assert Attachment.decoded(raw[:16] + b"\x0f" + raw[17:]) is None


@pytest.mark.parametrize("namespace", ["a b", "/9lives", "a__b", "ns/pilot", "pilot", "*", "a/**"])
def test_a_namespace_that_cannot_be_one_is_refused(namespace):
    with pytest.raises(ScenarioError, match="--namespace"):
        check_namespace(namespace)


def test_a_namespace_gets_its_slash_and_a_domain_its_bounds():
    assert check_namespace("") == ""
    assert check_namespace("fleet/one/") == "/fleet/one"
    with pytest.raises(ScenarioError, match="0 to 232"):
        check_domain(233)


def test_odometry_and_transforms_show_the_truth_in_the_map_frame():
    messages = _by_topic(truth_at())
    odometry = messages["/uav_0/odom"]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "uav_0/base_link")
    assert seconds_of(odometry.header.stamp) == pytest.approx(2.0, abs=1e-9)
    position, velocity = odometry.pose.pose.position, odometry.twist.twist.linear
    assert (position.x, position.y, position.z) == (3.0, 4.5, 0.0)
    assert (velocity.x, velocity.y) == (0.25, -0.5)
    frames = {one.child_frame_id: one.transform for one in messages["/tf"].transforms}
    assert set(frames) == {"uav_0/base_link", "ugv_0/base_link"}
    assert frames["ugv_0/base_link"].translation.x == 5.0
    assert frames["ugv_0/base_link"].rotation.w == 1.0


def test_a_detection_points_from_the_uav_to_the_ugv():
    point = _by_topic(truth_at())["/uav_0/detection"]
    assert point.header.frame_id == "uav_0/base_link"
    assert (point.point.x, point.point.y) == (2.125, -0.5)


def test_an_estimate_carries_its_covariance():
    pose = _by_topic(truth_at())["/uav_0/estimate"].pose
    assert pose.pose.position.x == 6.0
    covariance = np.array(pose.covariance).reshape(6, 6)
    assert covariance[:2, :2].tolist() == [[0.04, 0.01], [0.01, 0.09]]
    assert not covariance[2:].any()


def test_path_stays_short_and_restarts_with_another_flight():
    track = PathTrack()
    for tick in range(5000):
        track.add(tick * 0.05, (tick * 0.11, 0.0, 0.0))
    assert 250 <= len(track.times) <= 501
    assert track.positions[0] == (0.0, 0.0, 0.0)
    track.add(0.0, (1.0, 1.0, 2.0))
    assert track.positions == [(1.0, 1.0, 2.0)]


def test_coverage_is_a_grid_in_percent():
    cells = bytes([0, 127, 255, 255, 0, 51])
    coverage = CoverageMap(tick=100, columns=3, rows=2, cell=0.25, cells=cells)
    grid = _by_topic(coverage)["/coverage"]
    assert (grid.info.width, grid.info.height) == (3, 2)
    assert grid.info.resolution == 0.25
    assert grid.data.tolist() == [0, 50, 100, 100, 0, 20]
    assert seconds_of(grid.header.stamp) == pytest.approx(5.0)


def test_hazards_are_markers_with_fixed_ids_sent_once():
    outlines = [
        {"kind": "block", "center": [1.0, 2.0], "radius": 0.5},
        {"kind": "rough", "polygon": [[0, 0], [1, 0], [1, 1], [0, 1]]},
    ]
    ground = msgspec.convert(
        {
            "tick": 2,
            "columns": 2,
            "rows": 1,
            "tile": 0.5,
            "tiles": bytes([0, 3]),
            "states": bytes([1, 0]),
            "hazards": outlines,
        },
        GroundMap,
    )
    view = _view()
    first = _by_topic(ground, view)
    assert first["/ground"].data.tolist() == [-1, 100]
    disc, polygon = first["/hazards"].markers
    assert (disc.id, disc.scale.x, disc.pose.position.y) == (0, 1.0, 2.0)
    assert len(polygon.points) == 6
    again = _by_topic(msgspec.structs.replace(ground, hazards=()), view)["/hazards"]
    assert [one.id for one in again.markers] == [0, 1]
    built = msgspec.structs.replace(ground, first_building=1, end_building=2)  # drawn elsewhere
    assert [one.id for one in _by_topic(built, view)["/hazards"].markers] == [0]


def test_diagnostics_name_why_nothing_is_certified():
    none = dict.fromkeys(("duplicated", "queued", "in_transit"), 0)
    link = LinkStatus(sent=9, delivered=4, lost={"chance": 5}, delivery_ratio=4 / 9, **none)
    status = a_status(
        certified={"uav_0": False},
        uncertified={"uav_0": NotCertified.MEASUREMENT_TOO_OLD},
        links={"uav_0/detections": link},
        vehicles={"uav_0": VehicleStatus(present=True)},
    )
    parts = {one.name: one for one in _by_topic(status)["/diagnostics"].status}
    assert "older than max_measurement_age" in parts["outrider: certificate uav_0"].message
    assert parts["outrider: certificate uav_0"].level == 1
    lossy = parts["outrider: link uav_0/detections"]
    assert lossy.message == "message loss"
    value_of = {one.key: one.value for one in lossy.values}
    assert (value_of["sent"], value_of["delivered"], value_of["lost: chance"]) == ("9", "4", "5")
    assert value_of["delivery_ratio"] == "0.444444"


def test_discs_and_sensors_stay_as_they_are():
    messages = _by_topic(None)
    (sensor,) = messages["/tf_static"].transforms
    assert (sensor.header.frame_id, sensor.child_frame_id) == ("uav_0/base_link", "uav_0/sensor")
    rotation = sensor.transform.rotation
    # the sensor's x axis points down in base_link
    assert 2.0 * (rotation.x * rotation.z - rotation.w * rotation.y) == pytest.approx(-1.0)
    assert all(one.frame_locked for one in messages["/discs"].markers)


def test_a_uav_with_an_altitude_flies_above_the_ground():
    town = load_scenario("town")
    house = Building(polygon=((1.0, 1.0), (3.0, 1.0), (3.0, 2.0)), height=4.0)
    view = RunView(scene=scene_of(town, (house,)), dt=0.05)
    uav = a_vehicle((3.0, 4.5), altitude=2.5, climb_rate=0.25, vertical_acceleration=-0.5)
    there = a_truth(
        1.0, uav, a_vehicle((5.0, 4.0)), distance=2.0, sight_radius=0.0, detection=(-2.0, 0.5)
    )
    found = _by_topic(there, view)
    pose = found["/uav_0/odom"].pose.pose
    assert (pose.position.x, pose.position.y, pose.position.z) == (3.0, 4.5, 2.5)
    assert found["/uav_0/odom"].twist.twist.linear.z == 0.25
    assert found["/ugv_0/odom"].pose.pose.position.z == 0.0
    assert found["/uav_0/accel"].accel.linear.z == -0.5
    assert found["/uav_0/path"].poses[-1].pose.position.z == 2.5
    assert found["/uav_0/detection"].point.z == -2.5  # on the ground
    heights = {one.child_frame_id: one.transform.translation.z for one in found["/tf"].transforms}
    assert heights == {"uav_0/base_link": 2.5, "ugv_0/base_link": 0.0}
    marks = {one.ns: one for one in found["/sight"].markers}
    line = marks["uav_0/line of sight"]
    assert [point.z for point in line.points] == [2.5, 0.0]
    assert line.color.r > line.color.g  # a building hides the UGV
    radius = 2.5 * math.tan(town.camera.half_angle)
    ends = [math.dist((point.x, point.y), (3.0, 4.5)) for point in marks["uav_0/r"].points]
    assert ends == pytest.approx([radius] * len(ends))
    still = _by_topic(None, view)
    assert {one.ns for one in still["/discs"].markers}.isdisjoint({"uav_0/r", "ugv_0/r_v"})
    (building,) = still["/buildings"].markers
    assert {point.z for point in building.points} == {0.0, 4.0}
    assert len(building.points) == 3 * (2 * 3 + 1)  # walls of two triangles, and the roof


def test_topics_are_unique_and_vehicle_topics_have_their_prefix():
    scene = _view().scene
    names = [name for row in (*TOPICS, *PILOT_TOPICS) for _, name in row.names(scene)]
    assert len(names) == len(set(names))
    assert not any(PILOT in row.name for row in TOPICS)
    assert all(row.name.startswith(f"{PILOT}/") for row in PILOT_TOPICS)
    assert all(type_hash(row.interface).startswith("RIHS01_") for row in (*TOPICS, *PILOT_TOPICS))


def test_invalid_cdr_is_refused_with_a_reason():
    zero = make("geometry_msgs/msg/Vector3", x=1.0, y=2.0, z=3.0)
    twist = make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    raw = encode("geometry_msgs/msg/Twist", twist)
    assert decode("geometry_msgs/msg/Twist", raw).linear.y == 2.0
    for bad in (b"", raw[:3], raw[:-8], b"\x00\x07" + raw[2:], raw + bytes(64)):
        with pytest.raises(Refused, match="geometry_msgs/msg/Twist"):
            decode("geometry_msgs/msg/Twist", bad)
    huge = raw[:4] + struct.pack("<I", 2**31) + bytes(8)
    with pytest.raises(Refused):
        decode("std_msgs/msg/String", huge)


def test_a_time_is_split_without_loss():
    for tick in (0, 1, 19_999, 10_000_001):
        odometry = _by_topic(truth_at(tick))["/uav_0/odom"]
        assert math.isclose(seconds_of(odometry.header.stamp), tick * 0.05, abs_tol=1e-9)
        assert 0 <= odometry.header.stamp.nanosec < 10**9


def test_every_ros_2_topic_is_documented_with_its_type(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "docs" / "generators")
    generator = importlib.import_module("ros2_topics")
    for rows, text in (
        (TOPICS, generator.observed()),
        ((*PILOT_TOPICS, *PILOT_COMMANDS), generator.own()),
    ):
        lines = text.splitlines()[2:]
        assert len(lines) == len(rows)
        for row, line in zip(rows, lines, strict=True):
            assert f"{row.name}` | `{row.interface}` | " in line


def test_time_is_exact_to_the_nanosecond() -> None:
    """A tick may last a third of a second."""
    time = stamp(100.0 / 3.0)
    assert (time.sec, time.nanosec) == (33, 333_333_333)


def test_topics_of_a_team_show_role_number_and_battery() -> None:
    scenario = load_scenario("relay")
    scene = scene_of(scenario)
    status = a_status(
        roles={"uav_0": Role.GUARD},
        geometry=geometry_of(scenario),
        team=TeamStatus(
            team_certified_share=1.0,
            team_out_of_sight=0,
            charges={"uav_0": 75.0},
            numbers={"uav_0": 31},
        ),
    )
    found = dict(messages_of(RunView(scene=scene, dt=0.05), status))
    role = decode("std_msgs/msg/String", found["/uav_0/role"])
    number = decode("std_msgs/msg/UInt64", found["/uav_0/number"])
    battery = decode("sensor_msgs/msg/BatteryState", found["/uav_0/battery"])
    assert (role.data, number.data, battery.percentage) == ("GUARD", 31, 0.25)
    names = {name for row in TOPICS for _, name in row.names(scene_of(load_scenario("escort")))}
    assert not names & {"/uav_0/role", "/uav_0/number", "/uav_0/battery"}
