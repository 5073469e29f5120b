"""Parts of the loop's state that belong to one vehicle, and its truth, as the pilots' functions take them."""

from agents.drivers.tile_map import GroundMemory
from agents.safety.decision import GuardState
from agents.safety.pending import Underway
from outrider.envs.closed_loop_state import LoopParameters, LoopState, LoopTables
from sim.compiling.compile import FloatArray, compiled, inlined
from sim.engine.world_state import Vehicle
from sim.models.vehicles import Motion


@inlined
def guard_of(tables: LoopTables, state: GuardState, world: int, uav: int) -> GuardState:
    """Memory of the safety filter of a UAV."""
    delay, underway = tables.safety[uav].delay_ticks, state.underway
    sent = Underway(
        underway.sent[world, uav, : delay + 2],
        underway.flown[world, uav],
        underway.expected[world, uav],
    )
    return GuardState(
        state.detections[world, uav],
        state.plan[world, uav],
        state.track[world, uav],
        state.flags[world, uav],
        sent,
    )


@inlined
def ground_of(tables: LoopTables, state: LoopState, world: int, ugv: int) -> GroundMemory:
    """Ground as a UGV knows it."""
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
    """Coverage grid of a UAV: its own, or that of its world."""
    coverage: FloatArray = (
        state.maps[world, uav] if parameters.own_maps else state.batch.coverage[world]
    )
    return coverage


@compiled
def reference_of(vehicle: Vehicle) -> Motion:
    """Reference state of a vehicle."""
    place, velocity = vehicle.reference_position, vehicle.reference_velocity
    return Motion(place[0], place[1], velocity[0], velocity[1])
