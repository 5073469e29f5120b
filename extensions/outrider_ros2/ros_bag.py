"""A flight as a rosbag2 folder: what ROS 2 nodes are told, at every tick, and beside it the recording itself.

The folder gets its name when all of it is written; until then it stands in a hidden one beside it.
"""

import errno
import math
import os
import shutil
import tempfile
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec

from bus.errors import ScenarioError
from bus.messages.base import Message
from bus.messages.telemetry import Geometry, Status
from outrider.recording.reader import Recording, decoded, entries
from outrider.recording.schemas import (
    CHANGES,
    COMMANDS,
    COVERAGE,
    GROUND,
    LATEST,
    SCENARIO,
    STATUS,
    TRUTH,
    Head,
    OperatorCommand,
    Topic,
    operator_topic,
    ugv_of,
)
from outrider_ros2.bag_records import RECORDS, RECORDS_TYPE, BagRecord
from outrider_ros2.interfaces import encode, make, require_extra, type_hash, type_store
from outrider_ros2.run_view import RunView, view_of
from outrider_ros2.topics import TOPICS, TopicRow, messages_of
from outrider_ros2.wire import Qos
from sim.scenario.types import Scenario
from sim.scene.known import geometry_of

RECORDS_QOS = Qos(depth=1000)
"""Of the records: a bag that is played and recorded again is to lose none."""
_VERSION: Literal[9] = 9
"""Of the folder's layout: that of Jazzy and later."""
_SLICE = 0.05
"""Wall time for which waiting messages are written at once [s]."""
_GAP = 1.0
"""Simulated time between the end of a flight and the next one [s], at least."""


def check_target(folder: Path) -> None:
    """Refuse a bag that cannot be written.

    Raises:
        ScenarioError: If the folder is there already, or the extra is missing.
        OSError: If the folder that it is to stand in is not there.
    """
    require_extra()
    if folder.exists() or folder.is_symlink():
        raise ScenarioError(f"{folder}: is there already; allowed: the name of a new folder")
    if not folder.absolute().parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder.parent))


def _offered(qos: Qos) -> Any:  # noqa: ANN401 - rosbags' type
    """A quality of service as a bag has it: what we leave open never runs out."""
    from rosbags import interfaces  # noqa: PLC0415 - an extra

    durability, reliability = interfaces.QosDurability, interfaces.QosReliability
    never = interfaces.QosTime(9223372036, 854775807)
    return interfaces.Qos(
        interfaces.QosHistory.KEEP_LAST,
        qos.depth,
        reliability.RELIABLE if qos.reliable else reliability.BEST_EFFORT,
        durability.TRANSIENT_LOCAL if qos.transient_local else durability.VOLATILE,
        never,
        never,
        interfaces.QosLiveliness.AUTOMATIC,
        never,
        avoid_ros_namespace_conventions=False,
    )


