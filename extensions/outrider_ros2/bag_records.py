"""The records of a recording in a rosbag2 folder: one `std_msgs/String` topic of JSON, which tools of ROS 2 pass on."""

import struct
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from bus.errors import ScenarioError

RECORDS = "/outrider/recording"
"""The topic of the records."""
RECORDS_TYPE = "std_msgs/msg/String"
_METADATA = "metadata.yaml"
_TEXT = struct.Struct("<4sI")
"""Before a String's text: the encapsulation header, and its length with the zero at its end."""
_LITTLE_ENDIAN = b"\x00\x01"


class BagRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One message of a recording as it stands in a bag."""

    number: Annotated[int, Meta(ge=0)]
    """Counted from 0: a bag that others have rewritten shows what is missing."""
    topic: str
    """The recording's own channel, such as `/truth`."""
    time: Annotated[int, Meta(ge=0)]
    """On the recording's clock [ns]."""
    message: msgspec.Raw
    """JSON."""


_DECODER = msgspec.json.Decoder(BagRecord)


def record_in(raw: bytes) -> BagRecord:
    """The record in a message of the topic.

    Raises:
        ValueError: If the bytes are no String, or hold no record.
    """
    if len(raw) <= _TEXT.size or raw[:2] != _LITTLE_ENDIAN:
        raise ValueError("no String in little-endian CDR: rosbag2 may have packed it")
    _, size = _TEXT.unpack_from(raw)
    if not 0 < size <= len(raw) - _TEXT.size:
        raise ValueError("a String that ends early")
    return _DECODER.decode(raw[_TEXT.size : _TEXT.size + size - 1])


def bag_files(folder: Path) -> list[Path]:
    """The MCAP files of a bag, in no order.

    Raises:
        ScenarioError: If it is no bag, or has none.
    """
    if not (folder / _METADATA).is_file():
        raise ScenarioError(f"{folder}: no {_METADATA} in it; allowed: the folder of a rosbag2 bag")
    found = sorted(folder.glob("*.mcap"))
    if not found:
        raise ScenarioError(
            f"{folder}: no MCAP file in it; allowed: a bag that ros2 bag convert has stored as MCAP, not packed by file"
        )
    return found
