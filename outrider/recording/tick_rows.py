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
from bus.messages.telemetry import EscortTruth, Truth, VehicleTruth
from bus.messages.vehicle import UavReport
from outrider.recording.schemas import Commands
from sim.compiling.compile import FloatArray
from sim.server.flight import Flight

Reports = Sequence[UavReport | None]
"""Report of each UAV; None: no report."""

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
    states: FloatArray
    """Position and velocity of each vehicle, shape (vehicles, 4)."""


class TickTexts:
    """Encoder of the ticks of one flight.

    Args:
        flight: Flight with its record.
    """

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        self._encoder = msgspec.json.Encoder()
        self._marks = _MARK
        time = self._number()
        vehicles = {
            name: VehicleTruth(
                position=self._pair(),
                velocity=self._pair(),
                acceleration=self._pair(),
                command=self._pair(),
            )
            for name in flight.world.names
        }
        self._escorts = self._marks - _MARK
        """Number of values before the escorts' values; an escort has five, the last a gap for its report."""
        escorts = tuple(
            EscortTruth(
                uav=uav.name,
                ugv=uav.escorts,
                distance=self._number(),
                coverage_error=self._number(),
                detection=self._pair(),
                report=None,
            )
            for uav in flight.world.uavs
        )
        asked = {name: vehicle.command for name, vehicle in vehicles.items()}
        self._asked = itemgetter(
            *(round(number) - _MARK for pair in asked.values() for number in pair)
        )
        self._truth = self._template(
            Truth(tick=_TICK, time=time, vehicles=vehicles, escorts=escorts)
        )
        self._commands = self._template(Commands(tick=_TICK, accelerations=asked))

    def _number(self) -> float:
        self._marks += 1
        return float(self._marks - 1)

    def _pair(self) -> Vector:
        return self._number(), self._number()

    def _template(self, sample: msgspec.Struct) -> bytes:
        """Return the sample's text with gaps for the tick, the numbers and the reports."""
        text = self._encoder.encode(sample)
        for number in range(_MARK, self._marks):
            text = text.replace(b"%d.0" % number, b"%b")
        return text.replace(b'"tick":%d' % _TICK, b'"tick":%d').replace(
            b'"report":null', b'"report":%b'
        )

    def _numbers(self, first: int, commands: FloatArray) -> FloatArray:
        """Return the numbers of the texts in order, one row per tick; NaN is written as null."""
        recorder, (count, vehicles, _) = self._flight.recorder, commands.shape
        numbers: FloatArray = np.full(
            (count, self._escorts + 5 * len(self._flight.world.uavs)), np.nan
        )
        numbers[:, 0] = np.arange(first, first + count) * self._flight.scenario.dt
        moving = numbers[:, 1 : self._escorts].reshape(count, vehicles, 8)
        moving[:, :, :4] = recorder.states[first : first + count, :, :4]
        if first:
            moving[:, :, 4:6] = recorder.states[first - 1 : first + count - 1, :, 4:6]
        else:
            moving[0, :, 4:6], moving[1:, :, 4:6] = 0.0, recorder.states[: count - 1, :, 4:6]
        moving[:, :, 6:8] = commands
        escorts = numbers[:, self._escorts :].reshape(count, -1, 5)
        escorts[:, :, :4] = recorder.escorts[first : first + count, :, :4]
        escorts[:, :, 1] = np.where(escorts[:, :, 1] > 0.0, escorts[:, :, 1], 0.0)
        return numbers

    def of(self, first: int, commands: FloatArray, reports: Sequence[Reports]) -> Iterator[Tick]:
        """Yield consecutive ticks of the flight's record.

        Args:
            first: First tick.
            commands: Commands of the tick before each, shape (ticks, vehicles, 2) [m/s²].
            reports: Reports of the UAVs at each tick.
        """
        numbers, dt, at = self._numbers(first, commands), self._flight.scenario.dt, self._escorts
        width, encode = numbers.shape[1], self._encoder.encode
        texts = encode(numbers.ravel().tolist())[1:-1].split(b",")
        states = numbers[:, 1:at].reshape(*commands.shape[:2], 8)[:, :, :4]
        distances = numbers[:, at::5].tolist()
        for k, tick_reports in enumerate(reports):
            tick, row = first + k, texts[k * width : (k + 1) * width]
            for escort, report in enumerate(tick_reports):
                if report is not None:
                    row[at + 5 * escort + 4] = encode(report)
            truth = (self._truth % (tick, *row)).replace(b"[null,null]", b"null")  # no detection
            asked = self._commands % (tick - 1, *self._asked(row)) if tick else b""
            yield Tick(tick * dt, (tick - 1) * dt, truth, asked, distances[k], states[k])
