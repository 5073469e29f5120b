"""Recording of a flight: the record of every tick, its hash, and the numbers that sum it up."""

import csv
import hashlib
import math
import platform
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import numpy as np

from bus.messages.vehicle import UavReport
from sim.channel.link_records import ARRIVED
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray, record_type
from sim.engine.monitor import NEVER, ArrivalRecord
from sim.engine.world_state import BatchState, BatchTables
from sim.engine.world_tick import measure
from sim.server.row_store import RowStore
from sim.world import World

_ROOM = 16_384
"""Rows that there is room for at first, where the flight has so many; more are kept in a file."""
_HASHED = 4096
"""Rows that are hashed at once."""
_VEHICLE = ("x [m]", "y [m]", "vx [m/s]", "vy [m/s]", "ux [m/s2]", "uy [m/s2]")
"""Columns of `Recorder.states`; the last two are of the command that is applied during the tick."""
_ESCORT = (
    "distance [m]",
    "coverage_error [m2]",
    "detected_x [m]",
    "detected_y [m]",
    "estimate_x [m]",
    "estimate_y [m]",
    "certified",
    "certified_distance [m]",
)
"""Columns of `Recorder.escorts`."""
_CERTIFIED = _ESCORT.index("certified")
_REPORTED = 4
"""First column of a UAV's report."""


@compiled
def _take_down(
    tables: BatchTables,
    state: BatchState,
    arrivals: RecordArray,
    states: FloatArray,
    escorts: FloatArray,
    k: int,
) -> None:
    """Measure the world at tick k, and write its row, and into the row before what was applied.

    Args:
        tables, state: The world, a batch of one.
        arrivals: Of each UAV, see `Recorder.arrivals`.
        states, escorts: The record.
        k: The tick.
    """
    measure(tables.world, state.vehicles, tables.escorts, state.coverage, 0, True)
    for v in range(states.shape[1]):
        vehicle = state.vehicles[0, v]
        for axis in range(2):
            if k > 0:
                states[k - 1, v, 4 + axis] = vehicle.acceleration[axis]
            states[k, v, axis] = vehicle.position[axis]
            states[k, v, 2 + axis] = vehicle.velocity[axis]
            states[k, v, 4 + axis] = np.nan
    for uav in range(escorts.shape[1]):
        vehicle = state.vehicles[0, tables.escorts[uav, 0]]
        escorts[k, uav, 0], escorts[k, uav, 1] = vehicle.distance, vehicle.coverage_error
        escorts[k, uav, 2], escorts[k, uav, 3] = vehicle.detection[0], vehicle.detection[1]
        for n in range(4, 8):
            escorts[k, uav, n] = np.nan
        arrivals[uav].newest, arrivals[uav].error = NEVER, 0.0
        for n in range(state.links[0, uav].arrived):
            packet = state.packets[0, uav, ARRIVED, n]
            arrivals[uav].newest = max(arrivals[uav].newest, int(packet.stamp))
            arrivals[uav].error = max(arrivals[uav].error, packet.error)


