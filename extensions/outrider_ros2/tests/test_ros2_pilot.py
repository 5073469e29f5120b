"""A vehicle flown by a ROS 2 node: the trajectory of the local pilot, and nothing that is not its own."""

import threading
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zenoh

import staging
from agents.process import fly
from agents.uav import UavPilot
from agents.ugv import UgvPilot
from agents.warming import warm_up
from bus.credentials import new_credentials
from bus.errors import PeerLost
from bus.joining import open_session
from bus.keys import Role
from bus.messages.buildings import Building
from bus.messages.vehicle import UavBriefing, UavObservation, UgvBriefing, UgvObservation
from outrider_ros2.conversion import header
from outrider_ros2.interfaces import decode, encode, make
from outrider_ros2.ros_node import RosNode
from outrider_ros2.ros_pilot import RosPilot
from outrider_ros2.topics import (
    BRIEFING,
    OBSERVATION,
    OWN_BUILDINGS,
    OWN_ODOMETRY,
    PILOT_COMMANDS,
    wire_topic,
)
from outrider_ros2.wire import Attachment
from processes import wait_until
from sim.engine.briefing import briefing
from sim.scenario.loading import load_scenario
from staging import GIVEN as PLAIN
from staging import raw_session
from stamps import seconds_of

GIVEN = new_credentials("run", ["uav_0"], ["ugv_0"], extensions=["ros2"])
TEXT, ACCEL = PILOT_COMMANDS
BESIDE = Attachment(sequence=1, time=0, gid=bytes(16)).encoded()
KINDS: dict[str, Any] = {
    "uav_0": (UavPilot, UavBriefing, UavObservation),
    "ugv_0": (UgvPilot, UgvBriefing, UgvObservation),
}


def key_of(row: Any, vehicle: str, domain: int = 3) -> str:
    return wire_topic(row.interface, f"/{vehicle}/{row.name}").key(domain)


class Foreign:
    """A ROS 2 node that flies a vehicle with our pilot, over plain Zenoh."""

    def __init__(self, endpoint: str, vehicle: str, *, exact: bool) -> None:
        self._vehicle, self._exact = vehicle, exact
        self._lock = threading.Lock()
        self._make, briefing_type, seen = KINDS[vehicle]
        self._briefing = msgspec.json.Decoder(briefing_type)
        self._observation = msgspec.json.Decoder(seen)
        self._pilot: Any = None
        self._waiting: list[Any] = []
        """Topics are not ordered: the briefing may arrive last."""
        self.zenoh = raw_session(endpoint, GIVEN.of(vehicle))
        self._late = zenoh.ext.declare_advanced_subscriber(
            self.zenoh,
            key_of(BRIEFING, vehicle),
            self._brief,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        )
        self._own = self.zenoh.declare_subscriber(key_of(OBSERVATION, vehicle), self._act)

    def _brief(self, message: Any) -> None:
        text = decode(BRIEFING.interface, message.payload.to_bytes()).data
        with self._lock:
            self._pilot = self._make(self._briefing.decode(text))
            for sample in self._waiting:
                self._answer(sample)

    def _act(self, sample: Any) -> None:
        with self._lock:
            if self._pilot is None:
                self._waiting.append(sample)
            else:
                self._answer(sample)

    def _answer(self, sample: Any) -> None:
        text = decode(OBSERVATION.interface, sample.payload.to_bytes()).data
        seen = self._observation.decode(text)
        if seen.over:
            return
        command = self._pilot.act(seen)
        if self._exact:
            row, answer = TEXT, make(TEXT.interface, data=msgspec.json.encode(command).decode())
        else:
            row, answer = ACCEL, accelerate(seen.time, command.acceleration)
        payload = encode(row.interface, answer)
        self.zenoh.put(key_of(row, self._vehicle), payload, attachment=BESIDE)


def accelerate(seconds: float, value: tuple[float, float], frame: str = "map") -> Any:
    def vector(x: float, y: float) -> Any:
        return make("geometry_msgs/msg/Vector3", x=x, y=y, z=0.0)

    accel = make("geometry_msgs/msg/Accel", linear=vector(*value), angular=vector(0.0, 0.0))
    return make(ACCEL.interface, header=header(seconds, frame), accel=accel)


def bridge(endpoint: str, vehicle: str, links: list[RosPilot]) -> None:
    """Run `outrider ros2 --vehicle` as a thread."""
    credential = GIVEN.of(vehicle)
    with staging.client_of(endpoint, credential) as session:
        node = RosNode(session, domain=3, name="outrider", namespace=f"/{vehicle}")
        link = RosPilot(node, credential.party)
        links.append(link)
        wait_until(lambda: link.connected)
        fly(
            credential.party,
            link.make,
            connect=endpoint,
            run="run",
            credential=credential,
        )
        link.close()
        node.close()


