"""Encoding of many ticks at once: the same JSON as their `Truth` and `Commands`, without making these messages.

A recording holds every tick, and making the messages costs more than writing them. Only numbers change from tick to
tick. All numbers are encoded in one call, and inserted into the text of a sample message.
"""

from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import NamedTuple

import msgspec
import numpy as np

from bus.messages.base import Vector
from bus.messages.decision import NotCertified
from bus.messages.telemetry import EscortTruth, Truth, VehicleTruth
from bus.messages.vehicle import UavReport
from outrider.recording.schemas import Commands
from sim.compiling.compile import FloatArray
from sim.server.flight import Flight

Reports = Sequence[tuple[UavReport | None, NotCertified | None]]
"""`report` and `revoked` of each `EscortTruth`."""

_VERTICAL = ("altitude", "climb_rate", "vertical_acceleration")
_TICK, _MARK = 700_000, 700_001
"""Placeholders in a sample: of the tick, and the first of its numbers."""


class Tick(NamedTuple):
    """Encoded tick."""

    time: float
    """Simulated time [s]."""
    previous_time: float
    """Simulated time of the previous tick [s]."""
    truth: bytes
    commands: bytes
    """Commands of the previous tick; empty: none."""
    distances: list[float]
    """Distance of each escort [m]."""
    radii: list[float] | None
    """Distance within which each UAV sees its UGV [m], 0 while a building hides it; None: r_v."""
    states: FloatArray
    """Position, velocity and altitude of each vehicle, shape (vehicles, 5); NaN: no altitude."""


