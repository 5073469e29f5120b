"""Views of one vehicle's part of the loop's state, in the form that the pilots' functions take."""

from agents.drivers.tile_map import OccupancyGrid
from agents.safety.memory import FilterMemory
from agents.safety.pending import PendingCommands
from outrider.envs.closed_loop_state import LoopParameters, LoopState, LoopTables
from sim.compiling.compile import FloatArray, compiled, inlined
from sim.engine.world_state import Vehicle
from sim.models.vehicles import Motion


@inlined
def filter_of(tables: LoopTables, filters: FilterMemory, world: int, uav: int) -> FilterMemory:
    """Return the memory of a UAV's safety filter."""
    delay, pending = tables.safety[uav].delay_ticks, filters.pending
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


@inlined
def grid_of(tables: LoopTables, state: LoopState, world: int, ugv: int) -> OccupancyGrid:
    """Return the occupancy grid of a UGV."""
    grids = state.grids
    return OccupancyGrid(
        grids.tiles[world, ugv],
        grids.measured[world, ugv],
        grids.snapshot[world, ugv],
        grids.path[world, ugv],
        grids.cost[world, ugv],
        grids.heap[world, ugv],
        grids.place[world, ugv],
        grids.sent[world, ugv, : tables.late[ugv]],
        grids.committed[world, ugv],
        grids.flags[world, ugv],
    )


@inlined
def coverage_of(parameters: LoopParameters, state: LoopState, world: int, uav: int) -> FloatArray:
    """Return the coverage grid of a UAV: its own, or its world's."""
    coverage: FloatArray = (
        state.maps[world, uav] if parameters.own_maps else state.batch.coverage[world]
    )
    return coverage


@compiled
def reference_of(vehicle: Vehicle) -> Motion:
    """Return the reference state of a vehicle."""
    place, velocity = vehicle.reference_position, vehicle.reference_velocity
    return Motion(place[0], place[1], velocity[0], velocity[1])
