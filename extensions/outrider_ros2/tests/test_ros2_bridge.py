"""The bridge to ROS 2 between a simulator and nodes, each with its own session and credentials."""

import math
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
import zenoh
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.credentials import new_credentials
from bus.keys import CONTROL, COVERAGE, OPERATOR, SAMPLED_TRUTH, STATUS
from bus.messages.control import Action, Control
from bus.messages.scenario import Limits
from bus.messages.team import Request
from bus.messages.telemetry import CoverageMap, TeamStatus
from outrider.running.refused import Refused
from outrider.view.operator import RunClient
from outrider_ros2.conversion import header
from outrider_ros2.interfaces import decode, encode, make, request_of, response_of
from outrider_ros2.observing import RosObserver
from outrider_ros2.roles import NO_HASH
from outrider_ros2.ros_commands import TWISTS, RosCommands, velocity_command
from outrider_ros2.ros_node import RosNode
from outrider_ros2.run_view import view_of
from outrider_ros2.topics import TOPICS, wire_topic
from outrider_ros2.wire import Attachment, WireTopic
from processes import wait_until
from sim.scenario.loading import load_scenario
from sim.scene.known import geometry_of
from staging import client_of, hosted, raw_session
from statuses import PRESENT, Box, a_status, truth_at

GIVEN = new_credentials("run", ["uav_0"], ["ugv_0"], extensions=["ros2"])
SCENARIO = load_scenario("escort")
STATUS_NOW = a_status(
    drivers={"ugv_0": "waypoints"}, vehicles=PRESENT, geometry=geometry_of(SCENARIO)
)


class Staged:
    """A simulator that only sends messages, a bridge, and ROS 2 nodes that are plain Zenoh sessions."""

    def __init__(self, stack: ExitStack, folder: Path, bridge: str) -> None:
        self._stack = stack
        self.endpoint = f"unixsock-stream/{folder / 'bus.sock'}"
        self.simulator = stack.enter_context(hosted(self.endpoint, GIVEN))
        self.statuses, self.truths, self.maps = (
            self.simulator.outbox(key) for key in (STATUS, SAMPLED_TRUTH, COVERAGE)
        )
        self.bridge = stack.enter_context(client_of(self.endpoint, GIVEN.of(bridge)))
        self.node = RosNode(self.bridge, domain=7, name="outrider", namespace="/fleet")
        stack.callback(self.node.close)
        self.observer = RosObserver(self.bridge, self.node, namespace="/fleet")
        stack.callback(self.observer.close)

    def send_status(self) -> None:
        """Send the status of the run until the bridge has received it."""

        def is_received() -> bool:
            self.statuses.send(STATUS_NOW)
            self.observer.step(0.02)
            return self.observer.status is not None

        wait_until(is_received)

    def ros(self, name: str) -> zenoh.Session:
        return self._stack.enter_context(raw_session(self.endpoint, GIVEN.of(name)))


@contextmanager
def staged(folder: Path, bridge: str = "ros2") -> Iterator[Staged]:
    with ExitStack() as stack:
        yield Staged(stack, folder, bridge)


def row_key(name: str, vehicle: str = "uav_0") -> tuple[str, str]:
    """Return type and key of a topic in the bridge's domain and namespace."""
    row = next(one for one in TOPICS if one.name == name)
    whose = f"/{vehicle}" if row.each != "run" else ""
    topic = wire_topic(row.interface, f"{whose}/{name}", "/fleet")
    return row.interface, topic.key(7)


def test_only_topics_with_readers_are_published_and_requested(tmp_path: Path) -> None:
    with staged(tmp_path) as stage:
        observer = stage.observer
        stage.send_status()
        assert not stage.truths.wanted
        assert not stage.maps.wanted
        ros, got = stage.ros("ros2_observer"), []
        interface, key = row_key("odom")
        kept = ros.declare_subscriber(key, got.append)

        def seen() -> bool:
            observer.step(0.02)
            stage.truths.send(truth_at(40 + len(got)))
            return bool(got)

        wait_until(seen)
        assert stage.truths.wanted
        assert not stage.maps.wanted
        odometry = decode(interface, got[0].payload.to_bytes())
        assert odometry.pose.pose.position.x == 3.0
        beside = Attachment.decoded(got[0].attachment.to_bytes())
        assert beside is not None
        assert beside.sequence == 1
        assert not [
            name
            for name, count in observer.topics.items()
            if count and "odom" not in name and not name.endswith(("tf_static", "discs"))
        ]
        kept.undeclare()

        def left() -> bool:
            observer.step(0.05)
            stage.statuses.send(STATUS_NOW)
            return not stage.truths.wanted

        wait_until(left)


