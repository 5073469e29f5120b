"""Records of a recording in a rosbag2 folder: JSON on one `std_msgs/String` topic, preserved by ROS 2 tools."""

import struct
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.errors import ScenarioError

RECORDS = "/outrider/recording"
"""Topic of the records."""
RECORDS_TYPE = "std_msgs/msg/String"
_METADATA = "metadata.yaml"
_TEXT = struct.Struct("<4sI")
"""Encapsulation header and length (including the final zero) that precede a String's text."""
_LITTLE_ENDIAN = b"\x00\x01"


class BagRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Message of a recording, as stored in a bag."""

    number: Annotated[int, Meta(ge=0)]
    """Counter from 0; a gap reveals records lost by other tools."""
    topic: str
    """Channel of the recording, such as `/truth`."""
    time: Annotated[int, Meta(ge=0)]
    """Time on the recording's clock [ns]."""
    message: msgspec.Raw
    """Message as JSON."""


_DECODER = msgspec.json.Decoder(BagRecord)


def record_in(raw: bytes) -> BagRecord:
    """Return the record in a message of the topic.

    Raises:
        ValueError: If the bytes are not a String, or hold no record.
    """
    if len(raw) <= _TEXT.size or raw[:2] != _LITTLE_ENDIAN:
        raise ValueError("not a String in little-endian CDR: rosbag2 may have compressed it")
    _, size = _TEXT.unpack_from(raw)
    if not 0 < size <= len(raw) - _TEXT.size:
        raise ValueError("truncated String")
    return _DECODER.decode(raw[_TEXT.size : _TEXT.size + size - 1])


def bag_files(folder: Path) -> list[Path]:
    """Return the MCAP files of a bag, in arbitrary order.

    Raises:
        ScenarioError: If the folder is not a bag, or has no MCAP file.
    """
    if not (folder / _METADATA).is_file():
        raise ScenarioError(
            f"{folder}: {_METADATA} is missing; allowed: the folder of a rosbag2 bag"
        )
    found = sorted(folder.glob("*.mcap"))
    if not found:
        raise ScenarioError(
            f"{folder}: no MCAP file; allowed: a bag in MCAP format without file compression (see ros2 bag convert)"
        )
    return found
