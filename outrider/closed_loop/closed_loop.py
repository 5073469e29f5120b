"""Closed loop in many worlds at once.

One compiled pass computes a tick: world, links, filters, laws, drivers and rewards.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from agents.safety.safety_filter import decision_of
from bus.messages.decision import FilterDecision
from bus.messages.links import LinkKind, LinkStatus
from bus.messages.telemetry import MissionResult
from bus.observations import UAV, names
from outrider.closed_loop.arrays import LoopState, LoopTables, Pilots, PilotState
from outrider.closed_loop.pilots import (
    ChosenPilots,
    drivers_in_control,
    map_random_buildings,
    uses_radio,
)
from outrider.closed_loop.random_worlds import DrawnWorlds, tables_of_worlds
from outrider.closed_loop.teams import team_metrics
from outrider.closed_loop.tick import run_worlds
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray
from sim.engine.batch import Batch, Fresh
from sim.engine.ground_state import set_driver
from sim.engine.mission import mission_of
from sim.engine.monitor import certificate_counters
from sim.engine.run_keys import check_secret
from sim.engine.world_tick import BEGIN, END, WHOLE
from sim.env.actions import ACTION_COLUMNS
from sim.env.randomization import Randomization
from sim.env.rows import RowTables, row_state, row_tables
from sim.env.settings import Settings, settings_of
from sim.models.ground import TileArray
from sim.models.randomness import PILOT
from sim.scenario.checks import check_no_robot
from sim.scenario.types import Scenario


class ClosedLoop:
    """Many worlds of one scenario, with all vehicles in closed loop.

    Args:
        scenario: Scenario of all worlds.
        worlds: Number of worlds.
        external: Vehicles with external actions, in the order of the actions.
        pilots: Laws and drivers of the other vehicles, by vehicle, instead of the scenario's.
        error: True to compute e(t) at every tick; it is always computed if `uncovered` is rewarded.
        settings: Keywords, see `sim.env.settings.Settings`.

    Raises:
        ScenarioError: If a vehicle has a law or a driver that cannot be compiled, or a robot flies it.
        ValueError: If another argument is not allowed.
        TypeError: If a setting is unknown.
    """

    def __init__(
        self,
        scenario: Scenario,
        worlds: int,
        *,
        external: Collection[str] = (),
        pilots: Mapping[str, str] | None = None,
        error: bool = False,
        **settings: Any,  # noqa: ANN401 - fields of `Settings`
    ) -> None:
        check_no_robot(scenario)
        options = settings_of(settings)
        given, ranges = scenario, options.randomize
        self.randomization = Randomization(scenario, ranges) if ranges else None
        """Ranges of randomized fields; None: no field is random."""
        if self.randomization:
            scenario = self.randomization.widest
        self.scenario = scenario
        """Scenario of all worlds; randomized fields have the largest value of their range."""
        self.worlds = worlds
        self.names = tuple(vehicle.name for vehicle in scenario.vehicles)
        """All vehicles, in the order of every array."""
        self.uavs = tuple(name for name in self.names if name in {uav.name for uav in scenario.uav})
        """UAVs, in the order of their arrays."""
        self.ugvs = tuple(name for name in self.names if name not in self.uavs)
        """UGVs, in the order of their arrays."""
        options = options.of_loop(self.uavs)
        self.has_estimates = bool(options.estimate)
        """True if the UAVs' rows hold the estimate."""
        self.external = tuple(external)
        """Vehicles with external actions."""
        chosen = dict(pilots or {})
        for name in (*self.external, *chosen):
            if name not in self.names:
                raise ValueError(f"vehicle = {name!r}; allowed: {', '.join(self.names)}")
        self._secret = check_secret(options.secret)
        self.batch = self._batch_of(options)
        self.drivers = drivers_in_control(scenario, self.external, chosen)
        """Driver in control of each UGV, `EXTERNAL` for external actions."""
        for name, driver in self.drivers.items():
            set_driver(scenario, self.batch.ground, name, driver)
        self.tables, self.state = self._arrays(row_tables(scenario, options, error=error))
        self.has_error = bool(self.tables.rows.episode["error"][0])
        """True if e(t) is computed at every tick."""
        picked = self._chosen_pilots(chosen, options) if self._needs_pilots(options) else None
        self.pilots: Pilots | None = None
        """Pilots; None if all actions are external and no other feature is needed."""
        if picked is not None:
            own = tables_of_worlds(picked, scenario, worlds if self.randomization else None)
            self.pilots = picked.pilots(self.batch, options, own)
        self._drawn: DrawnWorlds | None = None
        if self.randomization:
            self._drawn = DrawnWorlds(self.randomization, given, self.batch, picked)
        # the batch restores its own state
        self._fresh = Fresh((self.state[1:], self.pilots and self.pilots.state))
        self._all = np.arange(worlds)
        self._none = np.zeros((worlds, 0, ACTION_COLUMNS))
        self.begin([scenario.seed], [0])

    def _batch_of(self, settings: Settings) -> Batch:
        """Return the batch of worlds."""
        return Batch(
            self.scenario,
            self.worlds,
            gains=settings.rewards.seen > 0.0,
            threads=settings.threads,
            secret=self._secret,
            others=(LinkKind.RADIO, LinkKind.TEAM),
            differ=self.randomization is not None,
        )

    def _needs_pilots(self, settings: Settings) -> bool:
        asked = settings.estimate or settings.gradient or settings.safety_filter
        pictured = settings.coverage_patch is not None
        commanded = len(self.external) == len(self.names)
        teamed = self.scenario.team is not None
        return bool(asked) or pictured or not commanded or teamed or uses_radio(self.scenario)

    def _chosen_pilots(self, chosen: Mapping[str, str], settings: Settings) -> ChosenPilots:
        external, shield = set(self.external), settings.safety_filter
        return ChosenPilots(self.scenario, self.uavs, self.ugvs, external, chosen, shield)

    def _arrays(self, rows: RowTables) -> tuple[LoopTables, LoopState]:
        """Return the tables and the state of all worlds, with these tables of the observation rows."""
        external = self.external
        action_row = [external.index(name) if name in external else -1 for name in self.names]
        tables = LoopTables(self.batch.tables, rows, np.array(action_row, dtype=np.int64))
        counters = certificate_counters(len(self.uavs))[None]
        state = LoopState(
            batch=self.batch.state,
            rows=row_state(rows, self.worlds),
            certificates=np.repeat(counters, self.worlds, axis=0),
            started=np.zeros(self.worlds, dtype=np.int64),
        )
        return tables, state

    @property
    def degraded(self) -> bool:
        """True if any link is imperfect."""
        return self.batch.links.degraded

    def begin(
        self, seeds: Sequence[int] | IntArray, worlds: Sequence[int] | IntArray | None = None
    ) -> None:
        """Begin new episodes.

        Args:
            seeds: One seed per world, from 0 to 2**53 - 1.
            worlds: Worlds to begin; all by default.
        """
        which = self.batch.restore(seeds, worlds)
        self._fresh.restore(which)
        if self._drawn is not None:
            self._drawn.begin(which, seeds, self._secret, self.pilots)
        if self.pilots is not None:
            self._begin_pilots(self.pilots.state, which, seeds)
        self._run(which, self._none, 1)

    def _begin_pilots(
        self, state: PilotState, worlds: IntArray, seeds: Sequence[int] | IntArray
    ) -> None:
        """Write the random keys of the pilots, and the random buildings of the UGVs' maps."""
        keys = self.state.batch.vehicles["keys"][worlds, :, PILOT]
        pilots = (
            (state.drivers, self.tables.batch.ugvs),
            (state.laws, self.tables.batch.escorts[:, 0]),
        )
        for memories, vehicles in pilots:
            for kind in memories.dtype.names or ():
                if "key_0" in (memories[kind].dtype.names or ()):
                    for word, name in enumerate(("key_0", "key_1")):
                        memories[kind][name][worlds] = keys[:, vehicles, word]
        grids = state.grids
        if grids and self.scenario.building_field and self.scenario.buildings.known:
            runs = zip(worlds.tolist(), seeds, strict=True)
            map_random_buildings(grids, self.scenario, runs, self._secret)

    def step(self, actions: FloatArray, worlds: IntArray | None = None) -> None:
        """Advance worlds by one tick.

        Args:
            actions: Finite accelerations of the vehicles in `external` [m/s²]: x, y, and z of UAVs that have an
                altitude; then the request for a role, see `sim.env.actions`. Shape (worlds, len(external),
                ACTION_COLUMNS).
            worlds: Worlds to advance; all by default.
        """
        self._run(self._all if worlds is None else worlds, actions, 1)

    def fly(self, ticks: int | None = None) -> None:
        """Fly every world to the end of its episode, or for a number of ticks.

        Raises:
            ValueError: If any vehicle has external actions.
        """
        if self.external:
            raise ValueError(
                f"external = {', '.join(self.external)}: these vehicles need actions; use step"
            )
        most = self.scenario.ticks if ticks is None else ticks
        if most > 0:
            self._run(self._all, self._none, most)

    def _run(self, worlds: IntArray, actions: FloatArray, ticks: int) -> None:
        which = np.ascontiguousarray(worlds, dtype=np.int64)
        given = np.ascontiguousarray(actions, dtype=np.float64)
        if self.batch.bodies is None:
            self._advance(which, given, ticks, WHOLE)
            return
        rows = self.state.rows
        for _ in range(ticks):
            self._advance(which, given, 1, BEGIN)
            self.batch.bodies.step(self.state.batch, which[self.state.started[which] != 0])
            self._advance(which, given, 1, END)
            which = which[(rows.terminated[which] | rows.truncated[which]) == 0]

    def _advance(self, worlds: IntArray, actions: FloatArray, ticks: int, part: int) -> None:
        """Call `run_worlds` in as many threads as are useful."""
        loop = self.tables, self.state, self.pilots, self.batch.ground
        given = worlds, actions, ticks, part
        self.batch.workers.share(run_worlds, len(worlds), *loop, *given)

    def metrics(self, uav: str) -> dict[str, FloatArray]:
        """Return the true metrics of a UAV's episode so far, in each world; arrays of shape (worlds,).

        `mean_error` is the mean of e(t) [m²] over the ticks so far, including the first; NaN if e(t) is not computed.
        `certified_while_lost` counts the certified ticks with the UGV out of sight.
        `certificate_broken` counts the ticks that it did not certify although the previous tick was certified and all
        assumptions held. Any count above zero is a fault of the certificate. `lost_without_clearance` counts the ticks
        that the filter certified with the UGV out of sight, while the UGV was nearer to a building than the filter may
        assume: they are not counted as certified. `tracking_exceeded` counts the ticks with an active safety filter in
        which the tracking error exceeded its declared bound. A UAV of a team also has the metrics of `TeamStatus`.
        """
        ticks, counts = self.state.batch.ticks, self.state.certificates[:, self.uavs.index(uav)]
        standings = self.state.rows.standings[:, self.names.index(uav)]
        watched = np.maximum(counts["ticks"], 1.0)
        counted = np.where(self.has_error, 1.0, np.nan)
        of_team: dict[str, FloatArray] = {}
        if self.pilots is not None:
            tables, state = self.pilots.tables.teams, self.pilots.state.teams
            if tables is not None and state is not None:
                of_team = team_metrics(tables, state, self.uavs.index(uav))
        return of_team | {
            "ticks": ticks.astype(np.float64),
            "distance": standings["distance"].copy(),
            "max_distance": standings["max_distance"].copy(),
            "visibility_violations": standings["violations"].astype(np.float64),
            "coverage_error": standings["error"] * counted,
            "mean_error": standings["error_sum"] / (ticks + 1) * counted,
            "overridden": counts["overridden"] / watched,
            "certified": counts["certified"] / watched,
            "certified_while_lost": counts["certified_while_lost"].astype(np.float64),
            "lost_without_clearance": counts["lost_without_clearance"].astype(np.float64),
            "certificate_broken": counts["broken"].astype(np.float64),
            "tracking_exceeded": counts["tracking_exceeded"].astype(np.float64),
        }

    def decisions(self, uav: str) -> RecordArray:
        """Return `FilterDecision` of a UAV's last tick, in each world. Shape (worlds,)."""
        if self.pilots is None:
            raise ValueError(f"uav = {uav!r}: no safety filter, so there are no decisions")
        rows: RecordArray = self.pilots.state.uavs.filter.decision[:, self.uavs.index(uav), 0]
        return rows

    def decision(self, uav: str) -> FilterDecision:
        """Return the decision on a UAV's action in the last tick, in the first world."""
        return decision_of(self.decisions(uav)[0])

    def mission(self, world: int) -> MissionResult:
        """Return the mission result of one world so far.

        Raises:
            ValueError: If there are no hazards.
        """
        if self.batch.ground is None:
            raise ValueError("the scenario has no hazards, so there is no mission")
        goal_rows, dt = self.tables.batch.goal_rows, self.scenario.dt
        return mission_of(goal_rows, self.batch.ground, world, dt, self.ugvs)

    def patch(self, uav: str) -> FloatArray:
        """Return the coverage patch of a UAV in each world. Shape (worlds, pixels, pixels)."""
        pictures: FloatArray = self._pilot_state.patches[:, self.uavs.index(uav)]
        return pictures

    def with_estimate(self, uav: str, rows: FloatArray) -> FloatArray:
        """Return a UAV's rows with the estimate in place of the raw detection, as in rows with the setting `estimate`.

        Args:
            uav: Name of the UAV.
            rows: Its rows in all worlds. Shape (worlds, entries).
        """
        if self.has_estimates:
            return rows
        now = self._pilot_state.kalman[:, self.uavs.index(uav), 0]
        known, shown = now["known"].astype(np.bool_), rows.copy()
        entry = {name: k for k, name in enumerate(names(UAV))}
        shown[known, entry["detected"]] = 1.0
        for axis in ("x", "y"):
            relative = rows[:, entry[axis]] - now[axis]
            shown[known, entry[f"relative_{axis}"]] = relative[known]
        shown[known, entry["age"]] = (now["age"] * self.scenario.dt)[known]
        return shown

    def team_rows(self, uav: str) -> FloatArray:
        """Return the team entries of a UAV's rows in all worlds. Shape (worlds, entries)."""
        teams = self._pilot_state.teams
        if teams is None:
            raise ValueError("the scenario has no teams")
        rows: FloatArray = teams.rows[:, self.uavs.index(uav)]
        return rows

    def known_tiles(self, ugv: str) -> TileArray:
        """Return a UGV's occupancy grid, from its sensor and by radio, in each world. Shape (worlds, rows, columns)."""
        grids = self._pilot_state.grids
        if grids is None:
            raise ValueError("the scenario has no hazards, so there are no tiles")
        tiles: TileArray = grids.tiles[:, self.ugvs.index(ugv)]
        return tiles

    @property
    def _pilot_state(self) -> PilotState:
        if self.pilots is None:
            raise ValueError("the environment has neither hazards nor coverage patches")
        return self.pilots.state

    def links(self, world: int) -> dict[str, LinkStatus]:
        """Return the counters of each link of one world so far, by `vehicle/kind`."""
        return self.batch.links.status(world)

    def scenario_of(self, world: int) -> Scenario:
        """Return the scenario of one world's episode, with the drawn values of randomized fields."""
        return self.scenario if self._drawn is None else self._drawn.scenarios[world]

    def drawn(self, vehicle: str | None = None) -> dict[str, FloatArray]:
        """Return the drawn values in all worlds by randomized field: all, or those that a vehicle may know."""
        return {} if self._drawn is None else self._drawn.values(vehicle)

    def close(self) -> None:
        """Stop the threads."""
        self.batch.workers.close()