def test_late_reader_gets_the_map_and_graph_shows_every_topic(tmp_path: Path) -> None:
    with staged(tmp_path) as stage:
        ros, got = stage.ros("ros2_observer"), []
        interface, key = row_key("coverage")
        kept: list[Any] = [ros.declare_subscriber(key, got.append)]

        def seen() -> bool:
            stage.statuses.send(STATUS_NOW)
            stage.maps.send(CoverageMap(tick=4, columns=2, rows=1, cell=0.5, cells=b"\x00\xff"))
            stage.observer.step(0.02)
            return bool(got)

        wait_until(seen)
        late = zenoh.ext.declare_advanced_subscriber(
            stage.ros("ros2_operator"),
            key,
            zenoh.handlers.FifoChannel(10),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        )
        grid = decode(interface, late.recv().payload.to_bytes())
        assert grid.data.tolist() == [0, 100]
        tokens = [
            str(reply.ok.key_expr).split("/")
            for reply in ros.liveliness().get("@ros2_lv/7/**", timeout=2.0)
            if reply.ok is not None
        ]
        shown = {parts[9].replace("%", "/"): parts for parts in tokens if parts[5] == "MP"}
        scene = view_of(SCENARIO.name, geometry_of(SCENARIO)).scene
        wanted = {f"/fleet{name}" for row in TOPICS for _, name in row.names(scene)}
        assert set(shown) == wanted
        assert "/".join(shown["/fleet/coverage"][10:12]) == "/".join(key.split("/")[-2:])
        assert {parts[7] for parts in tokens} == {"%fleet"}
        late.undeclare()
        for one in kept:
            one.undeclare()


class Reader:
    """A publisher with a reader from the start, and its sent messages."""

    wanted, matches = True, 1

    def __init__(self) -> None:
        self.got: list[bytes] = []
        self.send = self.got.append

    @property
    def sent(self) -> int:
        return len(self.got)

    def close(self) -> None:
        """Do nothing."""


def test_readers_of_another_paused_run_receive_all_at_once() -> None:
    """The tick is that at which the previous run was left, and the other run does not advance."""
    boxes: dict[Any, Box] = defaultdict(Box)
    readers: dict[str, Reader] = {}

    def publisher(topic: WireTopic, _qos: Any) -> Reader:
        readers[topic.name] = Reader()
        return readers[topic.name]

    session: Any = SimpleNamespace(inbox=lambda key, **_more: boxes[key], forget=lambda _box: None)
    node: Any = SimpleNamespace(publisher=publisher)
    observer = RosObserver(session, node)
    counts = []
    for radius in (4.75, 4.5):
        other = load_scenario("escort", overrides=[f"visibility.radius={radius}"])
        status = msgspec.structs.replace(STATUS_NOW, geometry=geometry_of(other))
        boxes[STATUS].messages.append(status)
        for _ in range(2):
            boxes[SAMPLED_TRUTH].messages.append(truth_at(40))
            observer.step(0.0)
        counts.append({name: reader.sent for name, reader in readers.items()})
    assert counts[0] == counts[1]
    assert counts[1]["/uav_0/odom"] == counts[1]["/uav_0/path"] == counts[1]["/discs"] == 1


def _twist(x: float, y: float, *, turn: float = 0.0) -> Any:
    def vector(*values: float) -> Any:
        return make("geometry_msgs/msg/Vector3", **dict(zip("xyz", values, strict=True)))

    return make("geometry_msgs/msg/Twist", linear=vector(x, y, 0.0), angular=vector(0.0, 0.0, turn))


def _key(name: str = "/ugv_0/cmd_vel", interface: str = TWISTS[1], domain: int = 7) -> str:
    return wire_topic(interface, name, "/fleet").key(domain)


TEAM = TeamStatus(team_certified_share=1.0, team_out_of_sight=0, numbers={"uav_0": 31})
UGVS = {"ugv_0": Limits(max_speed=0.2, max_acceleration=0.1)}
GOOD = encode(TWISTS[1], _twist(0.1, -0.1))
BAD = {
    "another domain": (_key(domain=8), GOOD),
    "no such UGV": (_key("/uav_0/cmd_vel"), GOOD),
    "another type": (_key(interface="geometry_msgs/msg/Accel"), GOOD),
    "another hash": (_key()[:-1] + "x", GOOD),
    "invalid CDR": (_key(), GOOD[:-3]),
    "not finite": (_key(), encode(TWISTS[1], _twist(math.nan, 0.0))),
    "beyond the limits": (_key(), encode(TWISTS[1], _twist(0.2, 0.1))),
    "climbs or turns": (_key(), encode(TWISTS[1], _twist(0.1, 0.0, turn=0.5))),
    "another frame": (
        _key(interface=TWISTS[0]),
        encode(TWISTS[0], make(TWISTS[0], header=header(0.0, "odom"), twist=_twist(0.1, 0.0))),
    ),
}


