"""Reading a recording as a stream, up to its last whole record: a killed file reads like one that was closed."""

import os
import struct
import zlib
from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from bus.errors import ScenarioError
from bus.files import open_regular
from bus.messages.base import Message
from bus.messages.control import Change
from bus.messages.ground import GroundMap
from bus.messages.links import LinkStatus
from bus.messages.telemetry import CertificateStatus, CoverageMap, MissionResult, Status, Truth
from bus.plugins import needs
from outrider.recording import schemas
from sim.scenario.types import Scenario

with needs("record"):
    import lz4.frame
    import zstandard
    from mcap import records
    from mcap.exceptions import EndOfFile, InvalidMagic, McapError, UnsupportedCompressionError
    from mcap.opcode import Opcode
    from mcap.stream_reader import StreamReader

Sent = TypeVar("Sent", bound=Message)

_MAGIC_BYTES = 8
_MOST_BYTES = 16 << 20
"""Of a record and of a chunk's content: the largest map of the ground, and as much again as a viewer is shown of it."""
_SPARE, _RATIO = 32 << 20, 200
"""A whole file may unpack to so many bytes, and to so many times its size.

Flights unpack to twelve times theirs, a short one of the largest area to 140 times."""
_LEAST = 512
"""A packed record counts as so many bytes more: a million empty ones take their time and room, too."""
_DATA_END = struct.pack("<BQI", Opcode.DATA_END, 4, 0)
_KEPT = (records.Header, records.Schema, records.Channel, records.Message)
_BROKEN = (
    McapError,
    struct.error,
    ValueError,
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


class _Bounded(BufferedReader):
    """A file that gives one record at most at a time: the library trusts the lengths within a record."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is None or not 0 <= size <= _MOST_BYTES:
            raise ValueError(f"a record with a part of {size} bytes; {_MOST_BYTES:,} are the most")
        return super().read(size)


def _open(path: Path) -> BufferedReader:
    try:
        return _Bounded(open_regular(path).detach())
    except (OSError, ValueError) as error:
        raise ScenarioError(
            f"{path}: {getattr(error, 'strerror', None) or error}; allowed: an MCAP file"
        ) from error


def _unpacked(chunk: records.Chunk) -> bytes:
    """Return the content of a chunk; neither its declared nor its true size may be more than fits."""
    size, packed = chunk.uncompressed_size, BytesIO(chunk.data)
    if size > _MOST_BYTES:
        raise ValueError(f"a chunk of {size:,} bytes; {_MOST_BYTES:,} are the most")
    if chunk.compression == "zstd":
        unpacker = zstandard.ZstdDecompressor(max_window_size=_MOST_BYTES)
        content: bytes = unpacker.stream_reader(packed).read(size + 1)
    elif chunk.compression == "lz4":
        content = lz4.frame.LZ4FrameFile(packed).read(size + 1)
    elif chunk.compression == "":
        content = chunk.data
    else:
        raise UnsupportedCompressionError(repr(chunk.compression[:20]))
    if len(content) != size:
        raise ValueError(f"a chunk that does not unpack to the {size:,} bytes that it declares")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("a chunk's checksum is wrong")
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
        told.end = min(_MAGIC_BYTES, told.size)
        try:
            yield from _records(file, told)
        except InvalidMagic as error:
            raise ScenarioError(
                f"{path}: not an MCAP file; allowed: a recording of Outrider's"
            ) from error
        except _BROKEN as error:
            words = " ".join(str(error).split()) or type(error).__name__
            told.reason = f"damaged at byte {told.end}: {words}"
            if isinstance(error, EndOfFile | struct.error) and file.tell() == told.size:
                within = "without a footer" if told.end == told.size else "within a record"
                told.reason = f"it ends {within}"


def _records(file: BufferedReader, told: Damage) -> Iterator[Any]:
    """Read the records of a file, those in its chunks too, and tell how far they reach."""
    left = _SPARE + _RATIO * told.size
    reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=_MOST_BYTES)
    for record in reader.records:
        if isinstance(record, records.DataEnd):
            told.end = told.size
            return
        if isinstance(record, records.Chunk):
            content = _unpacked(record)
            left -= len(content)
            # with an end of its own, which a cut record would swallow
            packed = StreamReader(BytesIO(content + _DATA_END), skip_magic=True, emit_chunks=True)
            for part in packed.records:
                left -= _LEAST
                if left < 0:
                    raise ValueError(f"it unpacks to more than {_RATIO} times its size")
                if isinstance(part, records.DataEnd):
                    break
                if isinstance(part, _KEPT):
                    yield part
        elif isinstance(record, _KEPT):
            yield record
        told.end = file.tell()


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
