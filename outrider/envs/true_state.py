"""True state of many worlds in arrays, for centralized critics."""

import numpy as np

from bus.observations import (
    ALTITUDE,
    HEADING,
    STATE,
    TEAM_STATE,
    UAV,
    UAV_STATE,
    UGV_STATE,
    Table,
    as_rows,
    bounds,
    state_names,
)
from outrider.closed_loop.closed_loop import ClosedLoop
from sim.compiling.compile import FloatArray
from sim.env.observation import Array
from sim.env.spaces import box, extent_of
from sim.models.field import coverage_error, coverage_shares
from sim.scenario.kinematics import steers
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav, Ugv


def _table(vehicle: Uav | Ugv, *, teamed: bool) -> Table:
    if isinstance(vehicle, Ugv):
        return UGV_STATE + (HEADING if steers(vehicle) else ())
    own = UAV_STATE + (() if vehicle.initial_altitude is None else ALTITUDE)
    return own + (TEAM_STATE if teamed else ())


class TrueState:
    """State of all worlds: time, coverage, then each vehicle in name order.

    Args:
        scenario: Scenario of the worlds.
        loop: Closed loop of the worlds.
        dtype: Type of the state.
    """

    def __init__(self, scenario: Scenario, loop: ClosedLoop, dtype: type[np.floating]) -> None:
        self._scenario, self._loop = scenario, loop
        self._teamed = scenario.team is not None
        tables = {
            vehicle.name: _table(vehicle, teamed=self._teamed) for vehicle in scenario.vehicles
        }
        self._tables = [tables[name] for name in loop.names]
        self.names = state_names(tables.items())
        """Names of the entries."""
        low, high = bounds(STATE, extent_of(scenario, scenario.vehicles[0]))
        for vehicle in scenario.vehicles:
            least, largest = bounds(tables[vehicle.name], extent_of(scenario, vehicle))
            low, high = low + least, high + largest
        self.space = box(low, high, dtype)
        """Space of the state of one world."""

    def __call__(self) -> Array:
        """Return the states of all worlds as a new array. Shape (worlds, entries)."""
        loop = self._loop
        desired = float(self._scenario.coverage.desired)
        batch, rows = loop.state.batch, loop.state.rows
        shares = [coverage_shares(coverage, desired) for coverage in batch.coverage]
        time: FloatArray = (batch.ticks * self._scenario.dt).astype(np.float64)
        parts = [np.column_stack((time, np.array(shares)))]
        for number, name in enumerate(loop.names):
            if name in loop.uavs:
                parts.append(self._uav(number, loop.uavs.index(name), time))
            else:
                end = 1 + len(self._tables[number])
                parts.append(as_rows(rows.ugv_rows)[:, loop.ugvs.index(name), 1:end])
        state = np.concatenate(parts, axis=1).astype(self.space.dtype)
        return np.clip(state, self.space.low, self.space.high)

    def _uav(self, number: int, uav: int, time: FloatArray) -> FloatArray:
        rows = self._loop.state.rows
        standing, row = rows.standings[:, number], as_rows(rows.uav_rows)[:, uav]
        late = self._scenario.ticks * self._scenario.dt
        newest = standing["newest"]
        age = np.where(newest >= 0.0, time - newest * self._scenario.dt, late)
        columns = (standing["distance"], self._error(number, uav), age)
        parts = [row[:, 1:5], np.column_stack(columns)]
        if ALTITUDE[0] in self._tables[number]:
            parts.append(row[:, len(UAV) : len(UAV) + len(ALTITUDE)])
        if self._teamed:
            parts.append(self._loop.team_rows(self._loop.uavs[uav])[:, : len(TEAM_STATE)])
        return np.concatenate(parts, axis=1)

    def _error(self, number: int, uav: int) -> FloatArray:
        """Return e(t) of a UAV [m²]; it is computed here if the loop does not."""
        loop, scenario = self._loop, self._scenario
        if loop.tables.rows.episode["error"].item():
            error: FloatArray = loop.state.rows.standings[:, number]["error"]
            return error
        r_o = float(scenario.visibility.radius + scenario.sensor.range)
        desired, cell = float(scenario.coverage.desired), float(scenario.area.cell)
        ugv = loop.tables.batch.escorts[uav, 1]
        positions = loop.state.batch.vehicles["position"][:, ugv].tolist()
        return np.array(
            [
                coverage_error(coverage, x, y, r_o, desired, cell)
                for coverage, (x, y) in zip(loop.state.batch.coverage, positions, strict=True)
            ]
        )