@pytest.mark.parametrize("cause", BAD)
def test_a_bad_velocity_is_refused_by_its_cause(cause: str) -> None:
    key, payload = BAD[cause]
    with pytest.raises(Refused) as refused:
        velocity_command(key, payload, domain=7, namespace="/fleet", ugvs=UGVS)
    assert refused.value.cause == cause


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=80), st.sampled_from(TWISTS))
def test_no_bytes_at_all_make_a_velocity_that_cannot_be_driven(raw: bytes, interface: str) -> None:
    try:
        command = velocity_command(
            _key(interface=interface), raw, domain=7, namespace="/fleet", ugvs=UGVS
        )
    except Refused:
        return
    assert math.hypot(*command.drive.velocity) <= 0.2 * (1.0 + 1e-6)


def test_operator_node_drives_and_bad_messages_are_counted(tmp_path: Path) -> None:
    with staged(tmp_path, "operator") as stage:
        teleoperations = stage.simulator.inbox(OPERATOR, "ugv_0")
        controls = stage.simulator.inbox(CONTROL)
        client, observer = RunClient(stage.bridge, read=()), stage.observer
        observer.commands = RosCommands(
            stage.node, client, namespace="/fleet", refusals=observer.refusals
        )
        stage.send_status()
        driving = stage.ros("ros2_operator")
        others = [stage.ros(name) for name in ("ros2", "ros2_observer", "observer")]
        beside = Attachment(sequence=1, time=0, gid=bytes(16)).encoded()
        drives: list[Any] = []

        def driven() -> bool:
            driving.put(_key(), GOOD, attachment=beside)
            for other in others:
                other.put(_key(), encode(TWISTS[1], _twist(0.0, 0.15)), attachment=beside)
            while (envelope := teleoperations.next_waiting()) is not None:
                drives.append(envelope.message)
            return bool(drives)

        wait_until(driven)
        assert {drive.velocity for drive in drives} == {(0.1, -0.1)}
        taken = controls.receive(2.0)
        assert taken is not None
        asked = Control(action=Action.DRIVER, vehicle="ugv_0", driver="teleop")
        assert msgspec.structs.replace(taken.message, operator=None) == asked

        def refused() -> bool:
            for key, payload in BAD.values():
                driving.put(key, payload, attachment=beside)
            observer.step(0.02)
            return set(observer.refusals.counts) >= set(BAD)

        wait_until(refused)
        driving.put(
            _key(), GOOD, attachment=Attachment(sequence=1, time=0, gid=b"x" * 16).encoded()
        )
        wait_until(lambda: "another node has control" in observer.refusals.counts)
        counted = observer.refusals.counts["another hash"]
        unhashed = "/".join([*_key().split("/")[:-1], NO_HASH])

        def counted_without_hash() -> bool:
            driving.put(unhashed, GOOD, attachment=beside)
            return observer.refusals.counts["another hash"] > counted

        wait_until(counted_without_hash)
        diagnostic = {one.key: one.value for one in observer._own_diagnostic().values}
        assert int(diagnostic["rejected: beyond the limits"]) >= 1

        trigger, pause = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"
        nothing = make(request_of(trigger), structure_needs_at_least_one_member=0)
        asked = (
            (pause, "/pause", make(request_of(pause), data=True)),
            (trigger, "/step", nothing),
            (trigger, "/reset", nothing),
            (trigger, "/uav_0/call", nothing),
            (trigger, "/uav_0/relieve", nothing),
        )
        observer.commands.follow(msgspec.structs.replace(STATUS_NOW, team=TEAM))
        for interface, name, wanted in asked:
            payload = encode(request_of(interface), wanted)
            (reply,) = driving.get(
                wire_topic(interface, name, "/fleet").key(7), payload=payload, attachment=beside
            )
            answer = decode(response_of(interface), reply.ok.payload.to_bytes())
            assert answer.success
            good = wire_topic(interface, name, "/fleet").key(7)
            bad = {
                "another hash": "/".join([*good.split("/")[:-1], NO_HASH]),
                "another domain": wire_topic(interface, name, "/fleet").key(8),
                "no such service": wire_topic(interface, name, "/other").key(7),
                "another type": good.replace("::srv::", "::msg::"),
            }
            for cause, key in bad.items():
                counted = observer.refusals.counts[cause]
                assert all(reply.ok is None for reply in driving.get(key, payload=payload))
                assert observer.refusals.counts[cause] == counted + 1
        sent = [controls.receive(2.0).message for _ in asked]
        assert [one.action for one in sent[:3]] == [Action.PAUSE, Action.STEP, Action.RESET]
        assert [(one.vehicle, one.request) for one in sent[3:]] == [
            ("uav_0", Request.GUARD),
            ("uav_0", Request.RELIEF),
        ]
        other = wire_topic(trigger, "/ugv_0/relieve", "/fleet").key(7)
        counted = observer.refusals.counts["no such service"]
        assert all(reply.ok is None for reply in driving.get(other, payload=payload))
        assert observer.refusals.counts["no such service"] == counted + 1
        client.close()
