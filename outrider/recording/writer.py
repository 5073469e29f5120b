"""Writing a recording while its flight is flown, beside the tick's path.

Two kinds of channels: our own messages as JSON, exact to the last bit, and what viewers of MCAP understand at once (Foxglove,
Lichtblick): frames, poses, a scene, the grid, a log. A tick costs its loop one append; a thread turns it into messages.
"""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from bus import keys
from bus.errors import ScenarioError
from bus.messages import CoverageMap, EscortTruth, Status, Truth, UavReport, VehicleStatus, VehicleTruth
from bus.session import Session
from outrider import style
from outrider.recording.schemas import (
    COMMANDS,
    COVERAGE,
    EXTRA,
    PROFILE,
    SCENARIO,
    STATUS,
    TOPICS,
    TRUTH,
    Commands,
    Head,
    head_of,
    inlined_schema,
    inner_radius,
    unknown_head,
)
from sim.compile import FloatArray
from sim.flight import Flight
from sim.scenario import Scenario
from sim.world import World

try:  # an extra
    import foxglove
    from foxglove import channels, messages
    from foxglove.mcap import MCAPWriteOptions
except ImportError as absent:
    raise ScenarioError(EXTRA) from absent

FLUSH_PERIOD = 0.25
"""Wall time between two flushes [s]: with the thread's own period, what a kill can cost stays under half a second."""
_WAKE = 0.02
"""Wall time between two looks of the thread [s]."""
_SLICE = 64
"""The thread lets the flight have the interpreter after each message, or one more for as many as this that wait: a flight that
comes back from the bus must not find it taken for long."""
_ROOM = 1024
"""Ticks that wait for the thread before the flight must."""
_MAP_PERIOD = 1.0
"""Simulated time between two maps [s], for a grid of up to `_MAP_CELLS`; larger ones come less often."""
_MAP_CELLS = 50_000
_STATUS_PERIOD = 0.5
"""Simulated time between two status messages of a recorder in the simulator [s], at least; wall time, a tenth of it."""
_VIEW_PERIOD = 0.1
"""Simulated time between two poses for viewers [s], at least."""
_SCENE_PERIOD = 1.0
"""Simulated time between two scenes [s]; each holds everything, since a viewer that jumps sees only the newest."""
_TRACK_ROOM = 300
"""Points of a track; beyond that every second one is dropped."""
_UAV_HEIGHT, _UGV_HEIGHT = 1.0, 0.1
"""Where viewers show them [m]; the world itself is flat."""

_INBOX_ROOM = 4096
"""Truths that wait for us before the oldest are lost: two seconds of a fast run."""
_LAST_WORDS = 0.6
"""How long after the run's last word something may still come [s]; a run that is reset goes on."""
_AT_ONCE = 256
"""Truths that are taken before the caller is shown how it stands."""


