"""File of a recording.

It holds Outrider's messages as JSON, exact to the last bit, and standard channels for MCAP viewers.
"""

import logging
import math
import os
import time
from pathlib import Path

import msgspec

from bus.messages.base import Message
from bus.messages.ground import GroundMap
from bus.messages.team import Role
from bus.messages.telemetry import CoverageMap, Status, Truth
from bus.messages.vehicle import Teleoperation
from bus.plugins import needs
from outrider.recording import schemas
from outrider.recording.viewers import Viewers
from sim.engine.briefing import all_buildings
from sim.scenario.types import Scenario
from sim.scene.altitude import HIDDEN, decisive, sight_of

with needs("record"):
    import foxglove
    from foxglove.mcap import MCAPWriteOptions

FLUSH_PERIOD = 0.25
"""Wall time between two flushes [s]: together with the thread's period, a kill loses less than half a second."""
_LEVEL = 1
"""Compression level: the fastest of the library; on these messages as good as the default."""


def _number(altitude: float | None) -> float:
    return math.nan if altitude is None else altitude


class _Sink:
    """File object for foxglove-sdk.

    A failed write is stored and raised by `check`: the library would only print it, again and again.
    """

    def __init__(self, path: Path, *, private: bool) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
        if not path.exists() or path.is_file():
            # A process that has the old file open must not read the new one.
            path.unlink(missing_ok=True)
            flags |= os.O_EXCL
        opened = os.open(path, flags, 0o600 if private else 0o666)
        self._file = os.fdopen(opened, "wb", buffering=0)
        self.fault: OSError | None = None
        self._path = path

    def write(self, data: bytes | bytearray) -> int:
        view = memoryview(data)
        try:
            while view and self.fault is None:
                view = view[self._file.write(view) :]
        except OSError as error:
            self.fault = OSError(error.errno, error.strerror or str(error), str(self._path))
        return len(data)

    def check(self) -> None:
        """Raise the error of a failed write, if any."""
        if self.fault is not None:
            raise self.fault

    def flush(self) -> None:
        """Do nothing: the file is unbuffered."""

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def close(self) -> None:
        self._file.close()


