"""Reads all messages of a bag by rosbags and by mcap-ros2-support, and its metadata; runs in their environment.

Arguments: a bag, and optionally a file for its payloads, as a pickle of name, type and bytes. Otherwise prints JSON.
"""

import json
import pickle
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML

QOS = {
    "history", "depth", "reliability", "durability", "deadline", "lifespan", "liveliness",
    "liveliness_lease_duration", "avoid_ros_namespace_conventions",
}  # fmt: skip
"""Fields of a quality of service that rosbag2 requires."""


def numbers(odometry: Any) -> list[str]:
    position, velocity = odometry.pose.pose.position, odometry.twist.twist.linear
    return [value.hex() for value in (position.x, position.y, velocity.x, velocity.y)]


def by_topic(messages: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return message counts by topic, and the odometry of each vehicle."""
    counts: Counter[str] = Counter()
    tracks: dict[str, list[list[str]]] = {}
    for topic, message in messages:
        counts[topic] += 1
        if topic.endswith("/odom"):
            tracks.setdefault(topic.split("/")[1], []).append(numbers(message))
    return {"counts": dict(counts), "odometry": tracks}


def by_rosbags(bag: Path) -> dict[str, Any]:
    with AnyReader([bag]) as reader:
        return by_topic(
            (one.topic, reader.deserialize(raw, one.msgtype)) for one, _, raw in reader.messages()
        )


def by_mcap(bag: Path) -> dict[str, Any]:
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as raw:
        reader = make_reader(raw, decoder_factories=[DecoderFactory()], validate_crcs=True)
        assert {one.encoding for one in reader.get_summary().schemas.values()} == {"ros2msg"}
        found = by_topic(
            (channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()
        )
        return {**found, "statistics": reader.get_summary().statistics.message_count}


def by_metadata(bag: Path) -> dict[str, Any]:
    metadata = YAML(typ="safe").load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
    counts: dict[str, int] = {}
    wrong = []
    for one in metadata["topics_with_message_count"]:
        topic = one["topic_metadata"]
        counts[topic["name"]] = one["message_count"]
        profiles = topic["offered_qos_profiles"]
        good = len(profiles) == 1 and all(set(profile) == QOS for profile in profiles)
        if not good or not topic["type_description_hash"].startswith("RIHS01_"):
            wrong.append(topic["name"])
    files = sum(one["message_count"] for one in metadata["files"])
    assert files == metadata["message_count"]
    return {
        "counts": counts,
        "messages": metadata["message_count"],
        "version": metadata["version"],
        "wrong": wrong,
    }


place = Path(sys.argv[1])
if len(sys.argv) > 2:
    with AnyReader([place]) as everything:
        rows = [(one.topic, one.msgtype, bytes(raw)) for one, _, raw in everything.messages()]
    Path(sys.argv[2]).write_bytes(pickle.dumps(rows))
else:
    print(
        json.dumps(
            {
                "rosbags": by_rosbags(place),
                "mcap-ros2-support": by_mcap(place),
                "metadata": by_metadata(place),
            }
        )
    )