class TickTexts:
    """Encoder of the ticks of one flight.

    Args:
        flight: Flight with its record.
    """

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        self._encoder = msgspec.json.Encoder()
        self._marks = _MARK
        self._climbs = flight.scenario.has_altitude
        # Numbers of a vehicle and of an escort; the last of an escort is a gap for its report.
        self._of_vehicle, self._of_escort = (11, 6) if self._climbs else (8, 5)
        time = self._number()
        vehicles = {
            name: VehicleTruth(
                position=self._pair(),
                velocity=self._pair(),
                acceleration=self._pair(),
                command=self._pair(),
                **self._numbers_of(*_VERTICAL),
            )
            for name in flight.world.names
        }
        self._escorts = self._marks - _MARK
        """Number of values before the escorts' values."""
        escorts = tuple(
            EscortTruth(
                uav=uav.name,
                ugv=uav.escorts,
                distance=self._number(),
                sight_radius=self._number() if self._climbs else None,
                coverage_error=self._number(),
                detection=self._pair(),
                report=None,
            )
            for uav in flight.world.uavs
        )
        asked = {name: vehicle.command for name, vehicle in vehicles.items()}
        uavs = [uav.name for uav in flight.world.uavs if self._climbs]
        climbs = {name: vehicles[name].vertical_acceleration for name in uavs}
        numbers = [number for pair in asked.values() for number in pair] + list(climbs.values())
        self._asked = itemgetter(*(round(number) - _MARK for number in numbers))
        self._truth = self._template(
            Truth(tick=_TICK, time=time, vehicles=vehicles, escorts=escorts)
        )
        self._commands = self._template(Commands(tick=_TICK, accelerations=asked, vertical=climbs))

    def _number(self) -> float:
        self._marks += 1
        return float(self._marks - 1)

    def _numbers_of(self, *fields: str) -> dict[str, float]:
        """Return placeholders of fields that only a flight with altitudes has."""
        return {name: self._number() for name in fields if self._climbs}

    def _pair(self) -> Vector:
        return self._number(), self._number()

    def _template(self, sample: msgspec.Struct) -> bytes:
        """Return the sample's text with gaps for the tick, the numbers and the reports."""
        text = self._encoder.encode(sample)
        for number in range(_MARK, self._marks):
            text = text.replace(b"%d.0" % number, b"%b")
        return text.replace(b'"tick":%d' % _TICK, b'"tick":%d').replace(
            b'"report":null,"revoked":null', b'"report":%b'
        )

    def _numbers(self, first: int, commands: FloatArray) -> FloatArray:
        """Return the numbers of the texts in order, one row per tick; NaN is written as null."""
        recorder, (count, vehicles, _) = self._flight.recorder, commands.shape
        numbers: FloatArray = np.full(
            (count, self._escorts + self._of_escort * len(self._flight.world.uavs)), np.nan
        )
        numbers[:, 0] = np.arange(first, first + count) * self._flight.scenario.dt
        moving = numbers[:, 1 : self._escorts].reshape(count, vehicles, self._of_vehicle)
        moving[:, :, :4] = recorder.states[first : first + count, :, :4]
        if first:
            moving[:, :, 4:6] = recorder.states[first - 1 : first + count - 1, :, 4:6]
        else:
            moving[0, :, 4:6], moving[1:, :, 4:6] = 0.0, recorder.states[: count - 1, :, 4:6]
        moving[:, :, 6:8] = commands
        escorts = numbers[:, self._escorts :].reshape(count, -1, self._of_escort)
        escorts[:, :, 0] = recorder.escorts[first : first + count, :, 0]
        escorts[:, :, -4:-1] = recorder.escorts[first : first + count, :, 1:4]
        escorts[:, :, -4] = np.where(escorts[:, :, -4] > 0.0, escorts[:, :, -4], 0.0)
        if self._climbs:
            self._fill_heights(first, moving, escorts)
        return numbers

    def _fill_heights(self, first: int, moving: FloatArray, escorts: FloatArray) -> None:
        """Fill in the numbers of the vertical motion."""
        recorder, uavs = self._flight.recorder, self._flight.world.escorts[:, 0]
        heights = recorder.heights[first : first + len(moving)]
        moving[:, :, 9:] = 0.0  # of a UGV, whose altitude is null
        moving[:, uavs, 8:10] = heights[:, :, :2]
        before = max(first - 1, 0)
        applied = recorder.heights[before : first + len(moving) - 1, :, 2]
        moving[len(moving) - len(applied) :, uavs, 10] = applied
        escorts[:, :, 1] = heights[:, :, 3]

    def of(self, first: int, commands: FloatArray, reports: Sequence[Reports]) -> Iterator[Tick]:
        """Yield consecutive ticks of the flight's record.

        Args:
            first: First tick.
            commands: Commands of the tick before each, shape (ticks, vehicles, 2) [m/s²].
            reports: Reports of the UAVs at each tick.
        """
        numbers, dt, at = self._numbers(first, commands), self._flight.scenario.dt, self._escorts
        width, encode, step = numbers.shape[1], self._encoder.encode, self._of_escort
        texts = encode(numbers.ravel().tolist())[1:-1].split(b",")
        moving = numbers[:, 1:at].reshape(*commands.shape[:2], -1)
        states = np.full((*commands.shape[:2], 5), np.nan)
        states[:, :, :4] = moving[:, :, :4]
        if self._climbs:
            states[:, :, 4] = moving[:, :, 8]
        distances = numbers[:, at::step].tolist()
        radii = numbers[:, at + 1 :: step].tolist() if self._climbs else [None] * len(numbers)
        for k, tick_reports in enumerate(reports):
            tick, row = first + k, texts[k * width : (k + 1) * width]
            for escort, (report, revoked) in enumerate(tick_reports):
                row[at + step * (escort + 1) - 1] = (
                    encode(report) + b',"revoked":' + encode(revoked)
                )
            truth = (self._truth % (tick, *row)).replace(b"[null,null]", b"null")  # no detection
            asked = self._commands % (tick - 1, *self._asked(row)) if tick else b""
            yield Tick(tick * dt, (tick - 1) * dt, truth, asked, distances[k], radii[k], states[k])
