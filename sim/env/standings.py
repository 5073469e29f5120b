"""True standing of each vehicle of one world of many in its episode, as numbers by name."""

from bus.observations import UAV_STATE, UGV_STATE, Row, Table, as_rows
from sim.env.rewards import MISSION_TERMS, UavTerms, UgvTerms
from sim.env.rows import RowState, RowTables, UavMetrics, UgvMetrics
from sim.scenario.types import Scenario, Ugv


class Standings:
    """The standing of each vehicle in an episode: what it observes, and truly does.

    Args:
        scenario: What is flown.
        tables, state: The rows of all worlds; read at any time.
        world: The number of the world.
    """

    def __init__(self, scenario: Scenario, tables: RowTables, state: RowState, world: int) -> None:
        names = [vehicle.name for vehicle in scenario.vehicles]
        self._dt, self._r_v = scenario.dt, float(scenario.visibility.radius)
        self._grounded = scenario.has_ground
        self._tables, self._state, self._world = tables, state, world
        self._numbers = {name: number for number, name in enumerate(names)}
        self._places: dict[str, int] = dict(zip(names, tables.place.tolist(), strict=True))
        self.state_rows: dict[str, Table] = {
            vehicle.name: UGV_STATE if isinstance(vehicle, Ugv) else UAV_STATE
            for vehicle in scenario.vehicles
        }
        """The entries of the state of each vehicle."""

    def _uav(self, place: int) -> UavMetrics:
        numbers = self._state.uavs[self._world, place, : len(UavMetrics._fields)]
        return UavMetrics._make(numbers.tolist())

    def _ugv(self, place: int) -> UgvMetrics:
        return UgvMetrics._make(self._state.ugvs[self._world, -1 - place].tolist())

    def row(self, name: str) -> Row:
        """The row of a vehicle, with all its columns; a view."""
        place, state, world = self._places[name], self._state, self._world
        rows, number = (state.uav_rows, place) if place >= 0 else (state.ugv_rows, -1 - place)
        row: Row = as_rows(rows)[world, number]
        return row

    def state(self, name: str) -> list[float]:
        """The truth of a vehicle."""
        place, row = self._places[name], self.row(name).tolist()
        if place >= 0:
            time, metrics = row[0], self._uav(place)
            late = self._tables.episode["ticks"].item() * self._dt
            age = time - metrics.newest * self._dt if metrics.newest >= 0.0 else late
            return [*row[1:5], metrics.distance, metrics.error, age]
        truth: list[float] = row[1:]
        return truth

    def metrics(self, name: str) -> dict[str, float]:
        """A vehicle's true standing, for people."""
        place = self._places[name]
        numbers = self._state.terms[self._world, self._numbers[name]].tolist()
        found: dict[str, float]
        terms: UavTerms | UgvTerms
        if place >= 0:
            m = self._uav(place)
            found = {
                "distance": m.distance,
                "margin": self._r_v - m.distance,
                "max_distance": m.max_distance,
                "visibility_violations": int(m.violations),
                "coverage_error": m.error,
                "uncovered_share": m.error / self._tables.episode["full"].item(),
            }
            terms = UavTerms._make(numbers)
        else:
            n = self._ugv(place)
            found = {"goals_reached": int(n.reached), "way_to_goal": n.to_go}
            terms = UgvTerms._make(numbers[: len(UgvTerms._fields)])
        paid = {
            f"reward_{name}": term
            for name, term in terms._asdict().items()
            if self._grounded or name not in MISSION_TERMS
        }
        return found | paid
