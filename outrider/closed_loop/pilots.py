"""Pilots of a closed loop: their laws and drivers, and the tables and the initial state of all worlds."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar, cast

import msgspec
import numpy as np

from agents.altitude_law import AltitudeMemory, AltitudeParameters, altitude_memory
from agents.drivers.compiled import briefed_grid, briefed_route, pending_rows
from agents.drivers.dispatch import CODES as DRIVER_CODES
from agents.drivers.dispatch import DriverTables, driver_memories, driver_tables
from agents.drivers.tile_map import OccupancyGrid
from agents.estimation.batch_filter import estimator_rows
from agents.estimation.map_updates import BLOCK_TILES, map_update_memory, map_update_ticks
from agents.estimation.motion_model import SPAN, KalmanParameters, history_depth
from agents.estimation.own_map import own_map
from agents.laws.dispatch import CODES, law_memories, law_tables
from agents.laws.selection import SelectedLaw
from agents.safety.levels import bounds_of
from agents.safety.memory import filter_memory, track_ticks
from agents.team.records import TeamMemory, TeamParameters, team_memory
from agents.uav_constants import UavConstants, uav_constants
from agents.uav_parameters import UavParameters, uav_parameters
from agents.uav_tick import UavMemory
from bus.errors import ScenarioError
from bus.messages.links import LinkKind
from bus.messages.scenario import Law
from bus.messages.vehicle import UavBriefing, UgvBriefing
from bus.registry import DEFAULT_DRIVER, DRIVERS, EXTERNAL, LAWS
from bus.ticks import radio_ticks
from outrider.closed_loop.arrays import PilotParameters, Pilots, PilotState, PilotTables
from outrider.closed_loop.teams import team_state, team_tables
from sim.channel.link_records import no_packets
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray, fresh, record_type
from sim.engine.batch import Batch
from sim.engine.briefing import uav_briefing, ugv_briefing
from sim.engine.world_state import joined
from sim.env.patch import given_patch
from sim.env.settings import Settings
from sim.models.safety import SafetyBounds
from sim.scenario.types import Scenario

_Memory = TypeVar("_Memory")


def _repeated(memory: _Memory, worlds: int, of_each: int | None = None) -> _Memory:
    """Return the memories of vehicles in many worlds, as copies of one.

    Args:
        memory: Array, None, or a named tuple of such memories.
        worlds, of_each: Sizes of the axes added in front of each array: worlds, and vehicles per world unless it is
            None.
    """
    one: Any = memory
    many: Any = None
    if hasattr(one, "_make"):
        many = one._make(_repeated(part, worlds, of_each) for part in one)
    elif one is not None:
        axes = (worlds,) if of_each is None else (worlds, of_each)
        many = np.broadcast_to(one, (*axes, *one.shape)).copy()
    return cast("_Memory", many)


def pilot_names(scenario: Scenario, vehicle: str) -> tuple[str, ...]:
    """Return the names of the laws or drivers that can control a vehicle in batches."""
    if any(uav.name == vehicle for uav in scenario.uav):
        return tuple(CODES)
    return tuple(DRIVER_CODES)


def uses_radio(scenario: Scenario, drivers: Sequence[str] = ()) -> bool:
    """Return whether any UGV uses the UAVs' radio: for map updates on ground with hazards, or for its driver.

    Args:
        scenario: Scenario.
        drivers: Names of further drivers in use.
    """
    own = [ugv.driver for ugv in scenario.ugv]
    return scenario.has_ground or any(DRIVERS[driver].listens for driver in (*own, *drivers))


def drivers_in_control(
    scenario: Scenario, external: Collection[str], pilots: Mapping[str, str]
) -> dict[str, str]:
    """Return the driver in control of each UGV, `EXTERNAL` for external actions.

    Args:
        scenario: The scenario.
        external: Vehicles with external actions.
        pilots: Laws and drivers chosen instead of the scenario's, by vehicle.
    """
    return {
        ugv.name: EXTERNAL if ugv.name in external else pilots.get(ugv.name, ugv.driver)
        for ugv in scenario.ugv
    }


def _constants(briefings: Sequence[UavBriefing], most_levels: int, in_space: bool) -> UavConstants:
    """Return the constants of all UAVs in one world. Shape (1, UAVs, ...)."""
    each = [uav_constants(one) for one in briefings]

    def table(name: str, kind: type) -> RecordArray:
        none = np.zeros(0, record_type(kind))
        return np.concatenate([none, *(getattr(one, name) for one in each)])[None]

    levels, altitude = None, None
    if in_space:
        rows = [one.safety if one.levels is None else one.levels for one in each]
        levels = np.zeros((1, len(each), max(most_levels, *map(len, rows))), rows[0].dtype)
        altitude = np.zeros((1, len(each)), record_type(AltitudeParameters))
        for k, (one, own) in enumerate(zip(each, rows, strict=True)):
            levels[0, k], levels["floor"][0, k] = own[-1], math.inf
            levels[0, k, : len(own)] = own
            if one.altitude is not None:
                altitude[0, k] = one.altitude[0]
    return UavConstants(
        uav=table("uav", UavParameters),
        kalman=table("kalman", KalmanParameters),
        safety=table("safety", SafetyBounds),
        levels=levels,
        altitude=altitude,
        team=table("team", TeamParameters) if any(one.team is not None for one in each) else None,
    )


def _team_memories(
    briefings: Sequence[UavBriefing], own_maps: Sequence[FloatArray]
) -> TeamMemory | None:
    """Return the memories of all UAVs in their teams; None: there are no teams. Shape (UAVs, ...)."""
    most = max((len(one.mates) for one in briefings), default=0)
    each = [
        memory
        for one, coverage in zip(briefings, own_maps, strict=False)
        if (memory := team_memory(one, coverage, most)) is not None
    ]
    if not each:
        return None
    # each memory has one row of `own`, which is the row of its UAV here
    parts = {name: np.stack([getattr(one, name) for one in each]) for name in TeamMemory._fields}
    return TeamMemory(**parts | {"own": parts["own"][:, 0]})


class OwnTables(NamedTuple):
    """Tables of `PilotTables` that may differ between worlds, with one row for one world."""

    uavs: UavConstants
    monitored: RecordArray
    drivers: DriverTables
    late: IntArray


class ChosenPilots:
    """Laws and drivers of all vehicles, and their arrays.

    Args:
        scenario: Scenario of all worlds.
        uavs, ugvs: Names of the vehicles, in the order of the tables.
        external: Vehicles with external actions.
        chosen: Laws and drivers chosen instead of the scenario's, by vehicle.
        shield: True if the actions of external UAVs pass the safety filter.

    Raises:
        ScenarioError: If a vehicle has a law or a driver that cannot be compiled.
    """

    def __init__(
        self,
        scenario: Scenario,
        uavs: Sequence[str],
        ugvs: Sequence[str],
        external: set[str],
        chosen: Mapping[str, str],
        shield: bool,
    ) -> None:
        self._scenario, self._uavs, self._ugvs = scenario, uavs, ugvs
        self._driven = drivers_in_control(scenario, external, chosen)
        never_asked = dict.fromkeys(uavs, "tracking") | dict.fromkeys(ugvs, DEFAULT_DRIVER)
        self._pilots = {**chosen, **{name: never_asked[name] for name in external}}
        self._laws = self.check_laws(scenario)
        outside = np.array([name in external for name in uavs], dtype=np.bool_)
        watched = np.array([LAWS[law.name].watched for law in self._laws], dtype=np.bool_)
        self.filtered = watched & ~outside | outside & shield | (scenario.team is not None)
        """True for each UAV with an active safety filter; in a team, its role decides. Shape (UAVs,)."""
        self._estimating = ~outside

    def _briefings(self, scenario: Scenario) -> tuple[list[UavBriefing], list[UgvBriefing]]:
        return (
            [uav_briefing(scenario, name, 0, drivers=self._driven) for name in self._uavs],
            [ugv_briefing(scenario, name, 0) for name in self._ugvs],
        )

    def _drivers(self, briefings: Sequence[UgvBriefing]) -> list[str]:
        return [self._pilots.get(one.vehicle) or one.driver for one in briefings]

    def own_tables(self, scenario: Scenario, most_levels: int = 0) -> OwnTables:
        """Return the tables of a scenario that may differ from the common one in numbers only.

        Args:
            scenario: The scenario.
            most_levels: Smallest number of rows in `UavConstants.levels`.
        """
        uavs, ugvs = self._briefings(scenario)
        late = np.array([[pending_rows(one) for one in ugvs]], dtype=np.int64)
        drivers = driver_tables(ugvs, self._drivers(ugvs))
        constants = _constants(uavs, most_levels, scenario.has_altitude)
        return OwnTables(constants, constants.safety.copy(), drivers, late)

    def check_laws(self, scenario: Scenario) -> list[Law]:
        """Return the law of each UAV in a scenario.

        Raises:
            ScenarioError: If a law cannot be compiled, or does not fit the scenario.
        """
        briefings, pilots = self._briefings(scenario)[0], self._pilots
        laws = [self._law(one, pilots.get(one.vehicle)) for one in briefings]
        for one, law in zip(briefings, laws, strict=True):
            named = getattr(scenario.custom, LAWS[law.name].inner, "")
            if named and one.vehicle not in pilots:
                raise ScenarioError(
                    f"{one.vehicle}: uav_policy = {named!r}: not supported in batches; allowed: no policy, "
                    "or the policy itself in `others`"
                )
        return laws

    @staticmethod
    def _law(briefing: UavBriefing, name: str | None) -> Law:
        law = briefing.law if name is None else msgspec.structs.replace(briefing.law, name=name)
        if law.name in LAWS and LAWS[law.name].own:
            raise ScenarioError(
                f"{briefing.vehicle}: law.name = {law.name!r}: a user's function cannot compile; allowed: others"
            )
        SelectedLaw(briefing, law, uav_parameters(briefing))  # raises if the law does not fit
        return law

    def pilots(self, batch: Batch, settings: Settings, own: OwnTables) -> Pilots:
        """Return the pilots of all worlds, in their initial state.

        Args:
            batch: The worlds.
            settings: Settings of the environment.
            own: Tables with one row for all worlds, or with one for each.
        """
        tables = self._tables(batch, settings, own)
        return Pilots(tables, self._state(batch, settings, tables))

    def _tables(self, batch: Batch, settings: Settings, own: OwnTables) -> PilotTables:
        scenario, (_, briefings) = self._scenario, self._briefings(self._scenario)
        dt, ground, patch = scenario.dt, scenario.ground, given_patch(settings.coverage_patch)
        parameters = PilotParameters(
            estimate=bool(settings.estimate),
            gradient=bool(settings.gradient),
            own_maps=len(scenario.uav) > 1
            or scenario.disturbed
            or scenario.has_altitude
            or scenario.team is not None,
            radio=uses_radio(scenario, self._drivers(briefings)),
            radio_ticks=radio_ticks(dt),
            map_update_ticks=map_update_ticks(ground.map_update_rate, dt)
            if scenario.has_ground
            else 0,
            tile=float(ground.tile) if scenario.has_ground else 0.0,
            meters_per_pixel=float(patch.meters_per_pixel) if patch else 1.0,
        )
        needed = parameters.estimate or parameters.gradient or parameters.radio
        ugvs = {vehicle: k for k, vehicle in enumerate(batch.tables.ugvs.tolist())}
        scripts, script_rows = joined([briefed_route(one).script for one in briefings], 3)
        return PilotTables(
            **own._asdict(),
            parameters=parameters,
            laws=law_tables(self._laws),
            estimating=(self._estimating | needed).astype(np.int64),
            filtered=self.filtered.astype(np.int64),
            receivers=np.array(
                [ugvs[g] for g in batch.tables.escorts[:, 1].tolist()], dtype=np.int64
            ),
            scripts=scripts,
            script_rows=script_rows,
            teams=team_tables(batch, self._uavs),
        )

    def _state(self, batch: Batch, settings: Settings, tables: PilotTables) -> PilotState:
        scenario, worlds, parameters = self._scenario, batch.worlds, tables.parameters
        uavs, ugvs, area = len(self._uavs), len(self._ugvs), scenario.area
        room, tile_room = batch.links.packets.shape[3], 0
        if batch.ground is not None:
            tile_room = max(BLOCK_TILES, batch.ground.seen.shape[2])
        patch = given_patch(settings.coverage_patch)
        pixels = patch.pixels if patch else 1
        late = batch.links.longest(LinkKind.DETECTIONS)
        depth = history_depth(SPAN, scenario.dt)
        if scenario.team is None:  # measurements of team-mates may be older
            depth = min(late + 1, depth)
        state = PilotState(
            uavs=self._memories(batch, tables, late),
            laws=law_memories(tables.laws, worlds),
            kalman=_repeated(estimator_rows(depth), worlds, uavs),
            map_updates=_repeated(
                map_update_memory(area.width, area.height, parameters.tile), worlds, uavs
            ),
            outbox=no_packets(worlds, uavs, 2),
            patches=np.zeros((worlds, uavs if patch else 0, pixels, pixels)),
            drivers=driver_memories(tables.drivers, worlds),
            grids=None if batch.ground is None else self._grids(worlds),
            inboxes=np.zeros((worlds, ugvs, room * uavs if parameters.radio else 1, 3)),
            arrived=np.zeros((worlds, ugvs), dtype=np.int64),
            detections=np.zeros((worlds, room, 3)),
            positions=np.zeros((worlds, 2, tile_room), dtype=np.int64),
            states=np.zeros((worlds, tile_room), dtype=np.uint8),
            teams=team_state(batch, tables.teams, self._uavs),
        )
        state.outbox["stamp"] = -1.0
        return state

    def _memories(self, batch: Batch, tables: PilotTables, late: int) -> UavMemory:
        """Return the memory of all UAVs. `late`: longest delay of a detection [ticks]."""
        scenario, worlds, (briefings, _) = (
            self._scenario,
            batch.worlds,
            self._briefings(self._scenario),
        )
        safety = list(map(bounds_of, briefings))
        fresh_filter = filter_memory(
            max((bounds.delay_ticks for bounds in safety), default=0),
            min(late + 1, max(map(track_ticks, safety), default=1)),
        )
        own_maps = [own_map(one) for one in briefings] if tables.parameters.own_maps else []
        altitudes = [fresh(AltitudeMemory, (0,)), *map(altitude_memory, briefings)]
        return UavMemory(
            uav=_repeated(tables.uavs.uav[0], worlds),
            coverage=_repeated(np.array(own_maps), worlds)
            if own_maps
            else batch.state.coverage[:, None],
            altitude=_repeated(np.concatenate(altitudes), worlds)
            if scenario.has_altitude
            else None,
            filter=_repeated(fresh_filter, worlds, len(briefings)),
            team=_repeated(_team_memories(briefings, own_maps), worlds),
        )

    def _grids(self, worlds: int) -> OccupancyGrid:
        """Return the occupancy grids of all UGVs; each has as many rows of commands as the longest delay requires."""
        grids = [briefed_grid(one) for one in self._briefings(self._scenario)[1]]
        memories = _repeated(max(grids, key=lambda memory: len(memory.sent)), worlds, len(grids))
        for n, memory in enumerate(grids):
            _enter(memories, (slice(None), n), memory)
        return memories


def _enter(grids: OccupancyGrid, row: tuple[slice | int, int], memory: OccupancyGrid) -> None:
    """Copy the initial tiles of a UGV."""
    grids.tiles[row], grids.reported[row] = memory.tiles, memory.reported
    grids.blocked[row], grids.unseen[row] = memory.blocked, memory.unseen
    grids.measured[row], grids.flags[row] = memory.measured, memory.flags


def map_random_buildings(
    grids: OccupancyGrid, scenario: Scenario, runs: Iterable[tuple[int, int]], secret: str
) -> None:
    """Enter the buildings of runs with fields of buildings, which differ with the seed, into the UGVs' grids.

    Args:
        grids: Grids of all UGVs in all worlds; changed.
        scenario: Scenario of all worlds.
        runs: World and seed of each run.
        secret: Common secret of the runs.
    """
    names = sorted(ugv.name for ugv in scenario.ugv)
    for world, seed in runs:
        for n, name in enumerate(names):
            memory = briefed_grid(ugv_briefing(scenario, name, int(seed), secret))
            _enter(grids, (world, n), memory)
