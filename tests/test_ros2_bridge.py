"""The bridge to ROS 2 between a simulator and nodes, each with a session and credentials of its own."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import msgspec
import zenoh
from processes import wait_until
from staging import raw_session
from test_ros2_wire import truth_at

from bus.access import new_credentials
from bus.boxes import Outbox
from bus.keys import COVERAGE, SAMPLED_TRUTH, STATUS
from bus.messages import CoverageMap, Status
from bus.session import open_session
from outrider.bridges.ros2.interfaces import decode
from outrider.bridges.ros2.observing import RosObserver
from outrider.bridges.ros2.ros_node import RosNode
from outrider.bridges.ros2.topics import TOPICS, wire_topic
from outrider.bridges.ros2.wire import Attachment
from sim.scenario.loading import load_scenario
from sim.scene.known import geometry_of

GIVEN = new_credentials("run", ["uav_0"], ["ugv_0"], ros2=True)
SCENARIO = load_scenario("escort")
STATUS_NOW = msgspec.convert(
    {
        "scenario": "escort",
        "seed": 1,
        "tick": 0,
        "ticks": 100,
        "time": 0.0,
        "realtime_factor": 1.0,
        "drivers": {"ugv_0": "waypoints"},
        "vehicles": {"uav_0": {"present": True}, "ugv_0": {"present": True}},
        "geometry": msgspec.to_builtins(geometry_of(SCENARIO)),
    },
    Status,
)


class Staged:
    """A simulator that only tells, a bridge, and ROS 2 nodes that are plain Zenoh sessions."""

    def __init__(self, stack: ExitStack, folder: Path, bridge: str) -> None:
        self._stack = stack
        self.endpoint = f"unixsock-stream/{folder / 'bus.sock'}"
        self.simulator = stack.enter_context(
            open_session(GIVEN.of("simulator").party, "run", listen=(self.endpoint,), given=GIVEN)
        )
        self.statuses, self.truths = self.outbox(STATUS), self.outbox(SAMPLED_TRUTH)
        self.maps = self.outbox(COVERAGE)
        self.bridge = stack.enter_context(
            open_session(
                GIVEN.of(bridge).party, "run", connect=self.endpoint, credential=GIVEN.of(bridge)
            )
        )
        self.node = RosNode(self.bridge, domain=7, name="outrider", namespace="/fleet")

    def outbox(self, key: Any) -> Outbox:
        return self.simulator.outbox(key)

    def ros(self, name: str) -> zenoh.Session:
        return self._stack.enter_context(raw_session(self.endpoint, GIVEN.of(name)))


@contextmanager
def staged(folder: Path, bridge: str = "ros2") -> Iterator[Staged]:
    with ExitStack() as stack:
        yield Staged(stack, folder, bridge)


def row_key(name: str, vehicle: str = "uav_0") -> tuple[str, str]:
    """Type and key of a topic in the bridge's domain and namespace."""
    row = next(one for one in TOPICS if one.name == name)
    whose = f"/{vehicle}" if row.each != "run" else ""
    topic = wire_topic(row.interface, f"{whose}/{name}", "/fleet")
    return row.interface, topic.key(7)


def test_what_somebody_reads_is_published_and_nothing_else_is_asked_for(tmp_path: Path) -> None:
    with staged(tmp_path) as stage:
        observer = RosObserver(stage.bridge, stage.node, namespace="/fleet")

        def told() -> bool:
            stage.statuses.send(STATUS_NOW)
            observer.step(0.05)
            return observer.status is not None

        wait_until(told)
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
        observer.close()
        stage.node.close()


def test_who_comes_late_gets_the_map_and_the_graph_shows_every_topic(tmp_path: Path) -> None:
    with staged(tmp_path) as stage:
        observer = RosObserver(stage.bridge, stage.node, namespace="/fleet")
        ros, got = stage.ros("ros2_observer"), []
        interface, key = row_key("coverage")
        kept: list[Any] = [ros.declare_subscriber(key, got.append)]

        def seen() -> bool:
            stage.statuses.send(STATUS_NOW)
            stage.maps.send(CoverageMap(tick=4, columns=2, rows=1, cell=0.5, cells=b"\x00\xff"))
            observer.step(0.02)
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
        wanted = {f"/fleet{name}" for row in TOPICS for _, name in row.names(observer.scene)}
        assert set(shown) == wanted
        assert "/".join(shown["/fleet/coverage"][10:12]) == "/".join(key.split("/")[-2:])
        assert {parts[7] for parts in tokens} == {"%fleet"}
        late.undeclare()
        for one in kept:
            one.undeclare()
        observer.close()
        stage.node.close()
