"""Reading of a recording as a stream, up to its last complete record; the file of a killed process can be read, too."""

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
from bus.messages.buildings import Building
from bus.messages.control import Change
from bus.messages.ground import GroundMap
from bus.messages.links import LinkStatus
from bus.messages.telemetry import (
    CertificateStatus,
    CoverageMap,
    Geometry,
    MissionResult,
    Status,
    Truth,
)
from bus.plugins import needs
from outrider.recording import schemas
from sim.engine.briefing import all_buildings
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
"""Largest size of a record and of a chunk's content [bytes]: the largest ground map, twice."""
_SPARE, _RATIO = 32 << 20, 200
"""Largest unpacked size of a file: a fixed part [bytes], plus a multiple of its size.

Flights unpack to twelve times their size; a short flight over the largest area, to 140 times."""
_LEAST = 512
"""Additional size that each packed record counts [bytes], as a million empty records take time and memory, too."""
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
"""Errors that the libraries raise on damaged records."""


@dataclass(slots=True, kw_only=True)
class Damage:
    """Damage of a file: the position from which on it cannot be read."""

    end: int = 0
    """Readable bytes."""
    size: int = 0
    """Size of the file [bytes]."""
    reason: str = ""
    """Description of the damage; empty: the file is complete."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """Message of a recording."""

    topic: str
    time: int
    """Time on the file's clock [ns]."""
    data: bytes


class _Bounded(BufferedReader):
    """File with a limit on each read, as the library trusts the lengths in a record."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is None or not 0 <= size <= _MOST_BYTES:
            raise ValueError(
                f"a record with a part of {size} bytes; allowed: {_MOST_BYTES:,} at most"
            )
        return super().read(size)


def _open(path: Path) -> BufferedReader:
    try:
        return _Bounded(open_regular(path).detach())
    except (OSError, ValueError) as error:
        raise ScenarioError(
            f"{path}: {getattr(error, 'strerror', None) or error}; allowed: an MCAP file"
        ) from error


def _unpacked(chunk: records.Chunk) -> bytes:
    """Return the content of a chunk, and check its declared and its true size."""
    size, packed = chunk.uncompressed_size, BytesIO(chunk.data)
    if size > _MOST_BYTES:
        raise ValueError(f"a chunk of {size:,} bytes; allowed: {_MOST_BYTES:,} at most")
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
        raise ValueError(f"a chunk of another size than the {size:,} bytes that it declares")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("a chunk's checksum is wrong")
    return content


def stream(path: Path, damage: Damage | None = None) -> Iterator[Any]:
    """Yield every complete record of the data section as an object of the library `mcap`.

    Args:
        path: File to read.
        damage: Receives the position and the reason of a failure.

    Raises:
        ScenarioError: If the file is not an MCAP file.
    """
    damage = damage if damage is not None else Damage()
    with _open(path) as file:
        damage.size = os.fstat(file.fileno()).st_size
        damage.end = min(_MAGIC_BYTES, damage.size)
        try:
            yield from _records(file, damage)
        except InvalidMagic as error:
            raise ScenarioError(
                f"{path}: not an MCAP file; allowed: a recording made by Outrider"
            ) from error
        except _BROKEN as error:
            message = " ".join(str(error).split()) or type(error).__name__
            damage.reason = f"damaged at byte {damage.end}: {message}"
            if isinstance(error, EndOfFile | struct.error) and file.tell() == damage.size:
                within = "without a footer" if damage.end == damage.size else "within a record"
                damage.reason = f"it ends {within}"


def _records(file: BufferedReader, damage: Damage) -> Iterator[Any]:
    """Yield the records of a file and of its chunks, and store the position reached."""
    left = _SPARE + _RATIO * damage.size
    reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=_MOST_BYTES)
    for record in reader.records:
        if isinstance(record, records.DataEnd):
            damage.end = damage.size
            return
        if isinstance(record, records.Chunk):
            content = _unpacked(record)
            left -= len(content)
            # An appended end record, which a truncated record would swallow.
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
        damage.end = file.tell()


def entries(
    path: Path, topics: Collection[str] = (), damage: Damage | None = None
) -> Iterator[Entry]:
    """Yield the messages in the order in which they were written.

    Args:
        path: File to read.
        topics: Channels to read; empty: all.
        damage: Receives the position and the reason of a failure.

    Raises:
        ScenarioError: If the file is not an MCAP file made by Outrider.
    """
    names: dict[int, str] = {}
    for record in stream(path, damage):
        if isinstance(record, records.Channel):
            if record.message_encoding != "cdr":  # CDR: a channel of another program
                names[record.id] = record.topic
        elif isinstance(record, records.Message) and record.channel_id in names:
            topic = names[record.channel_id]
            if record.log_time > schemas.LATEST:
                raise out_of_range(path, topic, record.log_time)
            if not topics or topic in topics:
                yield Entry(topic=topic, time=record.log_time, data=record.data)


def out_of_range(path: Path, topic: str, time: int) -> ScenarioError:
    """Return the error for a message whose time [ns] exceeds the range."""
    return ScenarioError(
        f"{path}: {topic}: time = {time} ns: out of range; allowed up to {schemas.LATEST}"
    )


def decoded(path: Path, entry: Entry, decoder: "msgspec.json.Decoder[Sent]") -> Sent:
    """Decode the message of an entry.

    Raises:
        ScenarioError: If the message has another type.
    """
    try:
        return decoder.decode(entry.data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ScenarioError(
            f"{path}: {entry.topic} at {entry.time / 1e9:g} s: {error}; allowed: a message written by Outrider"
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
    """Yield the coverage maps of a file, read as a stream.

    Args:
        path: File to read.
        flight: Number of the flight in the file, from 0; None: all flights in order.

    Raises:
        ScenarioError: If the file cannot be read.
    """
    return _all(path, schemas.COVERAGE, CoverageMap, flight)


def grounds(path: Path, *, flight: int) -> Iterator[GroundMap]:
    """Yield the ground maps of one flight, each with the hazards; arguments as in `coverages`."""
    hazards = None
    for ground in _all(path, schemas.GROUND, GroundMap, flight):
        hazards = ground.hazards if hazards is None else hazards
        yield msgspec.structs.replace(ground, hazards=hazards)


def statuses(path: Path, *, flight: int | None = None) -> Iterator[Status]:
    """Yield the status messages; arguments as in `coverages`."""
    return _all(path, schemas.STATUS, Status, flight)


@dataclass(slots=True, kw_only=True)
class Recording:
    """Flight of a file, without its maps."""

    path: Path
    number: int
    """The flight's number in the file, from 0."""
    head: schemas.Head
    truths: list[Truth] = field(default_factory=list)
    commands: dict[int, schemas.Commands] = field(default_factory=dict)
    """Commands by tick."""
    operator_commands: list[tuple[str, schemas.OperatorCommand]] = field(default_factory=list)
    """UGV and message of each operator's command, in the order received."""
    changes: list[Change] = field(default_factory=list)
    """Operators' changes; in an observer's recording also pauses and changes of speed."""
    factors: list[float] = field(default_factory=list)
    """Real-time factors of the run's status messages."""
    links: dict[str, LinkStatus] = field(default_factory=dict)
    """Counters of each link in the last status."""
    certificates: CertificateStatus | None = None
    """Counts of certified ticks in the last status, compared with the truth; None without a safety filter."""
    mission: MissionResult | None = None
    """Mission result in the last status; None without hazards."""
    geometry: Geometry | None = None
    """Constants of the run as an observer received them; None: the simulator recorded itself."""
    damage: Damage = field(default_factory=Damage)

    @property
    def buildings(self) -> tuple[Building, ...]:
        """Buildings of the run; empty if they are unknown."""
        if self.geometry is not None:
            return self.geometry.buildings
        head = self.head
        if head.scenario is None:
            return ()
        return all_buildings(self.scenario, head.seed, head.secret)

    @property
    def last_ground(self) -> GroundMap | None:
        """Last ground map, with hazards; None without hazards."""
        found = deque(grounds(self.path, flight=self.number), maxlen=1)
        return found[0] if found else None

    @property
    def scenario(self) -> Scenario:
        """Scenario that was flown.

        Raises:
            ScenarioError: If the file does not contain the scenario, or this version cannot fly it.
        """
        return schemas.scenario_in(self.head, file=str(self.path))

    @property
    def missing_ticks(self) -> int:
        """Number of ticks between the first and the last that are not in the file."""
        if not self.truths:
            return 0
        return self.truths[-1].tick - self.truths[0].tick + 1 - len(self.truths)