class _Sink:
    """The file as foxglove-sdk writes to it. A write that fails is kept for us to raise: the library would print it, for ever."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
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

    def flush(self) -> None:
        """Nothing waits here."""

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def close(self) -> None:
        self._file.close()


def _color(code: str, opacity: float = 1.0) -> messages.Color:
    r, g, b = (int(code[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    return messages.Color(r=r, g=g, b=b, a=opacity)


def _stamp(time_ns: int) -> messages.Timestamp:
    return messages.Timestamp(sec=time_ns // 1_000_000_000, nsec=time_ns % 1_000_000_000)


def _ring(radius: float, color: messages.Color, *, dashed: bool = False, thickness: float = 0.06) -> messages.LinePrimitive:
    """A circle around a vehicle, in its own frame."""
    angles = [2.0 * math.pi * k / 96 for k in range(96)]
    return messages.LinePrimitive(
        type=messages.LinePrimitiveLineType.LineList if dashed else messages.LinePrimitiveLineType.LineLoop,
        thickness=thickness,
        points=[messages.Point3(x=radius * math.cos(angle), y=radius * math.sin(angle)) for angle in angles],
        color=color,
    )


class _Viewers:
    """The channels for viewers of one file."""

    def __init__(self, context: foxglove.Context) -> None:
        self._context = context
        self._tf = channels.FrameTransformsChannel("/tf", context=context)
        self._scene = channels.SceneUpdateChannel("/scene", context=context)
        self._grid = channels.GridChannel("/grid", context=context)
        self._log = channels.LogChannel("/log", context=context)
        self._poses: dict[str, channels.PoseInFrameChannel] = {}
        self._scenario: Scenario | None = None
        self.begin(None)

    def begin(self, scenario: Scenario | None) -> None:
        """Another flight begins."""
        self._scenario = scenario
        self._tracks: dict[str, list[messages.Point3]] = {}
        self._sparse: dict[str, int] = {}  # every so manieth point is kept
        self._passed: dict[str, int] = {}
        self._yaw: dict[str, float] = {}
        self._still: list[messages.SceneEntity] | None = None
        self._next_view = self._next_scene = -math.inf

    def _entities(self, truth: Truth) -> list[messages.SceneEntity]:
        """Vehicles and circles: each hangs on its vehicle's frame, so they are made once."""
        escorted = {escort.uav: escort.ugv for escort in truth.escorts}
        uavs, ugvs = sorted(escorted), sorted(set(truth.vehicles) - set(escorted))
        found = []
        for k, name in enumerate(ugvs):
            body = messages.CubePrimitive(size=messages.Vector3(x=0.7, y=0.45, z=0.3), color=_color(style.color(style.UGV, k)))
            lines = self._sight(name) if name in escorted.values() else []
            found.append(messages.SceneEntity(frame_id=name, id=name, frame_locked=True, cubes=[body], lines=lines))
        for k, name in enumerate(uavs):
            color = _color(style.color(style.UAV, k))
            body_ = messages.CylinderPrimitive(
                size=messages.Vector3(x=0.6, y=0.6, z=0.12), bottom_scale=1.0, top_scale=1.0, color=color
            )
            nose = messages.ArrowPrimitive(
                shaft_length=0.4, shaft_diameter=0.06, head_length=0.15, head_diameter=0.15, color=color
            )
            reach = [_ring(self._scenario.sensor.range, color, thickness=0.03)] if self._scenario else []
            found.append(
                messages.SceneEntity(frame_id=name, id=name, frame_locked=True, cylinders=[body_], arrows=[nose], lines=reach)
            )
        return found

    def _sight(self, ugv: str) -> list[messages.LinePrimitive]:
        """r_v, and r_s where it is a circle of its own."""
        if self._scenario is None:
            return []
        r_v, red = self._scenario.visibility.radius, _color(style.LIMIT)
        lines = [_ring(r_v, red)]
        r_s = inner_radius(self._scenario, ugv)
        return [*lines, _ring(r_s, red, dashed=True, thickness=0.04)] if r_s is not None else lines

    def truth(self, truth: Truth, time_ns: int) -> None:
        """Where everybody is."""
        if truth.time < self._next_view:
            return
        self._next_view = truth.time + _VIEW_PERIOD * (1.0 - 1e-6)
        stamp, transforms = _stamp(time_ns), []
        uavs = {escort.uav for escort in truth.escorts}
        for name, vehicle in truth.vehicles.items():
            (x, y), (v_x, v_y) = vehicle.position, vehicle.velocity
            if v_x * v_x + v_y * v_y > 1e-6:
                self._yaw[name] = math.atan2(v_y, v_x)
            half = 0.5 * self._yaw.get(name, 0.0)
            turn = messages.Quaternion(z=math.sin(half), w=math.cos(half))
            place = messages.Vector3(x=x, y=y, z=_UAV_HEIGHT if name in uavs else _UGV_HEIGHT)
            transforms.append(
                messages.FrameTransform(
                    timestamp=stamp, parent_frame_id="world", child_frame_id=name, translation=place, rotation=turn
                )
            )
            if name not in self._poses:
                self._poses[name] = channels.PoseInFrameChannel(f"/pose/{name}", context=self._context)
            pose = messages.Pose(position=place, orientation=turn)
            self._poses[name].log(messages.PoseInFrame(timestamp=stamp, frame_id="world", pose=pose), log_time=time_ns)
            self._follow(name, messages.Point3(x=x, y=y, z=0.02))
        self._tf.log(messages.FrameTransforms(transforms=transforms), log_time=time_ns)
        if truth.time >= self._next_scene:
            self._next_scene = truth.time + _SCENE_PERIOD * (1.0 - 1e-6)
            self._draw(truth, stamp, time_ns)

    def _follow(self, name: str, point: messages.Point3) -> None:
        track, step = self._tracks.setdefault(name, []), self._sparse.get(name, 1)
        self._passed[name] = passed = self._passed.get(name, -1) + 1
        if passed % step == 0:
            track.append(point)
        if len(track) > _TRACK_ROOM:
            del track[1::2]
            self._sparse[name] = 2 * step

    def _draw(self, truth: Truth, stamp: messages.Timestamp, time_ns: int) -> None:
        if self._still is None:
            self._still = self._entities(truth)
        uavs = [escort.uav for escort in truth.escorts]
        ugvs = [name for name in truth.vehicles if name not in uavs]
        tracks = []
        for name in truth.vehicles:
            code = style.color(style.UAV, uavs.index(name)) if name in uavs else style.color(style.UGV, ugvs.index(name))
            line = messages.LinePrimitive(
                type=messages.LinePrimitiveLineType.LineStrip, thickness=0.05, points=self._tracks[name], color=_color(code, 0.8)
            )
            tracks.append(messages.SceneEntity(timestamp=stamp, frame_id="world", id=f"{name} track", lines=[line]))
        self._scene.log(messages.SceneUpdate(entities=[*self._still, *tracks]), log_time=time_ns)

    def coverage(self, ground: CoverageMap, time_ns: int) -> None:
        """What was seen of the ground."""
        pose = messages.Pose(position=messages.Vector3(z=-0.01), orientation=messages.Quaternion(w=1.0))
        share = messages.PackedElementField(name="coverage", type=messages.PackedElementFieldNumericType.Uint8)
        grid = messages.Grid(
            timestamp=_stamp(time_ns),
            frame_id="world",
            pose=pose,
            column_count=ground.columns,
            cell_size=messages.Vector2(x=ground.cell, y=ground.cell),
            row_stride=ground.columns,
            cell_stride=1,
            fields=[share],
            data=ground.cells,
        )
        self._grid.log(grid, log_time=time_ns)

    def log(self, line: str, time_ns: int, *, warning: bool) -> None:
        """A line for a person."""
        level = messages.LogLevel.Warning if warning else messages.LogLevel.Info
        self._log.log(messages.Log(timestamp=_stamp(time_ns), level=level, message=line, name="outrider"), log_time=time_ns)


