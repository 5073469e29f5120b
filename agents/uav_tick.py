"""On-board software of one UAV in a tick, compiled: a pilot calls it for its UAV, a batch for each of its UAVs.

A tick has three parts, since an environment observes after the first, and a user's code may replace the second:
`perceive`, `nominal_control`, and `agents.safety.control.filter_control`. The estimate of the UGV is an argument: a
pilot's estimator is filterpy's, a batch's is compiled. A part that is None is not compiled.

Records are tables of one row: a call from Python passes a table five times faster than a record.
"""

from typing import Any, NamedTuple

from agents.altitude_law import AltitudeParameters, vertical_command
from agents.laws.dispatch import FlownLaw, law_command
from agents.laws.inputs import LawInputs
from agents.safety.control import record_measurements
from agents.safety.memory import FilterMemory
from agents.team.records import TeamMemory
from agents.team.tick import law_coverage, perceive_team
from agents.uav_constants import UavConstants
from agents.uav_inputs import KnownBuildings, UavInputs
from agents.uav_parameters import Target, UavParameters
from sim.compiling.compile import FloatArray, compiled, inlined
from sim.compiling.dispatch import unless_none
from sim.compiling.records import RecordArray
from sim.models.altitude import VerticalState
from sim.models.buildings import cover_footprint
from sim.models.camera import sensor_at
from sim.models.field import accumulate
from sim.models.shadows import Occlusion
from sim.models.vehicles import brake, clip_norm


class UavMemory(NamedTuple):
    """Memory of one UAV, changed in place."""

    uav: RecordArray
    """`UavParameters`, with the sensor at its altitude. Shape (1,)."""
    coverage: FloatArray
    """Its own map. Shape (rows, columns)."""
    altitude: RecordArray | None
    """`AltitudeMemory`; None: all UAVs fly in the plane. Shape (1,)."""
    filter: FilterMemory
    team: TeamMemory | None
    """None: there are no teams."""


@unless_none
@compiled
def _seen_from(buildings: KnownBuildings, z: float) -> Occlusion:
    return Occlusion(buildings.rows, buildings.corners, buildings.known, z)


@compiled
def _altitude_of(vertical: VerticalState | None) -> float:
    return 0.0 if vertical is None else vertical.altitude


@compiled
def occlusion_of(inputs: UavInputs) -> Occlusion | None:
    """Return the known buildings as the UAV sees them from its altitude; None: there are none."""
    seen: Occlusion | None = _seen_from(inputs.buildings, _altitude_of(inputs.vertical))
    return seen


@compiled
def _adjust_sensor(
    uav: UavParameters, altitude: RecordArray | None, vertical: VerticalState | None
) -> None:
    """Set the sensor to the altitude of the UAV."""
    if altitude is not None and vertical is not None and vertical.flies:
        parameters: AltitudeParameters = altitude[0]
        found = sensor_at(parameters.sensor, parameters.camera, vertical.altitude)
        sensor: Any = uav.sensor
        sensor.peak, sensor.sensing_range = found.peak, found.sensing_range


@compiled
def _cover_discovered(
    buildings: KnownBuildings | None, uav: UavParameters, coverage: FloatArray, tick: int
) -> None:
    """Count the ground under buildings discovered in this tick as covered: it can never be seen."""
    if buildings is not None:
        for n in range(buildings.discovered.shape[0]):
            if buildings.discovered[n] == tick:
                rows, corners = buildings.rows, buildings.corners
                cover_footprint(coverage, rows, corners, n, uav.cell, uav.desired_coverage)


@inlined
def perceive(constants: UavConstants, memory: UavMemory, inputs: UavInputs, filtered: bool) -> None:
    """Update sensor, map and safety filter from the messages of a tick.

    Args:
        constants: Constants of the UAV.
        memory: Memory of the UAV, changed in place.
        inputs: State and messages.
        filtered: True if its safety filter is in use; in a team, its role decides instead.
    """
    uav, own = memory.uav[0], inputs.own
    _adjust_sensor(uav, constants.altitude, inputs.vertical)
    _cover_discovered(inputs.buildings, uav, memory.coverage, inputs.tick)
    if inputs.elapsed > 0:
        accumulate(
            memory.coverage,
            own.p_x,
            own.p_y,
            uav.sensor,
            uav.cell,
            inputs.elapsed * uav.dt,
            occlusion_of(inputs),
        )
    if perceive_team(
        constants.team,
        memory.team,
        inputs,
        constants.safety,
        memory.filter,
        constants.uav[0],
        uav,
        memory.coverage,
        filtered,
    ):
        record_measurements(constants.safety, memory.filter, inputs)


@compiled
def _climb(
    altitude: RecordArray | None,
    memory: RecordArray | None,
    vertical: VerticalState | None,
    uav: UavParameters,
    coverage: FloatArray,
    inputs: UavInputs,
    target: Target,
) -> float:
    if altitude is None or memory is None or vertical is None:
        return 0.0
    if not vertical.flies:
        return 0.0
    tick, own = inputs.tick, inputs.own
    u_z: float = vertical_command(
        uav, altitude[0], memory[0], tick, own, vertical, coverage, target, occlusion_of(inputs)
    )
    return u_z


@inlined
def altitude_control(
    constants: UavConstants, memory: UavMemory, inputs: UavInputs, target: Target
) -> float:
    """Return the vertical acceleration of the altitude law [m/s²]; 0 in the plane.

    Args:
        constants, memory, inputs: As in `perceive`.
        target: Estimate of the UGV.
    """
    u_z: float = _climb(
        constants.altitude,
        memory.altitude,
        inputs.vertical,
        memory.uav[0],
        memory.coverage,
        inputs,
        target,
    )
    return u_z


@inlined
def nominal_control(
    law: FlownLaw, constants: UavConstants, memory: UavMemory, inputs: UavInputs, target: Target
) -> tuple[float, float, float]:
    """Return the nominal acceleration of law and altitude law, within the bound of (1): x, y and z [m/s²].

    Args:
        law: The law; its memory is changed in place.
        constants, memory, inputs: As in `perceive`.
        target: Estimate of the UGV; while it is unknown, the UAV brakes.
    """
    uav, own = memory.uav[0], inputs.own
    if target.known:
        known = LawInputs(
            law_coverage(memory.team, memory.coverage),
            inputs.tick,
            own,
            target,
            occlusion_of(inputs),
        )
        u_x, u_y = law_command(law.code, uav, law.parameters[0], law.memory[0], known)
        u_x, u_y = clip_norm(u_x, u_y, uav.max_acceleration)
    else:
        u_x, u_y = brake(own.v_x, own.v_y, uav.max_acceleration, uav.dt)
    return u_x, u_y, altitude_control(constants, memory, inputs, target)


@compiled
def fly_law(
    law: FlownLaw,
    constants: UavConstants,
    memory: UavMemory,
    inputs: UavInputs,
    target: Target,
    filtered: bool,
) -> tuple[float, float, float]:
    """Perceive and return the nominal acceleration of the law in one call, for a pilot: x, y and z [m/s²].

    The safety filter is called apart, as this function is compiled again for each law. Arguments as in `perceive` and
    `nominal_control`.
    """
    perceive(constants, memory, inputs, filtered)
    return nominal_control(law, constants, memory, inputs, target)
