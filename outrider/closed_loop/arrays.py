"""Arrays of the closed loop: constants and state of all worlds, and views of one vehicle's part of them."""

from typing import NamedTuple

from agents.drivers.dispatch import ChosenDriver, DriverTables
from agents.drivers.tile_map import OccupancyGrid
from agents.estimation.map_updates import MapUpdateMemory
from agents.laws.dispatch import FlownLaw, LawTables
from agents.safety.memory import FilterMemory
from agents.safety.pending import PendingCommands
from agents.uav_constants import UavConstants
from agents.uav_inputs import KnownBuildings, UavInputs
from agents.uav_tick import UavMemory
from outrider.closed_loop.teams import (
    TeamState,
    TeamTables,
    team_inputs_of,
    team_memory_of,
)
from sim.compiling.compile import FloatArray, IntArray, compiled, inlined
from sim.compiling.dispatch import unless_none
from sim.compiling.records import RecordArray, row_of
from sim.engine.space_state import TownState, TownTables, building_rows
from sim.engine.world_state import BatchState, BatchTables, Vehicle
from sim.env.rows import RowState, RowTables
from sim.models.altitude import VerticalState
from sim.models.ground import TileArray
from sim.models.vehicles import State


class LoopTables(NamedTuple):
    """Constants of all worlds."""

    batch: BatchTables
    rows: RowTables
    action_row: IntArray
    """Row of each vehicle in the external actions; -1: it has a pilot. Shape (vehicles,)."""


class LoopState(NamedTuple):
    """State of all worlds. All arrays have an axis for worlds in front."""

    batch: BatchState
    rows: RowState
    """Metrics and observation rows."""
    certificates: RecordArray
    """`CertificateCounters` of each UAV. Shape (worlds, UAVs)."""
    started: IntArray
    """1 after the first tick of the episode, 0 after a reset. Shape (worlds,)."""


class PilotParameters(NamedTuple):
    """Switches and parameters of the pilots."""

    estimate: bool
    """True if the rows contain the estimate instead of the raw detection."""
    gradient: bool
    """True if the rows contain the coverage gradient."""
    own_maps: bool
    """True if each UAV has its own map; otherwise the world's coverage serves as its map."""
    radio: bool
    """True if any UGV uses the radio."""
    radio_ticks: int
    map_update_ticks: int
    """Period of the map updates [ticks]; 0: never, without ground."""
    tile: float
    """Width of a tile [m]; 0 without ground."""
    meters_per_pixel: float


class PilotTables(NamedTuple):
    """Constants of the pilots.

    Some have one row for all worlds, or one for each if the worlds differ, as in `BatchTables`.
    """

    parameters: PilotParameters
    uavs: UavConstants
    """Constants of the UAVs. Shape (1 or worlds, UAVs, ...)."""
    laws: LawTables
    estimating: IntArray
    """1 for each UAV whose estimate is needed. Shape (UAVs,)."""
    filtered: IntArray
    """1 for each UAV with an active safety filter. Shape (UAVs,)."""
    receivers: IntArray
    """Index of the UGV that receives each UAV's radio. Shape (UAVs,)."""
    monitored: RecordArray
    """`SafetyBounds` by which the simulator counts each UAV's certificates. Shape (1 or worlds, UAVs)."""
    drivers: DriverTables
    scripts: FloatArray
    script_rows: IntArray
    late: IntArray
    """Rows of pending commands of each UGV: its command delay in ticks, plus 2. Shape (1 or worlds, UGVs)."""
    teams: TeamTables | None
    """None: there are no teams."""


class PilotState(NamedTuple):
    """State of the pilots in all worlds. All arrays have an axis for worlds in front."""

    uavs: UavMemory
    """Memory of the UAVs. Shape (worlds, UAVs, ...); `coverage` has one map, the world's, if they do not differ."""
    laws: RecordArray
    """Memories of the laws, nested by law. Shape (worlds, UAVs)."""
    kalman: RecordArray
    """`EstimatorRow` of each UAV. Shape (worlds, UAVs, 1 + depth): see `agents.estimation.batch_filter`."""
    map_updates: MapUpdateMemory
    """Map and transmission state of each UAV. Shape (worlds, UAVs, ...)."""
    outbox: RecordArray
    """`Packet`: radio messages just sent by each UAV, with its relative position and with a map update.

    Shape (worlds, UAVs, 2).
    """
    patches: FloatArray
    """Coverage patches of the UAVs. Shape (worlds, UAVs or 0, pixels, pixels)."""
    drivers: RecordArray
    """Memories of the drivers, nested by driver. Shape (worlds, UGVs)."""
    grids: OccupancyGrid | None
    """Occupancy grid of each UGV; None without ground. Shape (worlds, UGVs, ...)."""
    inboxes: FloatArray
    """Radio messages with the relative position received by each UGV in this tick: tick, p_delta [m].

    Shape (worlds, UGVs, room, 3).
    """
    arrived: IntArray
    """Number of valid rows of `inboxes`. Shape (worlds, UGVs)."""
    detections: FloatArray
    """Work array for the detections received by one UAV: tick, p_delta [m]. Shape (worlds, room, 3)."""
    positions: IntArray
    states: TileArray
    """Work arrays for tiles reported to a UGV: indices and states. Shapes (worlds, 2, room), (worlds, room)."""
    teams: TeamState | None
    """None: there are no teams."""


class Pilots(NamedTuple):
    """Pilots, estimates and coverage patches of all worlds."""

    tables: PilotTables
    state: PilotState


