"""Views of one vehicle's part of the loop's state, in the form that the pilots' functions take."""

from agents.drivers.tile_map import OccupancyGrid
from agents.safety.memory import FilterMemory
from agents.safety.pending import PendingCommands
from agents.uav_inputs import KnownBuildings, UavInputs
from agents.uav_tick import UavMemory
from outrider.envs.closed_loop_state import HeightTables, LoopState, LoopTables
from sim.compiling.compile import FloatArray, compiled, inlined
from sim.compiling.dispatch import unless_none
from sim.compiling.records import RecordArray, row_of
from sim.engine.space_state import TownState
from sim.engine.world_state import Vehicle
from sim.models.altitude import VerticalMotion
from sim.models.safety import SafetyBounds
from sim.models.vehicles import Motion


@inlined
def filter_of(filters: FilterMemory, bounds: SafetyBounds, world: int, uav: int) -> FilterMemory:
    """Return the memory of a UAV's safety filter."""
    delay, pending = bounds.delay_ticks, filters.pending
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
    )


@unless_none
@compiled
def grid_of(grids: OccupancyGrid, late: int, world: int, ugv: int) -> OccupancyGrid:
    """Return the occupancy grid of a UGV, with this number of pending commands; None without ground."""
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
        grids.place[world, ugv],
        grids.sent[world, ugv, :late],
        grids.committed[world, ugv],
        grids.flags[world, ugv],
    )


@compiled
def map_of(maps: FloatArray, world: int, uav: int) -> FloatArray:
    """Return the map of a UAV, which may be common to all UAVs of its world."""
    own: FloatArray = maps[world, min(uav, maps.shape[1] - 1)]
    return own


@compiled
def reference_of(vehicle: Vehicle) -> Motion:
    """Return the reference state of a vehicle."""
    place, velocity = vehicle.reference_position, vehicle.reference_velocity
    return Motion(place[0], place[1], velocity[0], velocity[1])


@unless_none
@compiled
def _vertical_of(heights: HeightTables, vehicle: Vehicle) -> VerticalMotion:
    return vehicle.vertical


@unless_none
@compiled
def camera_of(heights: HeightTables, world: int, uav: int) -> RecordArray:
    """Return camera and altitude law of a UAV. Shape (1,); None if all UAVs fly in the plane."""
    row = row_of(heights.laws.shape[0], world)
    return heights.laws[row, uav : uav + 1]


@unless_none
@compiled
def levels_of(heights: HeightTables, world: int, uav: int) -> RecordArray:
    """Return the bounds of a UAV's filter by increasing floor; None if all UAVs fly in the plane."""
    levels: RecordArray = heights.levels[row_of(heights.levels.shape[0], world), uav]
    return levels


@unless_none
@compiled
def _buildings_of(town: TownState, world: int, uav: int) -> KnownBuildings:
    return KnownBuildings(town.seen[world, uav], town.corners[world], town.found[world, uav])


@inlined
def inputs_of(
    tables: LoopTables, state: LoopState, world: int, uav: int, elapsed: int
) -> UavInputs:
    """Return the state and the messages of a UAV in this tick: views, no copies."""
    batch, vehicle = state.batch, tables.batch.escorts[uav, 0]
    one = batch.vehicles[world, vehicle]
    return UavInputs(
        batch.ticks[world],
        elapsed,
        reference_of(one),
        _vertical_of(tables.heights, one),
        batch.flown[world, vehicle, 0].begins,
        state.detections[world],
        batch.links[world, uav].arrived,
        _buildings_of(batch.town, world, uav),
    )


@inlined
def memory_of(tables: LoopTables, state: LoopState, world: int, uav: int) -> UavMemory:
    """Return the memory of a UAV: views, no copies."""
    bounds = tables.safety[row_of(tables.safety.shape[0], world), uav]
    return UavMemory(
        state.uavs[world, uav : uav + 1],
        map_of(state.maps, world, uav),
        state.heights[world, uav : uav + 1],
        filter_of(state.filters, bounds, world, uav),
    )
