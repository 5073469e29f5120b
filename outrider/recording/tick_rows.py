"""Many ticks of a flight as JSON at once: the same bytes as their `Truth` and `Commands`, without making those.

A recording holds every tick, and to make the messages one by one costs more than to write them. What changes from
tick to tick is numbers: they are written in one go, and put into the text that one message was, once.
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
"""The report of each UAV; None: it said nothing."""

_TICK, _MARK = 700_000, 700_001
"""Stand in a sample for the tick, and from there on for its numbers."""


class Tick(NamedTuple):
    """One tick as it is written."""

    time: float
    """Simulated [s]."""
    begun: float
    """Time at which the tick before began [s]."""
    truth: bytes
    commands: bytes
    """Those of the tick before; empty: there were none."""
    distances: list[float]
    """Of each escort [m]."""
    states: FloatArray
    """Position and velocity of each vehicle, shape (vehicles, 4)."""


class TickTexts:
    """Writes the ticks of one flight.

    Args:
        flight: Whose record is read.
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
        """So many numbers come before those of the escorts, which are five each, the last a gap for the report."""
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
        """The sample's text with a gap for the tick, each number and each report."""
        text = self._encoder.encode(sample)
        for number in range(_MARK, self._marks):
            text = text.replace(b"%d.0" % number, b"%b")
        return text.replace(b'"tick":%d' % _TICK, b'"tick":%d').replace(
            b'"report":null', b'"report":%b'
        )

    def _numbers(self, first: int, commands: FloatArray) -> FloatArray:
        """The numbers of the texts in their order, a row for each tick; NaN is written as null."""
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
        seen = numbers[:, self._escorts :].reshape(count, -1, 5)
        seen[:, :, :4] = recorder.escorts[first : first + count, :, :4]
        seen[:, :, 1] = np.where(seen[:, :, 1] > 0.0, seen[:, :, 1], 0.0)
        return numbers

    def of(self, first: int, commands: FloatArray, reports: Sequence[Reports]) -> Iterator[Tick]:
        """Ticks that follow each other and are in the flight's record.

        Args:
            first: The first of them.
            commands: What was asked for during the tick before each, shape (ticks, vehicles, 2) [m/s²].
            reports: What each UAV said then.
        """
        numbers, dt, at = self._numbers(first, commands), self._flight.scenario.dt, self._escorts
        width, encode = numbers.shape[1], self._encoder.encode
        texts = encode(numbers.ravel().tolist())[1:-1].split(b",")
        states = numbers[:, 1:at].reshape(*commands.shape[:2], 8)[:, :, :4]
        distances = numbers[:, at::5].tolist()
        for k, said in enumerate(reports):
            tick, row = first + k, texts[k * width : (k + 1) * width]
            for escort, report in enumerate(said):
                if report is not None:
                    row[at + 5 * escort + 4] = encode(report)
            truth = (self._truth % (tick, *row)).replace(b"[null,null]", b"null")  # no detection
            asked = self._commands % (tick - 1, *self._asked(row)) if tick else b""
            yield Tick(tick * dt, (tick - 1) * dt, truth, asked, distances[k], states[k])