@inlined
def _filter_of(filters: FilterMemory, delay: int, world: int, uav: int) -> FilterMemory:
    pending = filters.pending
    return FilterMemory(
        filters.discs[world, uav],
        filters.plan[world, uav],
        filters.track[world, uav],
        filters.flags[world, uav],
        PendingCommands(
            pending.sent[world, uav, : delay + 2],
            pending.committed[world, uav],
            pending.expected[world, uav],
        ),
        filters.decision[world, uav],
        filters.search[world, uav],
    )


@unless_none
@compiled
def _row(table: RecordArray, world: int, uav: int) -> RecordArray:
    """Return the row of a UAV as a table of one row; None if the table is None."""
    return table[row_of(table.shape[0], world), uav : uav + 1]


@unless_none
@compiled
def _rows(table: RecordArray, world: int, uav: int) -> RecordArray:
    """Return the rows of a UAV; None if the table is None."""
    rows: RecordArray = table[row_of(table.shape[0], world), uav]
    return rows


@inlined
def constants_of(tables: PilotTables, world: int, uav: int) -> UavConstants:
    """Return the constants of a UAV: views, no copies."""
    uavs = tables.uavs
    return UavConstants(
        _row(uavs.uav, world, uav),
        _row(uavs.kalman, world, uav),
        _row(uavs.safety, world, uav),
        _rows(uavs.levels, world, uav),
        _row(uavs.altitude, world, uav),
        _row(uavs.team, world, uav),
    )


@inlined
def memory_of(pilots: Pilots, world: int, uav: int) -> UavMemory:
    """Return the memory of a UAV: views, no copies."""
    uavs, safety = pilots.state.uavs, pilots.tables.uavs.safety
    delay = safety[row_of(safety.shape[0], world), uav].delay_ticks
    return UavMemory(
        uavs.uav[world, uav : uav + 1],
        map_of(uavs.coverage, world, uav),
        _row(uavs.altitude, world, uav),
        _filter_of(uavs.filter, delay, world, uav),
        team_memory_of(uavs.team, world, uav),
    )


@compiled
def law_of(pilots: Pilots, world: int, uav: int) -> FlownLaw:
    """Return the law of a UAV: views, no copies."""
    laws, one = pilots.tables.laws, slice(uav, uav + 1)
    return FlownLaw(laws.codes[uav], laws.parameters[one], pilots.state.laws[world, one])


@compiled
def driver_of(pilots: Pilots, world: int, ugv: int) -> ChosenDriver:
    """Return the driver of a UGV: views, no copies."""
    drivers, one = pilots.tables.drivers, slice(ugv, ugv + 1)
    row = row_of(drivers.ugvs.shape[0], world)
    return ChosenDriver(
        drivers.codes[ugv],
        drivers.ugvs[row, one],
        drivers.parameters[row, one],
        pilots.state.drivers[world, one],
    )


@unless_none
@compiled
def grid_of(grids: OccupancyGrid, late: IntArray, world: int, ugv: int) -> OccupancyGrid:
    """Return the occupancy grid of a UGV, with its number of pending commands; None without ground."""
    return OccupancyGrid(
        grids.tiles[world, ugv],
        grids.reported[world, ugv],
        grids.blocked[world, ugv],
        grids.unseen[world, ugv],
        grids.measured[world, ugv],
        grids.snapshot[world, ugv],
        grids.path[world, ugv],
        grids.cost[world, ugv],
        grids.heap[world, ugv],
        grids.heap_row[world, ugv],
        grids.sent[world, ugv, : late[row_of(late.shape[0], world), ugv]],
        grids.committed[world, ugv],
        grids.flags[world, ugv],
    )


@compiled
def map_of(maps: FloatArray, world: int, uav: int) -> FloatArray:
    """Return the map of a UAV, which may be common to all UAVs of its world."""
    chosen: FloatArray = maps[world, min(uav, maps.shape[1] - 1)]
    return chosen


@compiled
def reference_of(vehicle: Vehicle) -> State:
    """Return the reference state of a vehicle."""
    position, velocity = vehicle.reference_position, vehicle.reference_velocity
    return State(position[0], position[1], velocity[0], velocity[1])


@unless_none
@compiled
def _vertical_of(altitude: RecordArray, vehicle: Vehicle) -> VerticalState:
    """Return the altitude of a UAV; None if all UAVs fly in the plane."""
    return vehicle.vertical


@unless_none
@compiled
def _buildings_of(town: TownState, buildings: TownTables, world: int, uav: int) -> KnownBuildings:
    rows = building_rows(buildings, world)
    return KnownBuildings(rows, buildings.corners, town.known[world, uav], town.found[world, uav])


@inlined
def inputs_of(
    tables: LoopTables, state: LoopState, pilots: Pilots, world: int, uav: int, elapsed: int
) -> UavInputs:
    """Return the state and the messages of a UAV in this tick: views, no copies."""
    batch, vehicle = state.batch, tables.batch.escorts[uav, 0]
    one = batch.vehicles[world, vehicle]
    return UavInputs(
        batch.ticks[world],
        elapsed,
        reference_of(one),
        _vertical_of(pilots.tables.uavs.altitude, one),
        batch.flown[world, vehicle, 0].begins,
        pilots.state.detections[world],
        batch.links[world, uav].arrived,
        _buildings_of(batch.town, batch.buildings, world, uav),
        team_inputs_of(pilots.state.teams, world, uav),
    )