class RecordingFile:
    """An MCAP file that takes messages in the order of simulated time, from one thread.

    Args:
        path: The file; one that is there is replaced.

    Raises:
        OSError: If it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        logging.getLogger("foxglove").setLevel(logging.ERROR)
        self._sink = _Sink(path)
        context = foxglove.Context()
        options = MCAPWriteOptions(profile=PROFILE, disable_seeking=True, compression_threads=0)
        self._writer = foxglove.open_mcap(self._sink, context=context, writer_options=options)
        self._own = {
            topic.name: foxglove.Channel(topic.name, schema=inlined_schema(topic.message), context=context) for topic in TOPICS
        }
        self._viewers = _Viewers(context)
        self._encoder = msgspec.json.Encoder()
        self._due = time.monotonic() + FLUSH_PERIOD
        self._base = self._last = 0
        self._r_v = math.inf
        self._lost: set[str] = set()

    def begin(self, head: Head, scenario: Scenario | None) -> None:
        """A flight begins; it is in the file at once."""
        self._base = round(head.start * 1e9)
        self._r_v = scenario.visibility.radius if scenario is not None else math.inf
        self._lost = set()
        self._viewers.begin(scenario)
        self._put(SCENARIO.name, head, 0.0)
        self.flush()

    @property
    def next_start(self) -> float:
        """Where another flight would begin on the file's clock [s]."""
        return math.ceil(self._last / 1e8 + 1.0) / 10.0

    def _clock(self, seconds: float) -> int:
        self._last = max(self._last, self._base + round(seconds * 1e9))
        return self._base + round(seconds * 1e9)

    def _put(self, topic: str, message: msgspec.Struct, seconds: float) -> int:
        if self._sink.fault is not None:
            raise self._sink.fault
        time_ns = self._clock(seconds)
        self._own[topic].log(self._encoder.encode(message), log_time=time_ns)
        return time_ns

    def truth(self, truth: Truth) -> None:
        """Take down a tick, for everybody."""
        time_ns = self._put(TRUTH.name, truth, truth.time)
        self._viewers.truth(truth, time_ns)
        for escort in truth.escorts:
            if (escort.distance >= self._r_v) != (escort.uav in self._lost):
                self._lost ^= {escort.uav}
                seen = escort.uav not in self._lost
                what = "sees {} again" if seen else "has lost sight of {}"
                self.log(f"{escort.uav} {what.format(escort.ugv)}: {escort.distance:.3f} m", truth.time, warning=not seen)

    def commands(self, commands: Commands, seconds: float) -> None:
        """Take down what was asked for during a tick that began at `seconds`."""
        self._put(COMMANDS.name, commands, seconds)

    def status(self, status: Status) -> None:
        """Take down how the run stands."""
        self._put(STATUS.name, status, status.time)

    def coverage(self, ground: CoverageMap, seconds: float) -> None:
        """Take down the ground at `seconds`."""
        self._viewers.coverage(ground, self._put(COVERAGE.name, ground, seconds))

    def log(self, line: str, seconds: float, *, warning: bool = False) -> None:
        """Take down a line for a person."""
        self._viewers.log(line, self._clock(seconds), warning=warning)

    def flush(self) -> None:
        """Let the file hold all there is.

        Raises:
            OSError: If it does not take it.
        """
        self._writer.flush()
        if self._sink.fault is not None:
            raise self._sink.fault
        self._due = time.monotonic() + FLUSH_PERIOD

    def flush_if_due(self) -> None:
        """Flush, if the last time was long ago."""
        if time.monotonic() >= self._due:
            self.flush()

    def close(self) -> None:
        """End the file as MCAP wants it.

        Raises:
            OSError: If it does not take all there is.
        """
        self._writer.close()
        self._sink.close()
        if self._sink.fault is not None:
            raise self._sink.fault


