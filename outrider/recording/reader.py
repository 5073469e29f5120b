"""Reading a recording as a stream, up to its last whole record: a killed file reads like one that was closed."""

import os
import struct
import zlib
from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import msgspec

from bus.errors import ScenarioError
from bus.files import open_regular, writing
from bus.messages import (
    CertificateStatus,
    Change,
    CoverageMap,
    GroundMap,
    LinkStatus,
    Message,
    MissionResult,
    Status,
    Truth,
)
from bus.plugins import needs
from outrider.recording import schemas
from sim.scenario.types import Scenario

with needs("record"):
    import lz4.frame
    import zstandard
    from mcap import records
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.opcode import Opcode
    from mcap.writer import Writer

Sent = TypeVar("Sent", bound=Message)

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = 9
"""Bytes before a record's content: its kind and its length."""
_MOST_BYTES = 16 << 20
"""Of a record and of a chunk's content: the largest map of the ground, and as much again as a viewer is shown of it."""
_SPARE, _RATIO = 32 << 20, 200
"""A whole file may unpack to so many bytes, and to so many times its size.

Flights unpack to twelve times theirs, a short one of the largest area to 140 times."""
_LEAST = 512
"""A packed record counts as so many bytes at least: a million empty ones take their time and room, too."""
_KINDS: dict[int, type[Any]] = {
    Opcode.HEADER: records.Header,
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.CHUNK: records.Chunk,
}
_BROKEN = (
    McapError,
    struct.error,
    UnicodeDecodeError,
    ValueError,
    zlib.error,
    zstandard.ZstdError,
    RuntimeError,
    MemoryError,
)
"""The errors that the libraries raise on bytes that are no record."""


@dataclass(slots=True, kw_only=True)
class Damage:
    """The place from which on a file cannot be read."""

    end: int = 0
    """Bytes that could be read."""
    size: int = 0
    """Bytes that are there."""
    reason: str = ""
    """Empty: the file was closed as it should be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """One message of a recording."""

    topic: str
    time: int
    """On the file's clock [ns]."""
    data: bytes


def _open(path: Path) -> BinaryIO:
    try:
        file = open_regular(path)
    except (OSError, ValueError) as error:
        raise ScenarioError(
            f"{path}: {getattr(error, 'strerror', None) or error}; allowed: an MCAP file"
        ) from error
    if file.read(len(_MAGIC)) != _MAGIC:
        file.close()
        raise ScenarioError(f"{path}: not an MCAP file; allowed: a recording of Outrider's")
    return file


class _Reader:
    """The records of a file, and how much they may yet unpack to.

    Args:
        size: Of the file [bytes].
    """

    def __init__(self, size: int) -> None:
        self._left = _SPARE + _RATIO * size

    def parse(self, kind: int, content: bytes) -> list[Any]:
        """The records in one record of the file: those of a chunk, or itself."""
        data = ReadDataStream(BytesIO(content))
        if kind == Opcode.MESSAGE:
            return [records.Message.read(data, len(content))]
        record = _KINDS[kind].read(data)
        return self._broken_up(record) if kind == Opcode.CHUNK else [record]

    def _broken_up(self, chunk: records.Chunk) -> list[Any]:
        content = _unpacked(chunk)
        if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
            raise ValueError("a chunk's checksum is wrong")
        data, found = ReadDataStream(BytesIO(content)), []
        while data.count < len(content):
            kind, length = data.read1(), data.read8()
            self._left -= max(length, _LEAST)
            if self._left < 0:
                raise ValueError(f"it unpacks to more than {_RATIO} times its size")
            if kind == Opcode.MESSAGE:
                found.append(records.Message.read(data, length))
            elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
                found.append(_KINDS[kind].read(data))
            else:
                raise ValueError(f"a chunk with a record of kind {kind}")
        return found


def _unpacked(chunk: records.Chunk) -> bytes:
    """The content of a chunk; neither its declared nor its true size may be more than fits."""
    if chunk.uncompressed_size > _MOST_BYTES:
        raise ValueError(
            f"a chunk of {chunk.uncompressed_size:,} bytes; {_MOST_BYTES:,} are the most"
        )
    if chunk.compression == "zstd":
        true = zstandard.frame_content_size(chunk.data)
        # -1: the frame does not tell, and the limit holds while it is unpacked
        if true not in (-1, chunk.uncompressed_size):
            raise ValueError(f"a chunk of {true:,} bytes that declares {chunk.uncompressed_size:,}")
        content: bytes = zstandard.decompress(chunk.data, chunk.uncompressed_size)
    elif chunk.compression == "lz4":
        content = lz4.frame.LZ4FrameDecompressor().decompress(
            chunk.data, max_length=chunk.uncompressed_size + 1
        )
    elif chunk.compression == "":
        content = chunk.data
    else:
        raise ValueError(
            f"a chunk packed with {chunk.compression[:20]!r}; read are zstd, lz4 and plain ones"
        )
    if len(content) != chunk.uncompressed_size:
        raise ValueError(
            f"a chunk of {len(content):,} bytes that declares {chunk.uncompressed_size:,}"
        )
    return content


