"""One world's rows, rewards and metrics by vehicle: a shell around `sim.env.rows` with a batch of one."""

from bus.observations import UAV, UAV_STATE, UGV_STATE, Row, Table, as_rows, names
from sim.engine.ground_state import GroundState
from sim.engine.world_state import BatchState, BatchTables
from sim.env.rewards import MISSION_TERMS, RewardWeights, UavTerms, UgvTerms
from sim.env.rows import (
    UGV_METRICS,
    RowState,
    RowTables,
    UavMetrics,
    UgvMetrics,
    advance_rows,
    observe_rows,
    row_state,
    row_tables,
)
from sim.kernels.compile import compiled
from sim.scenario.types import Scenario, Ugv
from sim.world import World


@compiled
def _advance(
    bt: BatchTables,
    bs: BatchState,
    ground: GroundState | None,
    tables: RowTables,
    state: RowState,
    beginning: bool,
) -> None:
    advance_rows(bt, bs, ground, tables, state, 0, beginning)
    observe_rows(bt, bs, tables, state, 0)


class Episode:
    """The standing of each vehicle of a world in an episode: what it observes, is paid, and truly does.

    Args:
        scenario: What is flown.
        weights: What the vehicles are paid for.
    """

    def __init__(self, scenario: Scenario, weights: RewardWeights) -> None:
        self.names = [vehicle.name for vehicle in scenario.vehicles]
        """Vehicles in the order of every array."""
        self._dt, self._r_v = scenario.dt, float(scenario.visibility.radius)
        self._grounded = scenario.has_ground
        self._tables = row_tables(scenario, weights, end_on_sight_lost=True, end_on_goals=False)
        self._places: dict[str, int] = dict(
            zip(self.names, self._tables.place.tolist(), strict=True)
        )
        self.state_rows: dict[str, Table] = {
            vehicle.name: UGV_STATE if isinstance(vehicle, Ugv) else UAV_STATE
            for vehicle in scenario.vehicles
        }
        """The entries of the state of each vehicle."""

    def uav(self, name: str) -> int | None:
        """A vehicle's row among the UAVs; None where it is none."""
        place = self._places.get(name, -1)
        return place if place >= 0 else None

    def begin(self, world: World) -> None:
        """Forget the last episode."""
        self._state = row_state(self._tables, 1)
        self._take(world, beginning=True)

    def advance(self, world: World, *, end_on_sight_lost: bool, end_on_goals: bool) -> None:
        """Take in the next tick; the episode ends where sight is lost, or every goal reached, if it shall."""
        episode = self._tables.episode
        episode["end_on_sight_lost"], episode["end_on_goals"] = end_on_sight_lost, end_on_goals
        self._take(world, beginning=False)

    def _take(self, world: World, *, beginning: bool) -> None:
        world.measure()
        _advance(*world.arrays, world.ground, self._tables, self._state, beginning)

    @property
    def terminated(self) -> bool:
        """True if it is over by what has happened."""
        return bool(self._state.terminated[0])

    @property
    def truncated(self) -> bool:
        """True if it is over by its length."""
        return bool(self._state.truncated[0])

    def _uav(self, place: int) -> UavMetrics:
        return UavMetrics._make(self._state.uavs[0, place].tolist())

    def _ugv(self, place: int) -> UgvMetrics:
        return UgvMetrics._make(self._state.ugvs[0, -1 - place].tolist())

    def row(self, name: str) -> Row:
        """The observation of a vehicle; a view."""
        place, state = self._places[name], self._state
        if place >= 0:
            row: Row = as_rows(state.uav_rows)[0, place, : len(UAV)]
        else:
            row = as_rows(state.ugv_rows)[0, -1 - place]
        return row

    def rewards(self) -> dict[str, float]:
        """The reward of each vehicle for this tick."""
        return dict(zip(self.names, self._state.rewards[0].tolist(), strict=True))

    def state(self, name: str) -> list[float]:
        """The truth of a vehicle."""
        place, row = self._places[name], self.row(name).tolist()
        if place >= 0:
            own, metrics = dict(zip(names(UAV), row, strict=True)), self._uav(place)
            newest = metrics.newest
            age = own["time"] - newest * self._dt if newest >= 0.0 else own["age"]
            return [*row[1:5], metrics.distance, metrics.error, age]
        truth: list[float] = row[1:]
        return truth

    def info(self, name: str) -> dict[str, float]:
        """Facts of a vehicle's own that are in no row."""
        place = self._places[name]
        if place >= 0:
            return {}
        return {"goals_reached": int(self._state.ugvs.item(0, -1 - place, UGV_METRICS.reached))}

    def metrics(self, name: str) -> dict[str, float]:
        """A vehicle's true standing, for people."""
        place, numbers = self._places[name], self._state.terms[0, self.names.index(name)].tolist()
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
