"""Delays of a topic in a rosbag2: header stamps against receive times."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bus.errors import ScenarioError
from bus.plugins import needs
from outrider_networks.message_times import MessageTimes, with_gaps
from sim.input.faults import near, one_line

with needs("networks"):
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

_HEADER = "std_msgs/msg/Header"


def bag_times(folder: Path, topic: str) -> MessageTimes:
    """Return the messages of a topic whose type has a header.

    A header has a time stamp, but no sequence number. Hence the losses: messages that are missing at multiples of the
    interval between the stamps.

    Args:
        folder: Folder of the bag.
        topic: Name of the topic; empty: the only one with headers.

    Raises:
        ScenarioError: If the folder is not a readable bag, or has no such topic.
    """
    name = one_line(str(folder))
    if not (folder / "metadata.yaml").is_file():
        raise ScenarioError(
            f"{name}: metadata.yaml is missing; allowed: the folder of a rosbag2 bag"
        )
    try:
        # bags before Iron contain no definitions
        types = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([folder], default_typestore=types) as reader:
            stamped = _stamped(reader, _chosen(reader, topic, name))
            rows = np.array(sorted(stamped), dtype=np.int64).reshape(-1, 2)
    except ScenarioError:
        raise
    except (AnyReaderError, KeyError, ValueError, OSError) as error:
        reason = one_line(str(error))
        raise ScenarioError(
            f"{name}: cannot be read: {reason}; allowed: an intact rosbag2"
        ) from error
    if not len(rows):
        raise ScenarioError(f"{name}: no message on the topic; allowed: recordings with messages")
    sent = (rows[:, 0] - rows[0, 0]) / 1e9
    note = (
        "delays are the recorder's receive times minus the header stamps: an offset of the two clocks, and the time "
        "from the stamp to sending, are part of them"
    )
    return with_gaps(MessageTimes(sent, (rows[:, 1] - rows[:, 0]) / 1e9, (note,)))


def _chosen(reader: AnyReader, topic: str, name: str) -> str:
    """Return the topic to read."""
    known = sorted(
        {one.topic for one in reader.connections if _has_header(reader.typestore, one.msgtype)}
    )
    allowed = f"--topic with {' or '.join(known)}" if known else "a topic with a header"
    if topic:
        if topic not in known:
            there = any(one.topic == topic for one in reader.connections)
            wrong = "its messages have no header" if there else f"unknown{near(topic, known)}"
            raise ScenarioError(f"{name}: --topic {one_line(topic)}: {wrong}; allowed: {allowed}")
        return topic
    if len(known) != 1:
        wrong = "several topics with headers" if known else "no topic with a header"
        raise ScenarioError(f"{name}: {wrong}; allowed: {allowed}")
    return known[0]


def _has_header(typestore: Any, kind: str) -> bool:  # noqa: ANN401 - of rosbags
    """Return whether the first field of a type is a header."""
    _, fields = typestore.fielddefs.get(kind, ((), ()))
    return bool(fields) and fields[0][0] == "header" and fields[0][1][1] == _HEADER


def _stamped(reader: AnyReader, topic: str) -> Iterator[tuple[int, int]]:
    """Yield header stamp and receive time of each message [ns]."""
    wanted = [one for one in reader.connections if one.topic == topic]
    for one, received, raw in reader.messages(connections=wanted):
        message: Any = reader.deserialize(raw, one.msgtype)
        stamp = message.header.stamp
        yield stamp.sec * 1_000_000_000 + stamp.nanosec, received
