"""Recording of a run: the state of every tick, its hash, and summary values."""

import csv
import hashlib
import math
import platform
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from bus.messages.decision import NotCertified
from bus.messages.team import Role
from bus.messages.vehicle import UavReport
from sim.channel.link_records import ARRIVED
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.records import RecordArray, choice, code, record_type
from sim.engine.monitor import NEVER, ArrivalRecord
from sim.engine.world_state import BatchState, BatchTables
from sim.engine.world_tick import measure
from sim.models.sight import is_lost, sight_margin
from sim.scenario.team import observer_rows
from sim.world import World

_N = TypeVar("_N", bound=np.generic)
_ROOM = 16_384
"""Initial capacity [rows], at most the length of the run; it is doubled when it is full."""
_HASHED = 4096
"""Rows hashed at a time."""
_VEHICLE = ("x [m]", "y [m]", "vx [m/s]", "vy [m/s]", "ux [m/s2]", "uy [m/s2]")
"""Columns of `Recorder.states`; the last two hold the command applied during the tick."""
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
_HEIGHT = ("z [m]", "vz [m/s]", "uz [m/s2]", "visible_within [m]")
"""Columns of `Recorder.heights`; the third holds the command applied during the tick."""
_CERTIFIED = _ESCORT.index("certified")
_REPORTED = 4
"""First column of a UAV's report."""


@compiled
def _record_tick(
    tables: BatchTables,
    state: BatchState,
    arrivals: RecordArray,
    states: FloatArray,
    escorts: FloatArray,
    heights: FloatArray,
    k: int,
) -> None:
    """Measure the world at tick k, write its row, and add the applied accelerations to the previous row.

    Args:
        tables, state: World, as a batch of one.
        arrivals: Arrivals of each UAV, see `Recorder.arrivals`.
        states, escorts, heights: Arrays of the record.
        k: The tick.
    """
    measure(tables, state, 0, True)
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
    for uav in range(heights.shape[1]):
        vehicle = state.vehicles[0, tables.escorts[uav, 0]]
        vertical = vehicle.vertical
        if k > 0:
            heights[k - 1, uav, 2] = vertical.acceleration
        heights[k, uav, 0], heights[k, uav, 1], heights[k, uav, 2] = (
            vertical.altitude,
            vertical.rate,
            np.nan,
        )
        heights[k, uav, 3] = vehicle.sight_radius


def _grown(rows: npt.NDArray[_N], room: int) -> npt.NDArray[_N]:
    """Return a copy of an array with space for more rows."""
    grown = np.zeros((room, *rows.shape[1:]), dtype=rows.dtype)
    grown[: len(rows)] = rows
    return grown


