"""Export of a run as a rosbag2 folder: the ROS 2 topics at every tick, and the recording itself.

The bag is written in a hidden folder beside its target and renamed when it is complete.
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
from bus.plugins import needs
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
from outrider_ros2.interfaces import encode, make, type_hash, type_store
from outrider_ros2.run_view import RunView, view_of
from outrider_ros2.topics import TOPICS, TopicRow, messages_of
from outrider_ros2.wire import Qos
from sim.engine.briefing import all_buildings
from sim.scenario.types import Scenario
from sim.scene.known import geometry_of

with needs("ros2"):
    from rosbags import interfaces as ros_interfaces
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer
    from rosbags.rosbag2 import StoragePlugin as Storage

RECORDS_QOS = Qos(depth=1000)
"""Quality of service of the records; deep enough to lose none when a bag is played and recorded again."""
_VERSION: Literal[9] = 9
"""Version of the bag's metadata, used from Jazzy on."""
_SLICE = 0.05
"""Maximum wall time of one write of queued messages [s]."""
_GAP = 1.0
"""Minimum time between the end of a run and the start of the next one in a bag [s]."""


def check_target(folder: Path) -> None:
    """Check that a bag can be written.

    Raises:
        ScenarioError: If the folder exists already.
        OSError: If the parent folder does not exist.
    """
    if folder.exists() or folder.is_symlink():
        raise ScenarioError(f"{folder}: exists already; allowed: the name of a new folder")
    if not folder.absolute().parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder.parent))


def _offered(qos: Qos) -> Any:  # noqa: ANN401 - rosbags' type
    """Return a quality of service for a bag; unspecified durations are infinite."""
    durability, reliability = ros_interfaces.QosDurability, ros_interfaces.QosReliability
    never = ros_interfaces.QosTime(9223372036, 854775807)
    return ros_interfaces.Qos(
        ros_interfaces.QosHistory.KEEP_LAST,
        qos.depth,
        reliability.RELIABLE if qos.reliable else reliability.BEST_EFFORT,
        durability.TRANSIENT_LOCAL if qos.transient_local else durability.VOLATILE,
        never,
        never,
        ros_interfaces.QosLiveliness.AUTOMATIC,
        never,
        avoid_ros_namespace_conventions=False,
    )


