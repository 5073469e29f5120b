"""Altitude in a tick of the closed loop: sensor, altitude law and safety filter; not compiled in the plane."""

from typing import Any

from agents.height import vertical_command
from agents.safety.altitude import decide_in_space
from agents.safety.decision import decide
from agents.safety.memory import FilterMemory
from agents.uav_parameters import Target, UavParameters
from outrider.envs.closed_loop_state import HeightTables, LoopState
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.dispatch import unless_none
from sim.engine.world_state import Vehicle
from sim.models.camera import sensor_at
from sim.models.safety import SafetyBounds
from sim.models.shadows import Occlusion
from sim.models.vehicles import Motion


@compiled
def _occlusion_in_plane(heights: None, uav: UavParameters, row: int, vehicle: Vehicle) -> None:
    return None


@compiled
def _occlusion_at(
    heights: HeightTables, uav: UavParameters, row: int, vehicle: Vehicle
) -> Occlusion:
    own, law = vehicle.vertical, heights.laws[row]
    if own.flies:
        found = sensor_at(law.sensor, law.camera, own.altitude)
        sensor: Any = uav.sensor
        sensor.peak, sensor.reach = found.peak, found.reach
    return Occlusion(heights.buildings, heights.corners, own.altitude)


occlusion_at = unless_none(_occlusion_at, _occlusion_in_plane)
"""`occlusion_at(heights, uav, row, vehicle)`: set a UAV's sensor to its altitude, and return the known buildings as
seen from there; None in the plane.

`heights`: tables of the altitudes, None: all UAVs fly in the plane; `uav`: constants of the UAV, changed; `row`: its
row in the tables; `vehicle`: the UAV in the world.
"""


@compiled
def climb(
    heights: HeightTables | None,
    state: LoopState,
    place: tuple[int, int],
    vehicle: Vehicle,
    here: Motion,
    coverage: FloatArray,
    target: Target,
    occlusion: Occlusion | None,
) -> float:
    """Return the vertical acceleration of a UAV's altitude law [m/s²]; 0 in the plane.

    Args:
        heights: Tables of the altitudes; None: all UAVs fly in the plane.
        state: State of all worlds.
        place: World and UAV.
        vehicle: The UAV in the world.
        here: Its horizontal state.
        coverage: Its own map. Shape (rows, columns).
        target: Estimate of the UGV.
        occlusion: Known buildings, from `occlusion_at`.
    """
    if heights is None or not vehicle.vertical.flies:
        return 0.0
    world, uav = place
    command: float = vertical_command(
        state.uavs[world, uav],
        heights.laws[uav],
        state.heights[world, uav],
        state.batch.ticks[world],
        here,
        vehicle.vertical,
        coverage,
        target,
        occlusion,
    )
    return command


@compiled
def filter_at(
    heights: HeightTables | None,
    row: int,
    bounds: SafetyBounds,
    memory: FilterMemory,
    tick: int,
    here: Motion,
    vehicle: Vehicle,
    wanted: tuple[float, float, float],
    committed: int,
) -> None:
    """Let the safety filter of a UAV decide on its nominal acceleration, as `SafetyFilter.filter` does.

    Args:
        heights: Tables of the altitudes; None: all UAVs fly in the plane.
        row: Row of the UAV in the tables.
        bounds: Its bounds in the plane.
        memory, tick, here, committed: As in `agents.safety.decision.decide`.
        vehicle: The UAV in the world.
        wanted: Nominal acceleration, horizontal and vertical [m/s²].
    """
    if heights is None:
        decide(bounds, memory, tick, here, wanted[0], wanted[1], committed)
    elif vehicle.vertical.flies:
        own = vehicle.vertical
        decide_in_space(heights.levels[row], memory, tick, here, own, wanted, committed)
    else:
        decide(bounds, memory, tick, here, wanted[0], wanted[1], committed)