class RecordingFile:
    """MCAP file, written in the order of simulated time from one thread.

    Args:
        path: File to write; an existing file is replaced.
        private: True if the file contains a secret, so that only its owner may read it.

    Raises:
        OSError: If the file cannot be written.
    """

    def __init__(self, path: Path, *, private: bool = False) -> None:
        logging.getLogger("foxglove").setLevel(logging.ERROR)
        self._sink = _Sink(path, private=private)
        self._context = foxglove.Context()
        options = MCAPWriteOptions(
            profile=schemas.PROFILE,
            disable_seeking=True,
            compression_level=_LEVEL,
            compression_threads=0,
        )
        self._writer = foxglove.open_mcap(self._sink, context=self._context, writer_options=options)
        self._own: dict[str, foxglove.Channel] = {}
        for topic in schemas.TOPICS:
            self._add(topic)
        self._viewers = Viewers(self._context)
        self._encoder = msgspec.json.Encoder()
        self._due = time.monotonic() + FLUSH_PERIOD
        self._base = self._last = 0
        self._r_v = math.inf
        self._lost: set[str] = set()
        self._roles: dict[str, Role] = {}
        self._hazards_written = False

    def _add(self, topic: schemas.Topic) -> None:
        self._own[topic.name] = foxglove.Channel(
            topic.name, schema=schemas.inlined_schema(topic.message), context=self._context
        )

    def begin(self, head: schemas.Head, scenario: Scenario | None) -> None:
        """Start a flight and write its head to the file at once."""
        self._base = round(head.start * 1e9)
        self._r_v = scenario.visibility.radius if scenario is not None else math.inf
        self._lost, self._roles = set(), {}
        self._hazards_written = False
        self._viewers.begin(scenario)
        if scenario is not None:
            self._viewers.buildings(all_buildings(scenario, head.seed, head.secret))
        self._put(schemas.SCENARIO, head, 0.0)
        self.flush()

    @property
    def next_start(self) -> float:
        """Start of another flight on the file's clock [s]."""
        return math.ceil(self._last / 1e8 + 1.0) / 10.0

    def _clock(self, seconds: float) -> int:
        time_ns = self._base + round(seconds * 1e9)
        self._last = max(self._last, time_ns)
        return time_ns

    def _put(self, topic: schemas.Topic, message: msgspec.Struct, seconds: float) -> int:
        self._sink.check()
        time_ns = self._clock(seconds)
        if topic.name not in self._own:
            self._add(topic)
        self._own[topic.name].log(self._encoder.encode(message), log_time=time_ns)
        return time_ns

    def take(self, topic: schemas.Topic, message: Message, seconds: float) -> None:
        """Write a message to its channel and to the viewers' channels; write a flight's hazards once.

        Args:
            topic: Channel of the message.
            message: Message of the current flight.
            seconds: Simulated time [s].
        """
        if isinstance(message, GroundMap) and self._hazards_written:
            message = msgspec.structs.replace(message, hazards=())
        elif isinstance(message, GroundMap):
            self._hazards_written = True
            self._viewers.hazards(message)
        time_ns = self._put(topic, message, seconds)
        if isinstance(message, Truth):
            self._show(message, time_ns)
        elif isinstance(message, CoverageMap):
            self._viewers.coverage(message, time_ns)
        elif isinstance(message, Status):
            for uav, state in schemas.team_states(message):
                self._put(schemas.team_topic(uav), state, seconds)
            if message.geometry is not None:
                self._viewers.buildings(message.geometry.buildings)

    def _show(self, truth: Truth, time_ns: int) -> None:
        """Write a tick for viewers, and log changes of role, and when a UGV is out of sight and in sight again."""
        if self._viewers.due(truth.time):
            places = {
                name: (*one.position, *one.velocity, _number(one.altitude), _number(one.heading))
                for name, one in truth.vehicles.items()
            }
            escorts = {escort.uav: escort.ugv for escort in truth.escorts}
            self._viewers.show(truth.time, places, escorts, time_ns)
        for escort in truth.escorts:
            role = None if escort.report is None else escort.report.role
            if role is not None and role is not self._roles.get(escort.uav):
                self._roles[escort.uav] = role
                self.log(f"{escort.uav}: {role.lower()}", truth.time)
        for escort in decisive(truth.escorts):
            sight, whose = sight_of(escort, self._r_v), escort.ugv if escort.teamed else escort.uav
            if sight.lost != (whose in self._lost):
                self._lost ^= {whose}
                seen = whose not in self._lost
                what = "sees {} again" if seen else "has lost sight of {}"
                behind = f", {HIDDEN}" if sight.hidden else ""
                self.log(
                    f"{escort.uav} {what.format(escort.ugv)}: {sight.distance:.3f} m{behind}",
                    truth.time,
                    warning=not seen,
                )

    def operator_command(self, ugv: str, tick: int, command: Teleoperation, seconds: float) -> None:
        """Write an operator's command that a UGV received at a tick, which started at `seconds`."""
        self._put(
            schemas.operator_topic(ugv),
            schemas.OperatorCommand(tick=tick, **msgspec.structs.asdict(command)),
            seconds,
        )

    def log(self, line: str, seconds: float, *, warning: bool = False) -> None:
        """Write a log line."""
        self._viewers.log(line, self._clock(seconds), warning=warning)

    def flush(self) -> None:
        """Write all buffered messages to the file.

        Raises:
            OSError: If a write failed.
        """
        self._writer.flush()
        self._sink.check()
        self._due = time.monotonic() + FLUSH_PERIOD

    def flush_if_due(self) -> None:
        """Flush if `FLUSH_PERIOD` has passed since the last flush."""
        if time.monotonic() >= self._due:
            self.flush()

    def close(self) -> None:
        """Complete and close the file.

        Raises:
            OSError: If a write failed.
        """
        self._writer.close()
        self._sink.close()
        self._sink.check()