class RosBag:
    """Writer of a rosbag2 folder from the messages of a recording, in order and from one thread.

    Used as a context manager, it closes the bag at the end, or removes it after an error.

    Args:
        folder: Folder to create.

    Raises:
        ScenarioError: If the folder exists already.
        OSError: If the folder cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        check_target(folder)
        self.folder = folder
        target = folder.absolute()
        self._hidden = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
        try:
            self._writer: Any = Writer(
                self._hidden / target.name, version=_VERSION, storage_plugin=Storage.MCAP
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
        self._queue: deque[tuple[Topic, Message, int]] = deque()
        self._base = self._last = 0
        self._number, self._newest_record = 0, -1
        self._private = False
        self.topics: dict[str, int] = {}
        """Number of messages written, by topic."""

    def __enter__(self) -> "RosBag":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    @property
    def next_start(self) -> float:
        """Start of another run on the bag's clock [s]."""
        return self._last / 1e9 + _GAP

    def begin(self, head: Head, scenario: Scenario | None) -> None:
        """Start a run; without its scenario, messages are queued until a status contains the geometry."""
        self._private = self._private or bool(head.secret)
        if scenario is not None:
            buildings = all_buildings(scenario, head.seed, head.secret)
            self._geometry = geometry_of(scenario, buildings)
        self._base = round(head.start * 1e9)
        self.take(SCENARIO, head, 0.0)

    def flush_if_due(self) -> None:
        """Write queued messages for a limited time: a faster run is not delayed, and no message is lost."""
        self.write_waiting(_SLICE)

    def take(self, topic: Topic, message: Message, seconds: float) -> None:
        """Queue a message of a recording.

        Args:
            topic: Channel of the recording.
            message: Message of the current run.
            seconds: Simulated time [s].

        Raises:
            ScenarioError: If the time is out of range.
        """
        if isinstance(message, Status) and message.geometry is not None and self._geometry is None:
            self._geometry = message.geometry
        time_ns = self._base + round(seconds * 1e9)
        if not 0 <= time_ns <= LATEST:
            raise ScenarioError(
                f"{topic.name}: time = {time_ns / 1e9:g} s after the start of its run: "
                f"out of range; allowed: 0 to {LATEST / 1e9:g}"
            )
        self._last = max(self._last, time_ns)
        self._queue.append((topic, message, time_ns))

    def write_waiting(self, patience: float = math.inf) -> None:
        """Write the queued messages, once the geometry is known.

        Args:
            patience: Maximum wall time [s].

        Raises:
            OSError: If the bag cannot be written; it is then removed.
        """
        end = time.monotonic() + patience
        try:
            while self._queue and self._geometry is not None and time.monotonic() < end:
                topic, message, time_ns = self._queue.popleft()
                if isinstance(message, Head):
                    self._declare_topics(view_of(message.name, self._geometry), time_ns)
                self._write(topic, message, time_ns)
        except OSError:
            self.abort()
            raise

    def _declare_topics(self, view: RunView, time_ns: int) -> None:
        """Declare the topics of a run, and write the static messages."""
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
        self._write_record(topic, message, time_ns)
        rows = self._rows.get(type(message), {})
        wanted = {name for name in rows if time_ns >= self._due.get(name, 0)}
        for name in wanted:
            if rows[name].period > 0.0:
                self._due[name] = time_ns + round(rows[name].period * 1e9)
        if rows and self._view is not None:
            for name, payload in messages_of(self._view, message, wanted=wanted):
                self._put(name, time_ns, payload)

    def _write_record(self, topic: Topic, message: Message, time_ns: int) -> None:
        """Write a record with a unique time, since bags are read in the order of times."""
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
        """Complete the bag and rename it to its target; do nothing after an abort.

        Raises:
            ScenarioError: If no message was written, or the target exists by now.
            OSError: If the bag cannot be written.
        """
        if not self._open:
            return
        self.write_waiting()
        if self._view is None:
            why = "no status contained the geometry" if self._queue else "no tick was received"
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
            raise ScenarioError(f"{self.folder}: exists by now; the bag is in {made}")
        made.rename(self.folder)
        self._hidden.rmdir()

    def abort(self) -> None:
        """Remove the bag unless it is complete."""
        if self._open:
            self._open = False
            self._writer.abort()
            shutil.rmtree(self._hidden, ignore_errors=True)


_DECODERS = {
    topic.name: (topic, msgspec.json.Decoder(topic.message))
    for topic in (TRUTH, COMMANDS, STATUS, COVERAGE, GROUND, CHANGES)
}


def copy_flight(recording: Recording, bag: RosBag) -> Iterator[float]:
    """Write a recorded run to a bag, starting at 0 s on the bag's clock.

    Args:
        recording: Run to copy.
        bag: Bag to write.

    Yields:
        Simulated time of each written message [s].

    Raises:
        ScenarioError: If the recording cannot be read.
        OSError: If the bag cannot be written.
    """
    start, number = round(recording.head.start * 1e9), -1
    scenario = recording.scenario if recording.head.scenario is not None else None
    operator_decoder = msgspec.json.Decoder(OperatorCommand)
    for entry in entries(recording.path):
        number += entry.topic == SCENARIO.name
        if number != recording.number:
            continue
        seconds = (entry.time - start) / 1e9
        ugv = ugv_of(entry.topic)
        if entry.topic == SCENARIO.name:
            bag.begin(msgspec.structs.replace(recording.head, start=0.0), scenario)
        elif ugv is not None:
            bag.take(operator_topic(ugv), decoded(recording.path, entry, operator_decoder), seconds)
        elif entry.topic in _DECODERS:
            topic, decoder = _DECODERS[entry.topic]
            bag.take(topic, decoded(recording.path, entry, decoder), seconds)
        else:
            continue  # a channel for viewers
        bag.write_waiting()
        yield seconds
