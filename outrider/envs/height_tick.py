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
from sim.compiling.records import row_of
from sim.engine.space_state import TownState
from sim.engine.space_tick import known_occlusion_of
from sim.engine.world_state import Vehicle
from sim.models.buildings import cover_footprint
from sim.models.camera import sensor_at
from sim.models.safety import SafetyBounds
from sim.models.shadows import Occlusion
from sim.models.vehicles import Motion


@unless_none
@compiled
def occlusion_at(
    heights: HeightTables,
    town: TownState | None,
    uav: UavParameters,
    place: tuple[int, int],
    vehicle: Vehicle,
) -> Occlusion | None:
    """Set a UAV's sensor to its altitude, and return the buildings that it knows, as seen from there.

    Return None in the plane and without buildings.

    Args:
        heights: Tables of the altitudes; None: all UAVs fly in the plane.
        town: Buildings of all worlds.
        uav: Constants of the UAV, changed.
        place: World and UAV.
        vehicle: The UAV in the world.
    """
    world, row = place
    own, law = vehicle.vertical, heights.laws[row_of(heights.laws.shape[0], world), row]
    if own.flies:
        found = sensor_at(law.sensor, law.camera, own.altitude)
        sensor: Any = uav.sensor
        sensor.peak, sensor.reach = found.peak, found.reach
    known: Occlusion | None = known_occlusion_of(town, world, row, own.altitude)
    return known


@unless_none
@compiled
def cover_found(
    town: TownState, place: tuple[int, int], uav: UavParameters, tick: int, coverage: FloatArray
) -> None:
    """Count the ground under buildings just discovered as covered; do nothing without buildings.

    Args:
        town: Buildings of all worlds.
        place: World and UAV.
        uav: Constants of the UAV.
        tick: Current tick.
        coverage: Its own map, changed.
    """
    world, k = place
    found = town.found[world, k]
    for n in range(found.shape[0]):
        if found[n] == tick:
            cover_footprint(
                coverage,
                town.buildings[world],
                town.corners[world],
                n,
                uav.cell,
                uav.desired_coverage,
            )


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
        heights.laws[row_of(heights.laws.shape[0], world), uav],
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
    place: tuple[int, int],
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
        place: World and UAV.
        bounds: Its bounds in the plane.
        memory, tick, here, committed: As in `agents.safety.decision.decide`.
        vehicle: The UAV in the world.
        wanted: Nominal acceleration, horizontal and vertical [m/s²].
    """
    if heights is None:
        decide(bounds, memory, tick, here, wanted[0], wanted[1], committed)
    elif vehicle.vertical.flies:
        own = vehicle.vertical
        levels = heights.levels[row_of(heights.levels.shape[0], place[0]), place[1]]
        decide_in_space(levels, memory, tick, here, own, wanted, committed)
    else:
        decide(bounds, memory, tick, here, wanted[0], wanted[1], committed)
