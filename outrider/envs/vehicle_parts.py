"""Views of one vehicle's part of the loop's state, in the form that the pilots' functions take."""

from agents.drivers.tile_map import GroundMemory
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
            pending.flown[world, uav],
            pending.expected[world, uav],
        ),
        filters.decision[world, uav],
    )


@inlined
def ground_of(tables: LoopTables, state: LoopState, world: int, ugv: int) -> GroundMemory:
    """Return the occupancy grid of a UGV."""
    grounds = state.grounds
    return GroundMemory(
        grounds.tiles[world, ugv],
        grounds.sure[world, ugv],
        grounds.draft[world, ugv],
        grounds.way[world, ugv],
        grounds.cost[world, ugv],
        grounds.heap[world, ugv],
        grounds.place[world, ugv],
        grounds.sent[world, ugv, : tables.late[ugv]],
        grounds.flown[world, ugv],
        grounds.flags[world, ugv],
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
