"""Views of one vehicle's part of the loop's state, in the form that the pilots' functions take."""

from agents.drivers.tile_map import OccupancyGrid
from agents.safety.memory import FilterMemory
from agents.safety.pending import PendingCommands
from sim.compiling.compile import FloatArray, compiled, inlined
from sim.compiling.dispatch import unless_none
from sim.engine.world_state import Vehicle
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