class Recorder:
    """Arrays that grow with the flight; row k is tick k.

    Args:
        world: The world that is recorded.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self.ticks = 0
        """Number of complete ticks: those whose commands were applied."""
        self.rows = 0
        """Number of states taken down: one more than complete ticks, once the flight is over."""
        vehicles, uavs = len(world.names), len(world.uavs)
        room = min(world.scenario.ticks + 1, _ROOM)
        self._tells = world.scenario.disturbed
        told = vehicles if self._tells else 0
        self._stores = (
            RowStore(room, (vehicles, len(_VEHICLE))),
            RowStore(room, (uavs, len(_ESCORT))),
            RowStore(room, (told, 4)),
        )
        self._bind()
        self.arrivals: RecordArray = np.zeros(uavs, record_type(ArrivalRecord))
        """`ArrivalRecord` of each UAV, of the tick that was taken down last. Shape (UAVs,)."""

    def _bind(self) -> None:
        self._states, self._escorts, self._told = (store.array for store in self._stores)

    def record(self, reports: list[UavReport | None]) -> None:
        """Take down the state at this tick and, with it, what was applied and reported during the one before.

        Called once at each tick, best while the vehicles think; again at the same tick it changes nothing.

        Args:
            reports: What each UAV reported at the tick before; None where it did not.
        """
        k = self._world.tick
        if k < self.rows:
            return
        if k == len(self._states):
            for store in self._stores:
                store.grow()
            self._bind()
        _take_down(*self._world.arrays, self.arrivals, self._states, self._escorts, k)
        if self._tells:
            self._told[k, :, 0:2] = self._world.reference_position
            self._told[k, :, 2:4] = self._world.reference_velocity
        for uav, report in enumerate(reports if k else ()):
            if report is not None:
                certified = distance = math.nan
                if report.decision is not None:
                    certified, bound = report.decision.certified, report.decision.certified_distance
                    distance = math.nan if bound is None else bound
                self._escorts[k - 1, uav, _REPORTED:] = *report.estimate, certified, distance
        self.ticks, self.rows = k, k + 1

    @property
    def states(self) -> FloatArray:
        """Position [m], velocity [m/s] and applied acceleration [m/s²] of each vehicle, shape (rows, vehicles, 6).

        The last row of a flight that is over has no acceleration: NaN.
        """
        return self._states[: self.rows]

    @property
    def told(self) -> FloatArray:
        """Position [m] and velocity [m/s] as each vehicle is told them, shape (rows, vehicles, 4): mostly the truth."""
        return self._told[: self.rows] if self._tells else self.states[:, :, :4]

    @property
    def tracking_error(self) -> float | None:
        """The farthest that a UAV was from where it was told that it is [m]; None where nothing takes it from there."""
        if not self._tells:
            return None
        off = self.states[:, :, :2] - self.told[:, :, :2]
        return float(np.hypot(off[..., 0], off[..., 1]).max())

    def tracking_error_at(self, tick: int, uav: int) -> float:
        """The distance of a UAV from where it was told that it is at a tick that has been taken down [m]."""
        row = self._world.escorts.item(uav, 0)
        off = self.states[tick, row, :2] - self.told[tick, row, :2]
        return math.hypot(*off.tolist())

    @property
    def escorts(self) -> FloatArray:
        """Quantities of each UAV and its UGV, shape (rows, UAVs, 8); NaN where there is none.

        Distance [m], e(t) [m²], detected p_delta [m], estimated p_g [m], whether certified (1 or 0), certified
        distance [m].
        """
        return self._escorts[: self.rows]

    def has_seen(self, uav: int) -> bool:
        """True if a detection had reached a UAV at the tick that was taken down last."""
        return bool(self.arrivals[uav]["newest"] != NEVER)

    def distance(self, tick: int, uav: int) -> float:
        """Distance of a UAV from its UGV at a tick that has been taken down [m]."""
        return self._escorts.item(tick, uav, 0)

    def sha256(self, ticks: int | None = None) -> str:
        """The trajectory's hash over the first `ticks` complete ticks (all of them by default).

        For each tick in order and each vehicle in name order: p and v, then the command applied; little-endian float64,
        -0.0 written as 0.0.
        """
        complete = self._states[: self.ticks if ticks is None else min(ticks, self.ticks)]
        digest = hashlib.sha256()
        for begin in range(0, len(complete), _HASHED):
            digest.update((complete[begin : begin + _HASHED] + 0.0).astype("<f8").tobytes())
        return digest.hexdigest()

    def _rows(self) -> Iterator[list[float | int | str]]:
        dt = self._world.parameters.dt
        for k in range(self.rows):
            numbers: list[float | int] = self._states[k].ravel().tolist()
            for escort in self._escorts[k].tolist():
                numbers += escort
                if not math.isnan(escort[_CERTIFIED]):
                    numbers[_CERTIFIED - len(escort)] = int(escort[_CERTIFIED])
            if self._tells:
                numbers += self._told[k, self._world.escorts[:, 0], :2].ravel().tolist()
            yield [k, k * dt, *("" if math.isnan(number) else number for number in numbers)]

    def write(self, path: Path) -> None:
        """Write the trajectory as CSV with a header that carries the units.

        Numbers survive exactly, none is an empty field. Only where wind or a wrong own position may take a UAV from
        where it is told that it is, the last columns tell that.
        """
        uavs = [uav.name for uav in self._world.uavs]
        header = ["tick", "time [s]"]
        header += [f"{name}.{field}" for name in self._world.names for field in _VEHICLE]
        header += [f"{name}.{field}" for name in uavs for field in _ESCORT]
        if self._tells:
            header += [f"{name}.told_{axis} [m]" for name in uavs for axis in "xy"]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(header)
            writer.writerows(self._rows())


def platform_row() -> dict[str, str]:
    """Versions and machine on which the bits of a trajectory depend, besides scenario and seed."""
    return {
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "numba": version("numba"),
        "c_library": " ".join(platform.libc_ver()),
        "machine": platform.machine(),
        "system": platform.system(),
    }
