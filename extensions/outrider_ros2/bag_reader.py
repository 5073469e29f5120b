"""Reading the recording in a rosbag2 folder, up to the first of its records that is missing or damaged."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from mcap import records

from bus.errors import ScenarioError
from outrider.recording import schemas
from outrider.recording.mcap_file import RecordingFile
from outrider.recording.reader import Damage, Entry, decoded, out_of_range, stream
from outrider_ros2.bag_records import RECORDS, bag_files, record_in


class _Kept(NamedTuple):
    """A record of the recording in a bag."""

    number: int
    entry: Entry


def bag_entries(folder: Path, damage: Damage) -> Iterator[Entry]:
    """Read the messages of the recording in a bag.

    Args:
        folder: The bag.
        damage: Receives where and why reading ended.

    Raises:
        ScenarioError: If it is no bag, or holds no recording of Outrider's.
    """
    damage.end = damage.size = sum(
        file.stat().st_size for file in folder.iterdir() if file.is_file()
    )
    for count, (number, entry) in enumerate(_records_of_parts(_in_order(folder), damage)):
        if number != count:
            damage.reason = f"its record {count} is missing"
            return
        yield entry


def _in_order(folder: Path) -> list[Path]:
    """Return the files of a bag that hold records, by the number of their first; last those damaged before it."""
    first: dict[Path, float] = {}
    reason = ""
    for file in bag_files(folder):
        damage = Damage()
        number = next((number for number, _ in _records_of(file, damage)), None)
        if number is not None or damage.reason:
            first[file] = math.inf if number is None else number
            reason = reason or damage.reason
    if not math.isfinite(min(first.values(), default=math.inf)):
        raise ScenarioError(
            f"{folder}: nothing whole is in it ({reason})"
            if reason
            else f"{folder}: not a recording of Outrider: no topic {RECORDS} in it"
        )
    return sorted(first, key=lambda file: first[file])


def _records_of_parts(files: list[Path], damage: Damage) -> Iterator[_Kept]:
    """Read the records in the files of a bag, up to where one is damaged."""
    for file in files:
        part = Damage()
        yield from _records_of(file, part)
        if part.reason:
            damage.reason = f"{file.name}: {part.reason}"
            damage.end -= part.size - part.end
            return


def _records_of(path: Path, damage: Damage) -> Iterator[_Kept]:
    channels: set[int] = set()
    for record in stream(path, damage):
        if isinstance(record, records.Channel) and record.topic == RECORDS:
            channels.add(record.id)
        elif isinstance(record, records.Message) and record.channel_id in channels:
            try:
                kept = record_in(record.data)
            except ValueError as error:
                seconds = record.log_time / 1e9
                raise ScenarioError(
                    f"{path}: {RECORDS} at {seconds:g} s: {error}; allowed: what Outrider writes"
                ) from error
            if kept.time > schemas.LATEST:
                raise out_of_range(path, kept.topic, kept.time)
            yield _Kept(
                kept.number, Entry(topic=kept.topic, time=kept.time, data=bytes(kept.message))
            )


_DECODERS: dict[str, tuple[schemas.Topic, "msgspec.json.Decoder[Any]"]] = {
    topic.name: (topic, msgspec.json.Decoder(topic.message))
    for topic in schemas.TOPICS
    if topic is not schemas.SCENARIO
}
_WORDS = msgspec.json.Decoder(schemas.OperatorCommand)


def import_bag(folder: Path, file: Path, damage: Damage) -> Iterator[float]:
    """Write the recording in a bag into an MCAP file, which is replaced if it is there.

    Args:
        folder: The bag.
        file: The file.
        damage: Receives where and why reading the bag ended.

    Yields:
        Time of each message on the recording's clock [s].

    Raises:
        ScenarioError: If the bag holds no recording of Outrider's.
        OSError: If the file cannot be written.
    """
    written: RecordingFile | None = None
    start = 0
    try:
        for entry in bag_entries(folder, damage):
            if entry.topic == schemas.SCENARIO.name:
                head = schemas.read_head(entry.data, file=str(folder))
                written = written or RecordingFile(file, private=bool(head.secret))
                known = head.scenario is not None
                start = round(head.start * 1e9)
                written.begin(head, schemas.scenario_in(head, file=str(folder)) if known else None)
                continue
            ugv = schemas.ugv_of(entry.topic)
            if ugv is not None:
                topic, decoder = schemas.operator_topic(ugv), _WORDS
            elif entry.topic in _DECODERS:
                topic, decoder = _DECODERS[entry.topic]
            else:
                continue
            if written is not None:
                written.take(topic, decoded(folder, entry, decoder), (entry.time - start) / 1e9)
                written.flush_if_due()
            yield entry.time / 1e9
    finally:
        if written is not None:
            written.close()
