"""A ROS 2 node in our environment that flies a vehicle with our pilot, over plain Zenoh.

Arguments: endpoint, the vehicle's file of credentials, domain, `exact` (answers as JSON) or `accel` (as AccelStamped).
Ends with the run.
"""

import json
import sys
import threading
from pathlib import Path
from typing import Any

import msgspec
import zenoh
import zenoh.ext

from agents.uav import UavPilot
from agents.ugv import UgvPilot
from agents.warming import warm_up
from bus.access import client_settings
from bus.credentials import read_credential
from bus.keys import Role
from bus.messages.vehicle import UavBriefing, UavObservation, UgvBriefing, UgvObservation
from outrider_ros2.conversion import header
from outrider_ros2.interfaces import decode, encode, make
from outrider_ros2.topics import BRIEFING, OBSERVATION, PILOT_COMMANDS, TopicRow, wire_topic
from outrider_ros2.wire import Attachment

endpoint, file, domain, form = sys.argv[1:5]
known = read_credential(Path(file))
TEXT, ACCEL = PILOT_COMMANDS
kinds: dict[Role, Any] = {
    Role.UAV: (UavPilot, UavBriefing, UavObservation),
    Role.UGV: (UgvPilot, UgvBriefing, UgvObservation),
}
make_pilot, briefing, observation = kinds[known.role]
warm_up(known.role)
lock, over = threading.Lock(), threading.Event()
pilots: list[Any] = []
waiting: list[str] = []


def key_of(row: TopicRow) -> str:
    return wire_topic(row.interface, f"/{known.name}/{row.name}").key(int(domain))


def text_of(sample: Any) -> str:
    text: str = decode("std_msgs/msg/String", sample.payload.to_bytes()).data
    return text


def answer(text: str) -> None:
    seen = msgspec.json.decode(text, type=observation)
    if seen.over:
        over.set()
        return
    command = pilots[0].act(seen)
    if form == "exact":
        payload = make(TEXT.interface, data=msgspec.json.encode(command).decode())
    else:
        x, y = command.acceleration
        linear = make("geometry_msgs/msg/Vector3", x=x, y=y, z=0.0)
        accel = make("geometry_msgs/msg/Accel", linear=linear, angular=linear)
        payload = make(ACCEL.interface, header=header(seen.time), accel=accel)
    row = TEXT if form == "exact" else ACCEL
    beside = Attachment(sequence=1, time=0, gid=bytes(16)).encoded()
    session.put(key_of(row), encode(row.interface, payload), attachment=beside)


def brief(sample: Any) -> None:
    with lock:
        pilots[:] = [make_pilot(msgspec.json.decode(text_of(sample), type=briefing))]
        for text in waiting:
            answer(text)
        waiting.clear()


def act(sample: Any) -> None:
    with lock:
        if pilots:
            answer(text_of(sample))
        else:
            waiting.append(text_of(sample))


config = zenoh.Config()
for path, value in (
    {"mode": "client", "connect/endpoints": [endpoint]} | client_settings(known)
).items():
    config.insert_json5(path, json.dumps(value))
with zenoh.open(config) as session:
    late = zenoh.ext.declare_advanced_subscriber(
        session, key_of(BRIEFING), brief,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
    )  # fmt: skip
    own = session.declare_subscriber(key_of(OBSERVATION), act)
    over.wait(300.0)