class RosBag:
    """A rosbag2 folder that takes a recording's messages in their order, from one thread.

    As a context it is closed at the end, and leaves nothing behind where something broke.

    Args:
        folder: The folder; it must not be there.

    Raises:
        ScenarioError: If it is there, or the extra is missing.
        OSError: If it cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        check_target(folder)
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer  # noqa: PLC0415
        from rosbags.rosbag2 import StoragePlugin as Storage  # noqa: PLC0415

        self.folder = folder
        place = folder.absolute()
        self._hidden = Path(tempfile.mkdtemp(prefix=f".{place.name}.", dir=place.parent))
        try:
            self._writer: Any = Writer(
                self._hidden / place.name, version=_VERSION, storage_plugin=Storage.MCAP
            )
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except BaseException:
            shutil.rmtree(self._hidden, ignore_errors=True)
            raise
        self._open = True
        self._connections: dict[str, Any] = {}
        self._encoder = msgspec.json.Encoder()
        self._geometry: Geometry | None = None
        self._view: RunView | None = None
        self._rows: dict[type[Message], dict[str, TopicRow]] = {}
        self._due: dict[str, int] = {}
        self._waiting: deque[tuple[Topic, Message, int]] = deque()
        self._base = self._last = 0
        self._number, self._newest_record = 0, -1
        self._private = False
        self.topics: dict[str, int] = {}
        """Messages written, by topic."""

    def __enter__(self) -> "RosBag":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    @property
    def next_start(self) -> float:
        """The place of another flight on the bag's clock [s]."""
        return self._last / 1e9 + _GAP

    def begin(self, head: Head, scenario: Scenario | None) -> None:
        """A flight begins; without its scenario all waits for a status that tells the geometry."""
        self._private = self._private or bool(head.secret)
        if scenario is not None:
            self._geometry = geometry_of(scenario)
        self._base = round(head.start * 1e9)
        self.take(SCENARIO, head, 0.0)

    def flush_if_due(self) -> None:
        """Write some of what waits: a run that is faster than this is not held up, and loses nothing."""
        self.write_waiting(_SLICE)

    def take(self, topic: Topic, message: Message, seconds: float) -> None:
        """Take a message of a recording; it waits to be written.

        Args:
            topic: The recording's channel.
            message: Of the flight that has begun.
            seconds: When, in simulated time.

        Raises:
            ScenarioError: If the time is out of range.
        """
        if isinstance(message, Status) and message.geometry is not None and self._geometry is None:
            self._geometry = message.geometry
        time_ns = self._base + round(seconds * 1e9)
        if not 0 <= time_ns <= LATEST:
            raise ScenarioError(
                f"{topic.name}: time = {time_ns / 1e9:g} s after the start of its flight: "
                f"out of range; allowed from 0 up to {LATEST / 1e9:g}"
            )
        self._last = max(self._last, time_ns)
        self._waiting.append((topic, message, time_ns))

    def write_waiting(self, patience: float = math.inf) -> None:
        """Write what waits, once the geometry is known.

        Args:
            patience: For so long [s].

        Raises:
            OSError: If it cannot be written; the bag is gone then.
        """
        end = time.monotonic() + patience
        try:
            while self._waiting and self._geometry is not None and time.monotonic() < end:
                topic, message, time_ns = self._waiting.popleft()
                if isinstance(message, Head):
                    self._look_at(view_of(message.name, self._geometry), time_ns)
                self._write(topic, message, time_ns)
        except OSError:
            self.abort()
            raise

    def _look_at(self, view: RunView, time_ns: int) -> None:
        """Declare the topics of a flight, and write what stays as it is."""
        self._view, self._rows, self._due = view, {}, {}
        for row in TOPICS:
            for _, name in row.names(view.scene):
                self._declare(name, row.interface, row.qos)
                if row.source is not None:
                    self._rows.setdefault(row.source, {})[name] = row
        self._declare(RECORDS, RECORDS_TYPE, RECORDS_QOS)
        for name, payload in messages_of(view, None):
            self._put(name, time_ns, payload)

    def _declare(self, name: str, interface: str, qos: Qos) -> None:
        if name not in self._connections:
            self.topics[name] = 0
            definition, _ = type_store().generate_msgdef(interface, ros_version=2)
            self._connections[name] = self._writer.add_connection(
                name,
                interface,
                msgdef=definition,
                rihs01=type_hash(interface),
                offered_qos_profiles=[_offered(qos)],
            )

    def _put(self, name: str, time_ns: int, payload: bytes) -> None:
        self._writer.write(self._connections[name], time_ns, payload)
        self.topics[name] += 1

    def _write(self, topic: Topic, message: Message, time_ns: int) -> None:
        self._keep(topic, message, time_ns)
        rows = self._rows.get(type(message), {})
        wanted = {name for name in rows if time_ns >= self._due.get(name, 0)}
        for name in wanted:
            if rows[name].period > 0.0:
                self._due[name] = time_ns + round(rows[name].period * 1e9)
        if rows and self._view is not None:
            for name, payload in messages_of(self._view, message, wanted=wanted):
                self._put(name, time_ns, payload)

    def _keep(self, topic: Topic, message: Message, time_ns: int) -> None:
        """Keep a message as it is: no two of them at one time, since a bag is read in the order of times."""
        record = BagRecord(
            number=self._number,
            topic=topic.name,
            time=time_ns,
            message=msgspec.Raw(self._encoder.encode(message)),
        )
        text = make(RECORDS_TYPE, data=self._encoder.encode(record).decode())
        self._newest_record = max(time_ns, self._newest_record + 1)
        self._put(RECORDS, self._newest_record, encode(RECORDS_TYPE, text))
        self._number += 1

    def close(self) -> None:
        """End the bag and give it its name; one that is gone already stays so.

        Raises:
            ScenarioError: If there is nothing to be told to ROS 2, or somebody has taken the name.
            OSError: If it does not take all there is.
        """
        if not self._open:
            return
        self.write_waiting()
        if self._view is None:
            why = "no status has told the geometry" if self._waiting else "no tick came"
            self.abort()
            raise ScenarioError(f"{self.folder}: not written: {why}")
        try:
            self._writer.close()
        except BaseException:
            self.abort()
            raise
        self._open = False
        made = self._hidden / self.folder.absolute().name
        if self._private:
            for file in made.iterdir():
                file.chmod(0o600)
            made.chmod(0o700)
        if self.folder.exists():
            raise ScenarioError(f"{self.folder}: is there by now; the bag is in {made}")
        made.rename(self.folder)
        self._hidden.rmdir()

    def abort(self) -> None:
        """Leave nothing behind but a bag that is whole."""
        if self._open:
            self._open = False
            self._writer.abort()
            shutil.rmtree(self._hidden, ignore_errors=True)


_DECODERS = {
    topic.name: (topic, msgspec.json.Decoder(topic.message))
    for topic in (TRUTH, COMMANDS, STATUS, COVERAGE, GROUND, CHANGES)
}


def copy_flight(recording: Recording, bag: RosBag) -> Iterator[float]:
    """Write a flight of a recording into a bag, from 0 s on the bag's clock.

    Args:
        recording: The flight.
        bag: Takes it.

    Yields:
        Simulated time of each message that is written [s].

    Raises:
        ScenarioError: If the file cannot be read.
        OSError: If the bag cannot be written.
    """
    start, number = round(recording.head.start * 1e9), -1
    scenario = recording.scenario if recording.head.scenario is not None else None
    words = msgspec.json.Decoder(OperatorCommand)
    for entry in entries(recording.path):
        number += entry.topic == SCENARIO.name
        if number != recording.number:
            continue
        seconds = (entry.time - start) / 1e9
        ugv = ugv_of(entry.topic)
        if entry.topic == SCENARIO.name:
            bag.begin(msgspec.structs.replace(recording.head, start=0.0), scenario)
        elif ugv is not None:
            bag.take(operator_topic(ugv), decoded(recording.path, entry, words), seconds)
        elif entry.topic in _DECODERS:
            topic, decoder = _DECODERS[entry.topic]
            bag.take(topic, decoded(recording.path, entry, decoder), seconds)
        else:
            continue  # what viewers are shown
        bag.write_waiting()
        yield seconds