def stream(path: Path, damage: Damage | None = None) -> Iterator[Any]:
    """Every whole record of the data section: header, schemas, channels and messages as the library `mcap` has them.

    Args:
        path: The file.
        damage: Is told where and why reading ended.

    Raises:
        ScenarioError: If it is no MCAP file.
    """
    told = damage if damage is not None else Damage()
    with _open(path) as file:
        told.size = os.fstat(file.fileno()).st_size
        told.end = len(_MAGIC)
        reader = _Reader(told.size)
        while True:
            head = file.read(_HEAD)
            if len(head) < _HEAD:
                told.reason = "it ends without a footer"
                return
            kind, length = struct.unpack("<BQ", head)
            if length > told.size - told.end - _HEAD:
                told.reason = "it ends within a record"
                return
            if kind == Opcode.DATA_END:
                told.end = told.size
                return
            if kind != Opcode.MESSAGE and kind not in _KINDS:
                # indexes and statistics, which a stream has no use for
                file.seek(length, os.SEEK_CUR)
                told.end += _HEAD + length
                continue
            if length > _MOST_BYTES:
                told.reason = f"damaged at byte {told.end}: a record of {length:,} bytes; {_MOST_BYTES:,} are the most"
                return
            try:
                found = reader.parse(kind, file.read(length))
            except _BROKEN as error:
                told.reason = f"damaged at byte {told.end}: {' '.join(str(error).split()) or type(error).__name__}"
                return
            told.end += _HEAD + length
            yield from found


def entries(
    path: Path, topics: Collection[str] = (), damage: Damage | None = None
) -> Iterator[Entry]:
    """The messages in the order in which they were written.

    Args:
        path: The file.
        topics: Which channels; none: all.
        damage: Is told where and why reading ended.

    Raises:
        ScenarioError: If it is no MCAP file, or not one of Outrider's.
    """
    names: dict[int, str] = {}
    for record in stream(path, damage):
        if isinstance(record, records.Channel):
            if record.message_encoding != "cdr":  # of other programs
                names[record.id] = record.topic
        elif isinstance(record, records.Message) and record.channel_id in names:
            topic = names[record.channel_id]
            if record.log_time > schemas.LATEST:
                raise out_of_range(path, topic, record.log_time)
            if not topics or topic in topics:
                yield Entry(topic=topic, time=record.log_time, data=record.data)


def out_of_range(path: Path, topic: str, time: int) -> ScenarioError:
    """Return the error of a message with a time [ns] that no recording has."""
    return ScenarioError(
        f"{path}: {topic}: time = {time} ns: out of range; allowed up to {schemas.LATEST}"
    )


