"""Repair of a recording whose process was killed: its whole records in a new file that any reader of MCAP opens."""

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
    """The outcome of a repair."""

    messages: int
    lost_bytes: int
    reason: str
    """The fault; empty: none."""


def repair(path: Path, out: Path) -> Repair:
    """Write every whole record of a file into a new one that any reader of MCAP opens.

    Args:
        path: The killed file.
        out: The new one; replaced if it is there.

    Raises:
        ScenarioError: If there is nothing to save, or both are the same file.
        OSError: If the new file cannot be written.
    """
    if out.exists() and out.samefile(path):
        raise ScenarioError(f"{out}: is the file to be repaired; allowed: another one")
    damage = Damage()
    found = stream(path, damage)
    first = next(found, None)
    if first is None:
        raise ScenarioError(f"{path}: nothing whole is in it ({damage.reason})")
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
