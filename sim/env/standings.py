"""True state of each vehicle in its episode, in one of many worlds, as numbers by name."""

from typing import Any

import numpy as np
import numpy.typing as npt

from bus.observations import ALTITUDE, UAV, UAV_STATE, UGV_STATE, Row, Table, as_rows
from sim.env.rewards import MISSION_TERMS, UAV_TERMS, UGV_TERMS
from sim.env.rows import RowState, RowTables
from sim.models.sight import sight_margin
from sim.scenario.types import Scenario, Ugv


class Standings:
    """True state and observation of each vehicle in an episode.

    Args:
        scenario: Scenario of the environment.
        tables, state: Rows of all worlds.
        world: Index of the world.
    """

    def __init__(self, scenario: Scenario, tables: RowTables, state: RowState, world: int) -> None:
        names = [vehicle.name for vehicle in scenario.vehicles]
        self._dt = scenario.dt
        self._tables, self._state, self._world = tables, state, world
        self._numbers = {name: number for number, name in enumerate(names)}
        self._places: dict[str, int] = dict(zip(names, tables.place.tolist(), strict=True))
        self.state_rows: dict[str, Table] = {
            vehicle.name: UGV_STATE
            if isinstance(vehicle, Ugv)
            else UAV_STATE + (() if vehicle.initial_altitude is None else ALTITUDE)
            for vehicle in scenario.vehicles
        }
        """Entries of the state of each vehicle."""

    def _standing(self, name: str) -> dict[str, Any]:
        """Return the `Standing` of a vehicle as plain numbers."""
        standing = self._state.standings[self._world, self._numbers[name]]
        return {field: standing[field].tolist() for field in standing.dtype.names}

    def row(self, name: str) -> Row:
        """Return the row of a vehicle with all its columns, as a view."""
        place, state, world = self._places[name], self._state, self._world
        rows, number = (state.uav_rows, place) if place >= 0 else (state.ugv_rows, -1 - place)
        row: Row = as_rows(rows)[world, number]
        return row

    def state(self, name: str) -> list[float]:
        """Return the true state of a vehicle."""
        place, row = self._places[name], self.row(name).tolist()
        if place >= 0:
            time, truly = row[0], self._standing(name)
            late = self._tables.episode["ticks"].item() * self._dt
            age = time - truly["newest"] * self._dt if truly["newest"] >= 0.0 else late
            higher = len(self.state_rows[name]) - len(UAV_STATE)
            own = row[len(UAV) : len(UAV) + higher]
            return [*row[1:5], truly["distance"], truly["error"], age, *own]
        truth: list[float] = row[1:]
        return truth


def true_metrics(
    scenario: Scenario, tables: RowTables, state: RowState, name: str
) -> dict[str, npt.NDArray[Any]]:
    """Return a vehicle's true metrics and the terms of its last reward in all worlds: new arrays, shape (worlds,)."""
    number = [vehicle.name for vehicle in scenario.vehicles].index(name)
    truly, found = state.standings[:, number].copy(), dict[str, npt.NDArray[Any]]()
    if tables.place[number] >= 0:
        error = truly["error"] if tables.episode["error"].item() else np.full(len(truly), np.nan)
        found = {
            "distance": truly["distance"],
            "margin": sight_margin(truly["distance"], truly["sight_radius"]),
            "max_distance": truly["max_distance"],
            "visibility_violations": truly["violations"],
            "coverage_error": error,
            "uncovered_share": error / tables.episode["full"].item(),
        }
        terms = UAV_TERMS
    else:
        found = {"goals_reached": truly["reached"], "way_to_goal": truly["to_go"]}
        terms = UGV_TERMS
    paid = {
        f"reward_{term}": truly["terms"][:, n]
        for n, term in enumerate(terms)
        if scenario.has_ground or term not in MISSION_TERMS
    }
    return {key: array.copy() for key, array in (found | paid).items()}