@dataclass(slots=True, kw_only=True)  # not frozen: that doubles the time to make one, which the tick pays
class _Item:
    """Something for the thread: a tick that was flown, with what the flight's own record does not keep; or one of the others."""

    flight: Flight
    tick: int
    commands: list[list[float]] | None = None
    reports: tuple[UavReport | None, ...] = ()
    coverage: CoverageMap | None = None
    status: Status | None = None
    line: str = ""


class FlightRecorder:
    """Records flights from inside the simulator's process: every tick, bit by bit.

    Args:
        path: The file; one that is there is replaced.
        scenario: What is flown.
        seed: Of all random numbers.
        vehicles: Tells how the vehicles' processes stand; without it only what the flight itself counts.

    Raises:
        OSError: If the file cannot be written.
    """

    def __init__(
        self, path: Path, scenario: Scenario, seed: int, *, vehicles: Callable[[], Mapping[str, VehicleStatus]] | None = None
    ) -> None:
        self._vehicles = vehicles
        self._file = RecordingFile(path)
        self._items: deque[_Item] = deque()
        self._done = threading.Event()
        self._fault: Exception | None = None
        self._flight: Flight | None = None  # the one that the flight's thread is at; _written is the writer's
        self._written: Flight | None = None
        self._early: list[str] = []
        self._next_map = self._next_status = 0
        self._pace = (time.monotonic(), 0)
        self._scratch: FloatArray = np.empty((0, 0))
        self._file.begin(head_of(scenario, seed), scenario)
        self._head = (scenario, seed, 0)
        self._thread = threading.Thread(target=self._run, name="outrider-recorder", daemon=True)
        self._thread.start()

    def tick(self, flight: Flight) -> None:
        """Take down the tick that has just been flown; called after each, from the flight's own thread.

        Waits only where the disk is slower than the flight for long: nothing is dropped. After a fault of the disk it does
        nothing; `close` tells.

        Args:
            flight: Another one than before begins a new flight in the file.
        """
        if self._fault is not None:
            return
        tick = flight.world.tick
        if flight is not self._flight:
            self._flight, self._next_map, self._next_status = flight, 0, 0
            self._pace = (time.monotonic(), 0)
        self._items.append(_Item(flight=flight, tick=tick, commands=flight.commands.tolist(), reports=tuple(flight.reports)))
        while self._early:
            self.event(self._early.pop(0))
        if tick >= self._next_map or flight.over:
            cells = flight.world.coverage.size
            self._next_map = tick + max(1, round(max(_MAP_PERIOD, _MAP_PERIOD * cells / _MAP_CELLS) / flight.scenario.dt))
            self._items.append(_Item(flight=flight, tick=tick, coverage=self._map_of(flight.world, flight.scenario)))
        if tick >= self._next_status or flight.over:
            self._next_status = tick + max(1, round(_STATUS_PERIOD / flight.scenario.dt))
            if time.monotonic() - self._pace[0] > 0.1 * _STATUS_PERIOD or flight.over:
                self._items.append(_Item(flight=flight, tick=tick, status=self._status(flight)))
        while len(self._items) > _ROOM and self._fault is None:
            time.sleep(0.001)

    def event(self, line: str, tick: int = 0) -> None:
        """Take down a line for a person, at the tick where the flight is now or at a later one."""
        if self._flight is None:
            self._early.append(line)  # vehicles join before anything is flown
        else:
            self._items.append(_Item(flight=self._flight, tick=max(tick, self._flight.world.tick), line=line))

    def _map_of(self, world: World, scenario: Scenario) -> CoverageMap:
        if self._scratch.shape != world.coverage.shape:
            self._scratch = np.empty_like(world.coverage)
        return _map_of(world, scenario, self._scratch)

    def _status(self, flight: Flight) -> Status:
        now, (before, tick) = time.monotonic(), self._pace
        self._pace = (now, flight.world.tick)
        vehicles = self._vehicles() if self._vehicles is not None else {}
        counted = {
            name: VehicleStatus(present=True, missing_commands=flight.missing[name], stale_commands=flight.stale[name])
            for name in flight.world.names
        }
        return Status(
            scenario=flight.scenario.name,
            seed=flight.seed,
            tick=flight.world.tick,
            ticks=flight.scenario.ticks,
            time=flight.world.time,
            realtime_factor=max(0, flight.world.tick - tick) * flight.scenario.dt / max(now - before, 1e-6),
            law=flight.law.name,
            drivers=dict(flight.drivers),
            vehicles={**counted, **vehicles},
            over=flight.over,
        )

    def close(self) -> None:
        """Write what is left and end the file; called once, when the flight is over or has failed.

        Raises:
            OSError: If not all could be written.
        """
        flight = self._flight
        if flight is not None and self._fault is None:
            self._items.append(_Item(flight=flight, tick=flight.world.tick, status=self._status(flight)))
            why = "complete" if flight.complete else "cut short"
            self._items.append(_Item(flight=flight, tick=flight.world.tick, line=f"the flight is over: {why}"))
        self._done.set()
        self._thread.join()
        try:
            self._file.close()
        except (OSError, RuntimeError) as error:
            self._fault = self._fault or error
        if isinstance(self._fault, OSError):
            raise self._fault
        if self._fault is not None:
            raise OSError(f"the recording is incomplete: {self._fault}") from self._fault

    def _run(self) -> None:
        try:
            last = False
            while not last:
                last = self._done.wait(_WAKE)
                while self._write_slice(last=last):
                    self._file.flush_if_due()
                    time.sleep(0.0 if last else 2e-5)
                self._file.flush_if_due()
        except Exception as error:  # noqa: BLE001 - whatever it is, the flight goes on and `close` tells
            self._fault = error
            self._items.clear()

    def _write_slice(self, *, last: bool) -> bool:
        """Write some of what waits; whether more of it can be written now."""
        for _ in range(1 + len(self._items) // _SLICE):
            if not self._items:
                return False
            item = self._items[0]
            if item.tick >= item.flight.recorder.rows:  # its state is taken down a moment after it is flown
                if not last and item.flight is self._flight:
                    return False
                self._items.popleft()  # it never was: something broke that tick
                continue
            self._write(self._items.popleft())
        return True

    def _write(self, item: _Item) -> None:
        flight, dt = item.flight, item.flight.scenario.dt
        if flight is not self._written:
            self._begin(flight, item.tick)
        if item.commands is not None:
            asked = dict(zip(flight.world.names, map(_vector, item.commands), strict=True))
            self._file.commands(Commands(tick=item.tick - 1, accelerations=asked), (item.tick - 1) * dt)
            self._file.truth(_truth_in(flight, item.tick, item.commands, item.reports))
        if item.coverage is not None:
            self._file.coverage(item.coverage, item.tick * dt)
        if item.status is not None:
            self._file.status(item.status)
        if item.line:
            self._file.log(item.line, item.tick * dt)

    def _begin(self, flight: Flight, tick: int) -> None:
        self._written = flight
        if (flight.scenario, flight.seed, flight.episode) != self._head:
            self._head = (flight.scenario, flight.seed, flight.episode)
            head = head_of(flight.scenario, flight.seed, episode=flight.episode, start=self._file.next_start)
            self._file.begin(head, flight.scenario)
        still = [[0.0, 0.0] for _ in flight.world.names]
        self._file.truth(_truth_in(flight, tick - 1, still, (None,) * len(flight.world.uavs)))
        if tick == 1:
            before = World(flight.scenario, flight.seed)  # the ground as it was before anybody moved
            self._file.coverage(_map_of(before, flight.scenario, np.empty_like(before.coverage)), 0.0)


def _vector(pair: list[float]) -> tuple[float, float]:
    return pair[0], pair[1]


def _truth_in(flight: Flight, tick: int, commands: list[list[float]], reports: tuple[UavReport | None, ...]) -> Truth:
    """The Truth of a tick that is in the flight's record, without measuring it again."""
    recorder, names, escorted = flight.recorder, flight.world.names, flight.world.uavs
    states = recorder.states[tick].tolist()
    applied = recorder.states[tick - 1, :, 4:6].tolist() if tick else [[0.0, 0.0]] * len(names)
    vehicles = {
        name: VehicleTruth(
            position=(row[0], row[1]), velocity=(row[2], row[3]), acceleration=_vector(acceleration), command=_vector(command)
        )
        for name, row, acceleration, command in zip(names, states, applied, commands, strict=True)
    }
    escorts = tuple(
        EscortTruth(
            uav=uav.name,
            ugv=uav.escorts,
            distance=row[0],
            coverage_error=max(0.0, row[1]),
            detection=(row[2], row[3]) if row[2] == row[2] else None,
            report=report,
        )
        for uav, row, report in zip(escorted, recorder.escorts[tick].tolist(), reports, strict=True)
    )
    return Truth(tick=tick, time=tick * flight.scenario.dt, vehicles=vehicles, escorts=escorts)


def _map_of(world: World, scenario: Scenario, scratch: FloatArray) -> CoverageMap:
    """The ground as bytes.

    Args:
        world: Of which.
        scenario: Of which.
        scratch: As large as the ground; a new array of that size for each map costs more than the sums in it.
    """
    rows, columns = scratch.shape
    np.multiply(world.coverage, 255.0 / scenario.coverage.desired, out=scratch)
    np.minimum(scratch, 255.0, out=scratch)
    cells = scratch.astype(np.uint8).tobytes()
    return CoverageMap(tick=world.tick, rows=rows, columns=columns, cell=scenario.area.cell, cells=cells)


class RunRecorder:
    """Records a run in progress: an observer who writes down what the simulator tells.

    Args:
        session: An observer's.
        path: The file; one that is there is replaced.
        scenario: What is flown, if that is known.

    Raises:
        OSError: If the file cannot be written.
    """

    def __init__(self, session: Session, path: Path, scenario: Scenario | None) -> None:
        self._file = RecordingFile(path)
        self._scenario = scenario
        self._truths = session.inbox(keys.TRUTH, newest=_INBOX_ROOM)
        self._maps = session.inbox(keys.COVERAGE, newest=64)
        self._statuses = session.inbox(keys.STATUS, newest=64)
        self._status: Status | None = None
        self._map: CoverageMap | None = None  # waits for its tick's truth
        self._over_since: float | None = None
        self._busy = False
        self._episode = -1
        self.ticks = 0
        """Truths that were taken down."""
        self.missing_ticks = 0
        """Ticks between the first and the newest that never came."""
        self.first_tick = 0
        """Of the first flight."""
        self.newest_tick = -1
        self.newest_time = 0.0
        """[s]"""

    @property
    def ticks_of_run(self) -> int | None:
        """How many it will have; None: not known yet."""
        return self._status.ticks if self._status is not None else None

    @property
    def over(self) -> bool:
        """Whether the run is."""
        return not self._busy and self._over_since is not None and time.monotonic() - self._over_since > _LAST_WORDS

    def take(self, patience: float) -> None:
        """Take down what has come, and wait for up to `patience` [s] where nothing has."""
        letter = self._truths.receive(patience)
        self._take_others()
        self._busy = letter is not None
        taken = 0
        while letter is not None:
            if isinstance(letter.message, Truth):
                self._take_truth(letter.message)
                taken += 1
            letter = self._truths.next_waiting() if taken < _AT_ONCE else None
        self._file.flush_if_due()

    def _take_others(self) -> None:
        while (letter := self._statuses.next_waiting()) is not None:
            if isinstance(letter.message, Status):
                self._status = letter.message
                if self._episode >= 0:
                    self._file.status(letter.message)
                over = letter.message.over
                self._over_since = (self._over_since or time.monotonic()) if over else None
        while (letter := self._maps.next_waiting()) is not None:
            if isinstance(letter.message, CoverageMap):
                self._map = letter.message
        self._put_map()

    def _put_map(self) -> None:
        if self._map is not None and self.newest_tick >= self._map.tick > 0:
            self._file.coverage(self._map, self.newest_time * self._map.tick / self.newest_tick)
            self._map = None

    def _take_truth(self, truth: Truth) -> None:
        if self._episode < 0 or truth.tick < self.newest_tick:
            self._begin(truth)
        elif truth.tick == self.newest_tick:
            return  # a clock that stands still tells it again
        else:
            self.missing_ticks += truth.tick - self.newest_tick - 1
            if truth.tick == self.newest_tick + 1:
                asked = {name: vehicle.command for name, vehicle in truth.vehicles.items()}
                self._file.commands(Commands(tick=self.newest_tick, accelerations=asked), self.newest_time)
        self.ticks += 1
        self.newest_tick, self.newest_time = truth.tick, truth.time
        self._file.truth(truth)
        self._put_map()

    def _begin(self, truth: Truth) -> None:
        self._episode += 1
        if self._episode == 0:
            self.first_tick = truth.tick
        start = self._file.next_start if self._episode else 0.0
        status = self._status
        seed = status.seed if status is not None else 0
        if self._scenario is not None:
            self._file.begin(head_of(self._scenario, seed, episode=self._episode, start=start), self._scenario)
        else:
            self._file.begin(unknown_head(status.scenario if status else "", seed, episode=self._episode, start=start), None)

    def counts(self) -> dict[str, object]:
        """What has come, in numbers."""
        return {
            "ticks": self.ticks,
            "missing_ticks": self.missing_ticks,
            "first_tick": self.first_tick,
            "last_tick": self.newest_tick,
            "flights": self._episode + 1,
        }

    def story(self) -> str:
        """The same in words."""
        if not self.ticks:
            return "no tick came"
        late = f", recorded from tick {self.first_tick} on" if self.first_tick else ""
        return f"{self.ticks} ticks up to {self.newest_time:.2f} s, {self.missing_ticks} missing between them{late}"

    def close(self) -> None:
        """End the file.

        Raises:
            OSError: If not all could be written.
        """
        self._file.close()
