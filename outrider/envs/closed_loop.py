"""Closed loop in many worlds at once.

One compiled pass computes a tick: world, links, filters, laws, drivers and rewards.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from agents.drivers.dispatch import driver_memories
from agents.estimation.batch_filter import estimator_rows
from agents.estimation.map_updates import BLOCK_TILES, map_update_memory
from agents.estimation.motion_model import (
    SPAN,
    history_depth,
)
from agents.laws.dispatch import law_memories
from agents.safety.memory import filter_memory
from agents.safety.safety_filter import decision_of
from bus.messages.decision import FilterDecision
from bus.messages.links import LinkKind, LinkStatus
from bus.messages.telemetry import MissionResult
from bus.observations import UAV, names
from outrider.envs.closed_loop_state import (
    CommandedState,
    CommandedTables,
    LoopParameters,
    LoopState,
    LoopTables,
    commanded,
)
from outrider.envs.closed_loop_tick import run_worlds
from outrider.envs.drawn_worlds import DrawnWorlds, own_tables
from outrider.envs.initial_grids import grids_of, map_random_buildings
from outrider.envs.pilot_numbers import (
    PilotNumbers,
    drivers_in_control,
    loop_parameters,
    repeated,
    uses_radio,
)
from sim.channel.link_records import no_packets
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray
from sim.engine.batch import Batch, Fresh
from sim.engine.ground_state import set_driver
from sim.engine.mission import mission_of
from sim.engine.run_keys import check_secret
from sim.engine.world_state import joined
from sim.env.patch import CoveragePatch, given_patch
from sim.env.randomization import Randomization
from sim.env.rows import row_tables
from sim.env.settings import Settings, settings_of
from sim.models.ground import TileArray
from sim.models.randomness import PILOT
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
        ScenarioError: If a vehicle has a law or a driver that cannot be compiled.
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
        self.parameters: LoopParameters | None = None
        """Parameters of the pilots; None if all actions are external and no other feature is needed."""
        self.tables: LoopTables | CommandedTables
        self.state: LoopState | CommandedState
        self.tables, self.state = commanded(
            scenario, self.batch, self.external, row_tables(scenario, options, error=error)
        )
        self.has_error = bool(self.tables.rows.episode["error"][0])
        """True if e(t) is computed at every tick."""
        numbers = self._add_pilots(chosen, options) if self._needs_pilots(options) else None
        self._drawn: DrawnWorlds | None = None
        if self.randomization:
            self._drawn = DrawnWorlds(self.randomization, given, self.batch, numbers)
        # the batch restores its own state
        self._fresh = Fresh(self.state[1:])
        self._all = np.arange(worlds)
        self._none = np.zeros((worlds, 0, 3))
        self.begin([scenario.seed], [0])

    def _batch_of(self, settings: Settings) -> Batch:
        """Return the batch of worlds."""
        return Batch(
            self.scenario,
            self.worlds,
            gains=settings.rewards.seen > 0.0,
            threads=settings.threads,
            secret=self._secret,
            others=(LinkKind.RADIO,),
            differ=self.randomization is not None,
        )

    def _needs_pilots(self, settings: Settings) -> bool:
        asked = settings.estimate or settings.gradient or settings.safety_filter
        pictured = settings.coverage_patch is not None
        commanded = len(self.external) == len(self.names)
        return bool(asked) or pictured or not commanded or uses_radio(self.scenario)

    def _add_pilots(self, chosen: Mapping[str, str], settings: Settings) -> PilotNumbers:
        """Add the tables and the state of pilots, estimates and coverage patches; return the pilots' numbers."""
        numbers = PilotNumbers(
            self.scenario, self.uavs, self.ugvs, set(self.external), chosen, settings.safety_filter
        )
        parameters = loop_parameters(self.scenario, settings, radio=numbers.radio)
        self.parameters = parameters
        self.tables = self._pilot_tables(numbers, parameters)
        self.state = self._pilot_state(numbers, parameters, given_patch(settings.coverage_patch))
        return numbers

    def _pilot_tables(self, numbers: PilotNumbers, parameters: LoopParameters) -> LoopTables:
        needed = parameters.estimate or parameters.gradient or parameters.radio
        scripts, script_rows = joined(numbers.scripts, 3)
        return LoopTables(
            **self.tables._asdict(),
            **own_tables(numbers, self.scenario, self.worlds if self.randomization else None),
            laws=numbers.laws,
            estimating=(numbers.estimating | needed).astype(np.int64),
            filtered=numbers.filtered.astype(np.int64),
            receivers=np.array(
                [self.ugvs.index(self.names[g]) for g in self.batch.tables.escorts[:, 1]],
                dtype=np.int64,
            ),
            scripts=scripts,
            script_rows=script_rows,
        )

    def _pilot_state(
        self, numbers: PilotNumbers, parameters: LoopParameters, patch: CoveragePatch | None
    ) -> LoopState:
        worlds, batch, area = self.worlds, self.batch, self.scenario.area
        late = batch.links.longest(LinkKind.DETECTIONS)
        depth = min(late + 1, history_depth(SPAN, self.scenario.dt))
        fresh = filter_memory(numbers.longest, min(late + 1, numbers.track))
        uavs, ugvs = len(self.uavs), len(self.ugvs)
        room = batch.links.packets.shape[3]
        tile_room = 0
        if batch.ground is not None:
            tile_room = max(BLOCK_TILES, batch.ground.seen.shape[2])
        map_updates = map_update_memory(area.width, area.height, parameters.tile)
        pixels = patch.pixels if patch else 1
        state = LoopState(
            **self.state._asdict(),
            maps=repeated(numbers.maps, worlds, 1)[:, 0]
            if parameters.own_maps
            else batch.state.coverage[:, None],
            uavs=repeated(numbers.laws.uavs, worlds, 1)[:, 0],
            heights=repeated(numbers.climbs, worlds, 1)[:, 0],
            laws=law_memories(numbers.laws, worlds),
            drivers=driver_memories(numbers.own.drivers, worlds),
            kalman=repeated(estimator_rows(depth), worlds, uavs),
            filters=repeated(fresh, worlds, uavs),
            grids=None if batch.ground is None else grids_of(numbers.grids, worlds),
            outbox=no_packets(worlds, uavs, 2),
            detections=np.zeros((worlds, room, 3)),
            inboxes=np.zeros((worlds, ugvs, room * uavs if parameters.radio else 1, 3)),
            arrived=np.zeros((worlds, ugvs), dtype=np.int64),
            patches=np.zeros((worlds, uavs if patch else 0, pixels, pixels)),
            map_updates=repeated(map_updates, worlds, uavs),
            places=np.zeros((worlds, 2, tile_room), dtype=np.int64),
            states=np.zeros((worlds, tile_room), dtype=np.uint8),
        )
        state.outbox["stamp"] = -1.0
        return state

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
            self._drawn.begin(which, seeds, self._secret, (self.tables, self.state))
        if isinstance(self.state, LoopState):
            keys = self.state.batch.vehicles["keys"][which, :, PILOT]
            pilots = (
                (self.state.drivers, self.tables.batch.ugvs),
                (self.state.laws, self.tables.batch.escorts[:, 0]),
            )
            for memories, vehicles in pilots:
                for kind in memories.dtype.names or ():
                    if "key_0" in (memories[kind].dtype.names or ()):
                        for word, name in enumerate(("key_0", "key_1")):
                            memories[kind][name][which] = keys[:, vehicles, word]
            grids = self.state.grids
            if grids and self.scenario.building_field and self.scenario.buildings.known:
                map_random_buildings(
                    grids,
                    self.scenario,
                    zip(which.tolist(), seeds, strict=True),
                    self._secret,
                )
        self._run(which, self._none, 0)

    def step(self, actions: FloatArray, worlds: IntArray | None = None) -> None:
        """Advance worlds by one tick.

        Args:
            actions: Finite accelerations of the vehicles in `external` [m/s²]: x, y, and z of UAVs that have an
                altitude. Shape (worlds, len(external), 3).
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
        loop = self.parameters, self.tables, self.state, self.batch.ground
        self.batch.workers.share(run_worlds, len(worlds), *loop, which, given, ticks)

    def metrics(self, uav: str) -> dict[str, FloatArray]:
        """Return the true metrics of a UAV's episode so far, in each world; arrays of shape (worlds,).

        `mean_error` is the mean of e(t) [m²] over the ticks so far, including the first; NaN if e(t) is not computed.
        `certified_while_lost` counts the certified ticks with the UGV out of sight.
        `certificate_broken` counts the ticks that it did not certify although the previous tick was certified and all
        assumptions held. Any count above zero is a fault of the certificate. `lost_without_clearance` counts the ticks
        that the filter certified with the UGV out of sight, while the UGV was nearer to a building than the filter may
        assume: they are not counted as certified.
        """
        ticks, counts = self.state.batch.ticks, self.state.certificates[:, self.uavs.index(uav)]
        standings = self.state.rows.standings[:, self.names.index(uav)]
        watched = np.maximum(counts["ticks"], 1.0)
        counted = np.where(self.has_error, 1.0, np.nan)
        return {
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
        }

    def decisions(self, uav: str) -> RecordArray:
        """Return `FilterDecision` of a UAV's last tick, in each world. Shape (worlds,)."""
        if not isinstance(self.state, LoopState):
            raise ValueError(f"uav = {uav!r}: no safety filter, so there are no decisions")
        rows: RecordArray = self.state.filters.decision[:, self.uavs.index(uav), 0]
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
        pictures: FloatArray = self._pilots.patches[:, self.uavs.index(uav)]
        return pictures

    def with_estimate(self, uav: str, rows: FloatArray) -> FloatArray:
        """Return a UAV's rows with the estimate in place of the raw detection, as in rows with the setting `estimate`.

        Args:
            uav: Name of the UAV.
            rows: Its rows in all worlds. Shape (worlds, entries).
        """
        if self.has_estimates:
            return rows
        now = self._pilots.kalman[:, self.uavs.index(uav), 0]
        known, shown = now["known"].astype(np.bool_), rows.copy()
        entry = {name: k for k, name in enumerate(names(UAV))}
        shown[known, entry["detected"]] = 1.0
        for axis in ("x", "y"):
            relative = rows[:, entry[axis]] - now[axis]
            shown[known, entry[f"relative_{axis}"]] = relative[known]
        shown[known, entry["age"]] = (now["age"] * self.scenario.dt)[known]
        return shown

    def known_tiles(self, ugv: str) -> TileArray:
        """Return a UGV's occupancy grid, from its sensor and by radio, in each world. Shape (worlds, rows, columns)."""
        grids = self._pilots.grids
        if grids is None:
            raise ValueError("the scenario has no hazards, so there are no tiles")
        tiles: TileArray = grids.tiles[:, self.ugvs.index(ugv)]
        return tiles

    @property
    def _pilots(self) -> LoopState:
        if not isinstance(self.state, LoopState):
            raise ValueError("the environment has neither hazards nor coverage patches")
        return self.state

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
