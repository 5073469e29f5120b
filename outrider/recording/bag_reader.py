"""The records of a recording in a rosbag2 folder: one `std_msgs/String` topic of JSON, which tools of ROS 2 pass on."""

import struct
from collections.abc import Iterator
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


def _text(raw: bytes) -> bytes:
    """The text of a `std_msgs/String`.

    Raises:
        ValueError: If the bytes are none.
    """
    if len(raw) <= _TEXT.size or raw[:2] != _LITTLE_ENDIAN:
        raise ValueError("no String in little-endian CDR")
    _, size = _TEXT.unpack_from(raw)
    if not 0 < size <= len(raw) - _TEXT.size:
        raise ValueError("a String that ends early")
    return raw[_TEXT.size : _TEXT.size + size - 1]


def bag_size(folder: Path) -> int:
    """The bytes of all files in a bag."""
    return sum(file.stat().st_size for file in folder.iterdir() if file.is_file())


def bag_records(folder: Path) -> Iterator[BagRecord]:
    """The records in a rosbag2 folder in the order of their times: of MCAP or SQLite, packed or split.

    Raises:
        ScenarioError: If it is no bag, one without the records, or damaged, or the extra is missing.
    """
    if not (folder / _METADATA).is_file():
        raise ScenarioError(
            f"{folder}: no {_METADATA} in it; allowed: an MCAP file or the folder of a rosbag2 bag"
        )
    try:
        from rosbags.rosbag2 import Reader  # noqa: PLC0415 - an extra
    except ImportError as absent:
        raise ScenarioError(
            f"{folder}: a bag needs the extra: pip install -e '.[ros2]'"
        ) from absent
    try:
        with Reader(folder) as reader:
            wanted = [
                one
                for one in reader.connections
                if one.topic == RECORDS and one.msgtype == RECORDS_TYPE
            ]
            if not wanted:
                raise ScenarioError(
                    f"{folder}: no topic {RECORDS} in it: not a recording of Outrider's"
                )
            for _, _, raw in reader.messages(wanted):
                yield _DECODER.decode(_text(raw))
    except ScenarioError:
        raise
    except Exception as error:  # the library raises whatever it meets in a damaged file
        why = " ".join(str(error).split()) or type(error).__name__
        raise ScenarioError(f"{folder}: damaged: {why}; allowed: a whole bag") from error