class Recorder:
    """Arrays that grow with the run; row k is tick k.

    Args:
        world: World to record.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self.ticks = 0
        """Number of complete ticks, whose commands were applied."""
        self.rows = 0
        """Number of recorded states: one more than complete ticks after the end of the run."""
        vehicles, uavs = len(world.names), len(world.uavs)
        room = min(world.scenario.ticks + 1, _ROOM)
        self._disturbed = world.scenario.disturbed
        self._off = 0.0  # largest tracking error [m]
        reference_rows = vehicles if self._disturbed else 0
        self._states: FloatArray = np.empty((room, vehicles, len(_VEHICLE)))
        self._escorts: FloatArray = np.empty((room, uavs, len(_ESCORT)))
        self._reference: FloatArray = np.empty((room, reference_rows, 4))
        climbing = uavs if world.scenario.has_altitude else 0
        self._heights: FloatArray = np.empty((room, climbing, len(_HEIGHT)))
        teamed = 0 if world.scenario.team is None else uavs
        self._roles: IntArray = np.zeros((room, teamed), dtype=np.int64)
        self.arrivals: RecordArray = np.zeros(uavs, record_type(ArrivalRecord))
        """`ArrivalRecord` of each UAV at the latest recorded tick. Shape (UAVs,)."""

    def _grow(self) -> None:
        """Double the capacity, to at most the length of the run."""
        room = min(2 * len(self._states), self._world.scenario.ticks + 1)
        self._states, self._escorts = _grown(self._states, room), _grown(self._escorts, room)
        self._reference, self._heights = _grown(self._reference, room), _grown(self._heights, room)
        self._roles = _grown(self._roles, room)

    def record(
        self, reports: Sequence[UavReport | None], revoked: Sequence[NotCertified | None] = ()
    ) -> None:
        """Record the state at this tick, and the commands and reports of the previous tick.

        Called once per tick, best while the vehicles compute; repeated calls at a tick have no effect.

        Args:
            reports: Report of each UAV at the previous tick; None: no report.
            revoked: Reason why the certificate in each report does not hold; None: it does. Empty: all hold.
        """
        k = self._world.tick
        if k < self.rows:
            return
        if k == len(self._states):
            self._grow()
        _record_tick(
            *self._world.arrays, self.arrivals, self._states, self._escorts, self._heights, k
        )
        if self._disturbed:
            self._reference[k, :, 0:2] = self._world.reference_position
            self._reference[k, :, 2:4] = self._world.reference_velocity
            off = self._world.position - self._world.reference_position
            known = ~self._world.vehicles["disturbance"]["unknown"]
            self._off = max(self._off, float((np.hypot(off[:, 0], off[:, 1]) * known).max()))
        for uav, report in enumerate(reports if k else ()):
            if report is not None:
                certified = distance = math.nan
                if report.decision is not None:
                    certified, bound = report.decision.certified, report.decision.certified_distance
                    if revoked and revoked[uav] is not None:
                        certified = False
                    distance = math.nan if bound is None else bound
                self._escorts[k - 1, uav, _REPORTED:] = *report.estimate, certified, distance
                if report.role is not None and self._roles.shape[1]:
                    self._roles[k - 1, uav] = code(report.role)
        self.ticks, self.rows = k, k + 1

    @property
    def states(self) -> FloatArray:
        """Return position [m], velocity [m/s] and applied acceleration [m/s²]. Shape (rows, vehicles, 6).

        The last row of a complete run has no acceleration: NaN.
        """
        return self._states[: self.rows]

    @property
    def reference(self) -> FloatArray:
        """Return the reference position [m] and velocity [m/s] of each vehicle, shape (rows, vehicles, 4)."""
        return self._reference[: self.rows] if self._disturbed else self.states[:, :, :4]

    @property
    def heights(self) -> FloatArray:
        """Return values of each UAV with an altitude, shape (rows, UAVs, 4); (rows, 0, 4) in the plane.

        Columns: altitude [m], climb rate [m/s], applied vertical acceleration [m/s²], and the distance within which
        the UGV is visible [m], 0 while a building hides it.
        """
        return self._heights[: self.rows]

    @property
    def roles(self) -> IntArray:
        """Return the code of each UAV's `Role`, 0: none reported. Shape (rows, UAVs); (rows, 0) without teams."""
        return self._roles[: self.rows]

    @property
    def tracking_error(self) -> float | None:
        """Return the largest distance of a UAV from its reference position, while its state is known [m].

        None without disturbances.
        """
        return self._off if self._disturbed else None

    def tracking_error_at(self, tick: int, uav: int) -> float:
        """Return the distance of a UAV from its reference position at a recorded tick [m]."""
        row = self._world.escorts.item(uav, 0)
        off = self.states[tick, row, :2] - self.reference[tick, row, :2]
        return math.hypot(*off.tolist())

    @property
    def escorts(self) -> FloatArray:
        """Return values of each UAV and its UGV, shape (rows, UAVs, 8); missing values are NaN.

        Columns: distance [m], e(t) [m²], detected p_delta [m], estimated p_g [m], certified (1 or 0), certified
        distance [m].
        """
        return self._escorts[: self.rows]

    def has_seen(self, uav: int) -> bool:
        """True if a detection had reached a UAV at the latest recorded tick."""
        return bool(self.arrivals[uav]["newest"] != NEVER)

    def distance(self, tick: int, uav: int) -> float:
        """Return the distance of a UAV from its UGV at a recorded tick [m]."""
        return self._escorts.item(tick, uav, 0)

    def is_lost(self, tick: int, uav: int) -> bool:
        """Return whether a UAV's UGV was out of sight at a recorded tick, (5)."""
        radius = self._world.parameters.r_v
        if self._heights.shape[1]:
            radius = self._heights.item(tick, uav, 3)
        return bool(is_lost(self.distance(tick, uav), radius))

    @property
    def radii(self) -> FloatArray:
        """Return the distance within which each UAV's UGV is visible [m], 0 while a building hides it.

        Shape (rows, UAVs).
        """
        if self._heights.shape[1]:
            return self.heights[:, :, 3]
        return np.full(self.escorts.shape[:2], self._world.parameters.r_v)

    @property
    def lost(self) -> npt.NDArray[np.bool_]:
        """Return whether each UAV's UGV was out of sight, (5). Shape (rows, UAVs)."""
        return is_lost(self.escorts[:, :, 0], self.radii)

    @property
    def margins(self) -> FloatArray:
        """Return the distance by which each UGV may still recede before it is out of sight [m].

        Positive exactly while it is in sight. Shape (rows, UAVs).
        """
        return sight_margin(self.escorts[:, :, 0], self.radii)

    def _observed(self, values: npt.NDArray[Any], merge: Callable[..., Any]) -> npt.NDArray[Any]:
        """Merge the columns of the UAVs of each team. Shapes (rows, UAVs), (rows, observers)."""
        columns = [merge(values[:, rows], axis=1) for rows in observer_rows(self._world.scenario)]
        return np.stack(columns, axis=1) if columns else values

    @property
    def nearest(self) -> FloatArray:
        """Return the distance of the nearest UAV of each team, and of each UAV without one [m]."""
        return self._observed(self.escorts[:, :, 0], np.min)

    @property
    def unseen(self) -> npt.NDArray[np.bool_]:
        """Return whether no UAV of a team, or a UAV without one, saw its UGV. Shape (rows, observers)."""
        return self._observed(self.lost, np.all)

    @property
    def widest_margins(self) -> FloatArray:
        """Return the largest margin of each team, and the margin of each UAV without a team [m]."""
        return self._observed(self.margins, np.max)

    def sha256(self, ticks: int | None = None) -> str:
        """Return the hash of the trajectory over the first `ticks` complete ticks (all by default).

        For each tick in order and each vehicle in name order: p and v, then the applied command; then, for each UAV
        with an altitude, its altitude, climb rate and vertical acceleration. Little-endian float64, -0.0 as 0.0.
        """
        count = self.ticks if ticks is None else min(ticks, self.ticks)
        digest = hashlib.sha256()
        for begin in range(0, count, _HASHED):
            end = min(begin + _HASHED, count)
            parts = self._states[begin:end], self._heights[begin:end, :, :3]
            rows = np.concatenate([part.reshape(end - begin, -1) for part in parts], axis=1)
            digest.update((rows + 0.0).astype("<f8").tobytes())
        return digest.hexdigest()

    def _rows(self) -> Iterator[list[float | int | str]]:
        dt = self._world.parameters.dt
        for k in range(self.rows):
            numbers: list[float | int] = self._states[k].ravel().tolist()
            for escort in self._escorts[k].tolist():
                numbers += escort
                if not math.isnan(escort[_CERTIFIED]):
                    numbers[_CERTIFIED - len(escort)] = int(escort[_CERTIFIED])
            numbers += self._heights[k].ravel().tolist()
            if self._disturbed:
                numbers += self._reference[k, self._world.escorts[:, 0], :2].ravel().tolist()
            roles = [choice(Role, role) or "" for role in self._roles[k].tolist()]
            yield [k, k * dt, *("" if math.isnan(number) else number for number in numbers), *roles]

    def write(self, path: Path) -> None:
        """Write the trajectory as CSV; the header holds the units.

        Numbers are exact, and missing values are empty fields. If disturbances act, further columns hold the reference
        positions of the UAVs; in a team, the last ones hold the roles.
        """
        uavs = [uav.name for uav in self._world.uavs]
        header = ["tick", "time [s]"]
        header += [f"{name}.{field}" for name in self._world.names for field in _VEHICLE]
        header += [f"{name}.{field}" for name in uavs for field in _ESCORT]
        if self._heights.shape[1]:
            header += [f"{name}.{field}" for name in uavs for field in _HEIGHT]
        if self._disturbed:
            header += [f"{name}.reference_{axis} [m]" for name in uavs for axis in "xy"]
        if self._roles.shape[1]:
            header += [f"{name}.role" for name in uavs]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(header)
            writer.writerows(self._rows())


def platform_row() -> dict[str, str]:
    """Return the versions and the machine on which a trajectory's bits depend, apart from scenario and seed."""
    return {
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "numba": version("numba"),
        "c_library": " ".join(platform.libc_ver()),
        "machine": platform.machine(),
        "system": platform.system(),
    }