@pytest.mark.parametrize(("vehicle", "exact"), [("uav_0", True), ("ugv_0", False)])
def test_ros_2_node_flies_the_trajectory_of_the_local_pilot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, vehicle: str, exact: bool
) -> None:
    """Send bad answers before each good one: they are refused and change nothing."""
    monkeypatch.setattr(staging, "GIVEN", GIVEN)
    for role in (Role.UAV, Role.UGV):
        warm_up(role)  # compile before the run starts
    with staging.stage(tmp_path, 60) as stage:
        links: list[RosPilot] = []
        thread = threading.Thread(target=bridge, args=(stage.endpoint, vehicle, links), daemon=True)
        thread.start()
        foreign = Foreign(stage.endpoint, vehicle, exact=exact)
        bad = [
            (TEXT, encode(TEXT.interface, make(TEXT.interface, data='{"tick": 1}'))),
            (ACCEL, encode(ACCEL.interface, accelerate(0.01, (9.0, 9.0)))),
            (ACCEL, encode(ACCEL.interface, accelerate(0.0, (float("nan"), 0.0)))),
            (ACCEL, b"\x00\x01\x00\x00short"),
        ]

        def disturb() -> None:
            for row, payload in bad:
                foreign.zenoh.put(key_of(row, vehicle), payload, attachment=BESIDE)

        stage.start("ugv_0" if vehicle == "uav_0" else "uav_0")
        flight = stage.fly(on_tick=disturb)
        thread.join(20.0)
        foreign.zenoh.close()
    assert flight.recorder.sha256() == staging.local_flight(60).recorder.sha256()
    assert links[0].answered == 60
    assert set(links[0].refusals.counts) >= {
        "invalid command",
        "answers another tick",
        "invalid CDR",
    }


def test_late_node_delays_no_tick_and_lost_node_ends_the_process(
    tmp_path: Path,
) -> None:
    session = open_session(
        PLAIN.of("uav_0").party, "run", listen=(f"unixsock-stream/{tmp_path / 's'}",)
    )
    with session as opened:
        node = RosNode(opened, domain=3, name="outrider")
        link = RosPilot(node, PLAIN.of("uav_0").party, patience=0.05)
        seen = msgspec.convert(
            {"tick": 4, "time": 0.2, "position": [0, 0], "velocity": [0, 0]}, UavObservation
        )
        link.perceive(seen)
        assert link.answer(lambda: False) is None
        with pytest.raises(PeerLost, match="the ROS 2 node of uav_0 disconnected"):
            link.answer(lambda: True)

        def reply(seconds: float, value: tuple[float, float]) -> None:
            answer = encode(ACCEL.interface, accelerate(seconds, value))
            link._receive(key_of(ACCEL, "uav_0"), answer, b"")

        reply(0.15, (0.1, 0.0))
        assert link.refusals.counts == {"answers another tick": 1}
        reply(0.2, (0.1, 0.0))
        answer = link.answer(lambda: True)
        reply(0.2, (0.3, 0.0))
        assert link.refusals.counts["answers a tick twice"] == 1
        assert answer is not None
        assert (answer.tick, answer.acceleration) == (4, (0.1, 0.0))
        assert seconds_of(header(0.2).stamp) == 0.2
        link.attend(lambda: True)
        again = link.make(briefing(load_scenario("escort"), "uav_0", 0))
        assert again.act(seen) is None  # from its past, for which nothing waits
        link.close()
        node.close()


def test_own_buildings_are_those_briefed_and_discovered(tmp_path: Path) -> None:
    endpoint = f"unixsock-stream/{tmp_path / 's'}"
    scenario = load_scenario("courtyard")
    known = briefing(scenario, "uav_0", 0).buildings
    hut = Building(polygon=((1.0, 1.0), (2.0, 1.0), (2.0, 2.0)), height=3.0)
    seen = UavObservation(
        tick=0, time=0.0, position=(0.0, 0.0), velocity=(0.0, 0.0), altitude=14.0, buildings=(hut,)
    )
    counts: list[int] = []

    def count(sample: Any) -> None:
        counts.append(len(decode(OWN_BUILDINGS.interface, sample.payload.to_bytes()).markers))

    with open_session(PLAIN.of("uav_0").party, "run", listen=(endpoint,)) as opened:
        node = RosNode(opened, domain=3, name="outrider")
        link = RosPilot(node, PLAIN.of("uav_0").party)
        foreign = raw_session(endpoint, None)
        own = foreign.declare_subscriber(key_of(OWN_BUILDINGS, "uav_0"), count)
        # subscriptions take effect in order: when the second is known, so is the first
        after = foreign.declare_subscriber(key_of(OWN_ODOMETRY, "uav_0"), lambda _: None)
        wait_until(lambda: link.connected)
        link.make(briefing(scenario, "uav_0", 0))
        for _ in range(2):  # an observation is repeated for a node that joins late
            link.perceive(seen)
        link.make(briefing(scenario, "uav_0", 0))
        wait_until(lambda: len(counts) >= 3)
        own.undeclare()
        after.undeclare()
        foreign.close()
        link.close()
        node.close()
    assert known
    assert counts == [len(known), len(known) + 1, len(known)]
