"""Reader of the recording in a rosbag2 folder, up to the first missing or damaged record."""

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


class _Record(NamedTuple):
    """Record of the recording in a bag."""

    number: int
    entry: Entry


def bag_entries(folder: Path, damage: Damage) -> Iterator[Entry]:
    """Read the messages of the recording in a bag.

    Args:
        folder: Folder of the bag.
        damage: Set to the place and the reason if reading ends early.

    Raises:
        ScenarioError: If the folder is not a bag, or holds no Outrider recording.
    """
    damage.end = damage.size = sum(
        file.stat().st_size for file in folder.iterdir() if file.is_file()
    )
    for count, (number, entry) in enumerate(_records_of_parts(_in_order(folder), damage)):
        if number != count:
            damage.reason = f"record {count} is missing"
            return
        yield entry


def _in_order(folder: Path) -> list[Path]:
    """Return the files with records, sorted by their first record; files damaged before it come last."""
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
            f"{folder}: no intact record ({reason})"
            if reason
            else f"{folder}: not an Outrider recording: topic {RECORDS} is missing"
        )
    return sorted(first, key=lambda file: first[file])


def _records_of_parts(files: list[Path], damage: Damage) -> Iterator[_Record]:
    """Read the records in the files of a bag, up to the first damage."""
    for file in files:
        part = Damage()
        yield from _records_of(file, part)
        if part.reason:
            damage.reason = f"{file.name}: {part.reason}"
            damage.end -= part.size - part.end
            return


def _records_of(path: Path, damage: Damage) -> Iterator[_Record]:
    channels: set[int] = set()
    for record in stream(path, damage):
        if isinstance(record, records.Channel) and record.topic == RECORDS:
            channels.add(record.id)
        elif isinstance(record, records.Message) and record.channel_id in channels:
            try:
                found = record_in(record.data)
            except ValueError as error:
                seconds = record.log_time / 1e9
                raise ScenarioError(
                    f"{path}: {RECORDS} at {seconds:g} s: {error}; allowed: records written by Outrider"
                ) from error
            if found.time > schemas.LATEST:
                raise out_of_range(path, found.topic, found.time)
            yield _Record(
                found.number, Entry(topic=found.topic, time=found.time, data=bytes(found.message))
            )


_DECODERS: dict[str, tuple[schemas.Topic, "msgspec.json.Decoder[Any]"]] = {
    topic.name: (topic, msgspec.json.Decoder(topic.message))
    for topic in schemas.TOPICS
    if topic is not schemas.SCENARIO
}
_OPERATOR_DECODER = msgspec.json.Decoder(schemas.OperatorCommand)


def import_bag(folder: Path, file: Path, damage: Damage) -> Iterator[float]:
    """Write the recording in a bag to an MCAP file; replace an existing file.

    Args:
        folder: Folder of the bag.
        file: MCAP file to write.
        damage: Set to the place and the reason if reading ends early.

    Yields:
        Time of each message on the recording's clock [s].

    Raises:
        ScenarioError: If the bag holds no Outrider recording.
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
                topic, decoder = schemas.operator_topic(ugv), _OPERATOR_DECODER
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
