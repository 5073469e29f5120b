"""Repair of the recording of a killed process: copy of its complete records to a valid MCAP file."""

from dataclasses import dataclass
from pathlib import Path

from bus.errors import ScenarioError
from bus.files import writing
from bus.plugins import needs
from outrider.recording.reader import Damage, stream

with needs("record"):
    from mcap import records
    from mcap.writer import Writer


@dataclass(frozen=True, slots=True, kw_only=True)
class Repair:
    """Result of a repair."""

    messages: int
    lost_bytes: int
    reason: str
    """Description of the damage; empty: none."""


def repair(path: Path, out: Path) -> Repair:
    """Write every complete record of a file to a valid MCAP file.

    Args:
        path: Damaged file.
        out: New file; an existing file is replaced.

    Raises:
        ScenarioError: If the file has no complete record, or both paths are the same file.
        OSError: If the new file cannot be written.
    """
    if out.exists() and out.samefile(path):
        raise ScenarioError(f"{out}: is the damaged file itself; allowed: another file")
    damage = Damage()
    found = stream(path, damage)
    first = next(found, None)
    if first is None:
        raise ScenarioError(f"{path}: no complete record in it ({damage.reason})")
    messages = 0
    kinds, channels = {0: 0}, dict[int, int]()
    with writing(out), out.open("wb") as file:
        writer = Writer(file)
        writer.start(
            profile=getattr(first, "profile", ""), library=f"outrider repair of {path.name}"
        )
        for record in found:
            if isinstance(record, records.Schema) and record.id not in kinds:
                kinds[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, records.Channel) and record.id not in channels:
                channels[record.id] = writer.register_channel(
                    record.topic,
                    record.message_encoding,
                    kinds.get(record.schema_id, 0),
                    dict(record.metadata),
                )
            elif isinstance(record, records.Message) and record.channel_id in channels:
                messages += 1
                writer.add_message(
                    channels[record.channel_id],
                    record.log_time,
                    record.data,
                    record.publish_time,
                    record.sequence,
                )
        writer.finish()  # type: ignore[no-untyped-call]
    return Repair(messages=messages, lost_bytes=damage.size - damage.end, reason=damage.reason)