def load(path: Path) -> list[Recording]:
    """Read the flights of a file.

    Raises:
        ScenarioError: If the file was not made by this version of Outrider, or contains no complete record.
    """
    damage = Damage()
    flights: list[Recording] = []
    topics = (schemas.TRUTH, schemas.COMMANDS, schemas.STATUS, schemas.CHANGES)
    decoders: dict[str, msgspec.json.Decoder[Any]] = {
        topic.name: msgspec.json.Decoder(topic.message) for topic in topics
    }
    operator_commands = msgspec.json.Decoder(schemas.OperatorCommand)
    count = 0
    for entry in entries(path, damage=damage):
        count += 1
        if entry.topic == schemas.SCENARIO.name:
            head = schemas.read_head(entry.data, file=str(path))
            flights.append(Recording(path=path, number=len(flights), head=head, damage=damage))
            continue
        ugv = schemas.ugv_of(entry.topic)
        decoder = operator_commands if ugv is not None else decoders.get(entry.topic)
        if decoder is None or not flights:
            continue
        message = decoded(path, entry, decoder)
        if isinstance(message, Truth):
            flights[-1].truths.append(message)
        elif isinstance(message, schemas.Commands):
            flights[-1].commands[message.tick] = message
        elif isinstance(message, schemas.OperatorCommand):
            flights[-1].operator_commands.append((ugv or "", message))
        elif isinstance(message, Change):
            flights[-1].changes.append(message)
        elif isinstance(message, Status):
            flights[-1].links, flights[-1].certificates = message.links, message.certificates
            flights[-1].mission = message.mission
            flights[-1].geometry = message.geometry or flights[-1].geometry
            if message.realtime_factor > 0.0:
                flights[-1].factors.append(message.realtime_factor)
    if not flights:
        why = damage.reason
        what = f"not a recording made by Outrider: no {schemas.SCENARIO.name} in it"
        if damage.reason and not count:
            what = "no complete record in it"
        raise ScenarioError(f"{path}: {what}{f' ({why})' if why else ''}")
    return flights


def flight_of(path: Path, number: int | None = None) -> Recording:
    """Read one flight of a file.

    Args:
        path: File to read.
        number: Number of the flight, from 0; negative: from the end; None: the last flight with a tick.

    Raises:
        ScenarioError: If the file cannot be read, has no such flight, or the flight has no tick.
    """
    flights = load(path)
    if number is None:
        flown = [flight for flight in flights if flight.truths]
        if not flown:
            raise ScenarioError(
                f"{path}: no tick in it: the run ended before its first tick, or the file is truncated"
            )
        return flown[-1]
    if not -len(flights) <= number < len(flights):
        raise ScenarioError(
            f"{path}: flight {number}: no such flight; allowed: 0 to {len(flights) - 1}"
        )
    if not flights[number].truths:
        raise ScenarioError(f"{path}: flight {number}: no tick in it")
    return flights[number]