def decoded(path: Path, entry: Entry, decoder: "msgspec.json.Decoder[Sent]") -> Sent:
    """The message of an entry.

    Raises:
        ScenarioError: If it is none of its kind.
    """
    try:
        return decoder.decode(entry.data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ScenarioError(
            f"{path}: {entry.topic} at {entry.time / 1e9:g} s: {error}; allowed: what Outrider writes"
        ) from error


def _all(path: Path, topic: schemas.Topic, kind: type[Sent], flight: int | None) -> Iterator[Sent]:
    decoder = msgspec.json.Decoder(kind)
    number = -1
    for entry in entries(path, (schemas.SCENARIO.name, topic.name)):
        if entry.topic == schemas.SCENARIO.name:
            number += 1
        elif flight is None or flight == number:
            yield decoded(path, entry, decoder)


def coverages(path: Path, *, flight: int | None = None) -> Iterator[CoverageMap]:
    """Every map of the ground in the file, read as a stream.

    Args:
        path: The file.
        flight: Of which of its flights, from 0; None: of all, one after the other.

    Raises:
        ScenarioError: If the file cannot be read.
    """
    return _all(path, schemas.COVERAGE, CoverageMap, flight)


def grounds(path: Path, *, flight: int) -> Iterator[GroundMap]:
    """Every map of the ground with its hazards of one flight, each with them; as `coverages`."""
    hazards = None
    for ground in _all(path, schemas.GROUND, GroundMap, flight):
        hazards = ground.hazards if hazards is None else hazards
        yield msgspec.structs.replace(ground, hazards=hazards)


def statuses(path: Path, *, flight: int | None = None) -> Iterator[Status]:
    """Every Status; as `coverages`."""
    return _all(path, schemas.STATUS, Status, flight)


@dataclass(slots=True, kw_only=True)
class Recording:
    """One flight of a file, without its maps."""

    path: Path
    number: int
    """The flight's number in the file, from 0."""
    head: schemas.Head
    truths: list[Truth] = field(default_factory=list)
    commands: dict[int, schemas.Commands] = field(default_factory=dict)
    """By tick."""
    words: list[tuple[str, schemas.OperatorWord]] = field(default_factory=list)
    """UGV and message of each operator's command, in the order in which they were received."""
    changes: list[Change] = field(default_factory=list)
    """The operators' changes; of a run that an observer recorded, pauses and speeds too."""
    factors: list[float] = field(default_factory=list)
    """Simulated seconds per second of wall time, as the run's status told now and then."""
    links: dict[str, LinkStatus] = field(default_factory=dict)
    """The counters of each link by the last status: nothing else of a recording tells."""
    certificates: CertificateStatus | None = None
    """The words of the safety filters by then, held against the truth; None where none watched."""
    mission: MissionResult | None = None
    """The UGVs' way through by then; None where there are no hazards."""
    damage: Damage = field(default_factory=Damage)

    @property
    def last_ground(self) -> GroundMap | None:
        """The last map of the ground with its hazards; None where there are none."""
        found = deque(grounds(self.path, flight=self.number), maxlen=1)
        return found[0] if found else None

    @property
    def scenario(self) -> Scenario:
        """The scenario that was flown.

        Raises:
            ScenarioError: If the file does not tell, or this version cannot fly it.
        """
        return schemas.scenario_in(self.head, file=str(self.path))

    @property
    def missing_ticks(self) -> int:
        """Ticks between the first and the last that are not in the file."""
        if not self.truths:
            return 0
        return self.truths[-1].tick - self.truths[0].tick + 1 - len(self.truths)


def load(path: Path) -> list[Recording]:
    """The flights of a file.

    Raises:
        ScenarioError: If it is no MCAP file, not one of Outrider's, of another version, or nothing whole is in it.
    """
    damage = Damage()
    flights: list[Recording] = []
    topics = (schemas.TRUTH, schemas.COMMANDS, schemas.STATUS, schemas.CHANGES)
    decoders: dict[str, msgspec.json.Decoder[Any]] = {
        topic.name: msgspec.json.Decoder(topic.message) for topic in topics
    }
    words = msgspec.json.Decoder(schemas.OperatorWord)
    seen = 0
    for entry in entries(path, damage=damage):
        seen += 1
        if entry.topic == schemas.SCENARIO.name:
            head = schemas.read_head(entry.data, file=str(path))
            flights.append(Recording(path=path, number=len(flights), head=head, damage=damage))
            continue
        ugv = schemas.ugv_of(entry.topic)
        decoder = words if ugv is not None else decoders.get(entry.topic)
        if decoder is None or not flights:
            continue
        message = decoded(path, entry, decoder)
        if isinstance(message, Truth):
            flights[-1].truths.append(message)
        elif isinstance(message, schemas.Commands):
            flights[-1].commands[message.tick] = message
        elif isinstance(message, schemas.OperatorWord):
            flights[-1].words.append((ugv or "", message))
        elif isinstance(message, Change):
            flights[-1].changes.append(message)
        elif isinstance(message, Status):
            flights[-1].links, flights[-1].certificates = message.links, message.certificates
            flights[-1].mission = message.mission
            if message.realtime_factor > 0.0:
                flights[-1].factors.append(message.realtime_factor)
    if not flights:
        why = damage.reason
        what = f"not a recording of Outrider: no {schemas.SCENARIO.name} in it"
        if damage.reason and not seen:
            what = "nothing whole is in it"
        raise ScenarioError(f"{path}: {what}{f' ({why})' if why else ''}")
    return flights


def flight_of(path: Path, number: int | None = None) -> Recording:
    """One flight of a file: the last that has a truth, unless one is asked for.

    Args:
        path: The file.
        number: Which, from 0; negative counts from the end.

    Raises:
        ScenarioError: If the file cannot be read, or has no such flight, or no tick is in it.
    """
    flights = load(path)
    if number is None:
        flown = [flight for flight in flights if flight.truths]
        if not flown:
            raise ScenarioError(
                f"{path}: no tick in it: the run was over before it began, or the file was cut off there"
            )
        return flown[-1]
    if not -len(flights) <= number < len(flights):
        raise ScenarioError(f"{path}: flight {number}: allowed are 0 to {len(flights) - 1}")
    if not flights[number].truths:
        raise ScenarioError(f"{path}: flight {number}: no tick in it")
    return flights[number]


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
