"""Altitude law and camera of a UAV that has an altitude."""

import math
from typing import NamedTuple

from agents.control.altitude import ABOVE_FLOOR, PERIOD, MapWeights, best_altitude, climb_to
from agents.safety.levels import least_altitude, levels_of, lowest_certified
from agents.uav_parameters import Target, UavParameters
from bus.messages.vehicle import UavBriefing
from bus.registry import ALTITUDE_LAWS
from sim.compiling.compile import FloatArray, compiled
from sim.compiling.records import RecordArray, fresh
from sim.models.altitude import VerticalState
from sim.models.camera import CameraParameters
from sim.models.sensor import SensorParameters
from sim.models.shadows import Occlusion
from sim.models.vehicles import State

_CERTIFIED, _BEST = ALTITUDE_LAWS.index("certified"), ALTITUDE_LAWS.index("best")


class AltitudeParameters(NamedTuple):
    """Altitude law of one UAV, and its camera."""

    law: int
    """Index in `ALTITUDE_LAWS`."""
    lowest: float
    highest: float
    """Altitudes between which the laws `certified` and `best` fly [m]."""
    sensor: SensorParameters
    """Sensor at the reference altitude."""
    camera: CameraParameters


class AltitudeMemory:
    """Memory of the altitude law of one UAV, a record."""

    goal: float
    """Altitude to reach [m]."""
    compared: int = -1
    """Tick of the last comparison of altitudes; -1: none yet."""


def altitude_parameters(briefing: UavBriefing, uav: UavParameters) -> AltitudeParameters:
    """Return the altitude law and the camera of a UAV.

    Raises:
        ValueError: If the UAV flies in the plane.
    """
    limits, camera = briefing.altitude, briefing.camera
    if limits is None or camera is None:
        raise ValueError("the UAV flies in the plane: it has no altitude to control")
    certified = lowest_certified(briefing)
    floor = least_altitude(briefing) if certified is None else certified
    top = limits.max_altitude if certified is None else float(levels_of(briefing)["floor"][-1])
    lowest = min(floor + ABOVE_FLOOR, limits.max_altitude)
    return AltitudeParameters(
        law=ALTITUDE_LAWS.index(limits.law),
        lowest=lowest,
        highest=max(top, lowest),
        sensor=uav.sensor,
        camera=CameraParameters(
            math.tan(camera.half_angle), camera.reference_altitude, briefing.marker_height
        ),
    )


def altitude_memory(briefing: UavBriefing) -> RecordArray:
    """Return the initial memory of the altitude law. Shape (1,)."""
    memory = fresh(AltitudeMemory)
    memory["goal"] = 0.0 if briefing.altitude is None else briefing.altitude.initial_altitude
    return memory


@compiled
def vertical_command(
    uav: UavParameters,
    parameters: AltitudeParameters,
    memory: AltitudeMemory,
    tick: int,
    own: State,
    vertical: VerticalState,
    coverage: FloatArray,
    target: Target,
    occlusion: Occlusion | None = None,
) -> float:
    """Return the vertical acceleration of the altitude law [m/s²].

    Args:
        uav: Constants of the UAV.
        parameters: Altitude law and camera.
        memory: Memory of the altitude law, changed in place.
        tick: Current tick.
        own, vertical: Horizontal and vertical state of the UAV.
        coverage: Its own map. Shape (rows, columns).
        target: Estimate of the UGV.
        occlusion: Known buildings; None: there are none.
    """
    if parameters.law == _CERTIFIED:
        memory.goal = parameters.lowest
    elif parameters.law == _BEST and target.known:
        period = max(1, round(PERIOD / uav.dt))
        if memory.compared < 0 or tick - memory.compared >= period:
            memory.compared = tick
            memory.goal = best_altitude(
                coverage,
                (own.p_x, own.p_y),
                (target.p_x, target.p_y),
                MapWeights(uav.density_radius, uav.desired_coverage, uav.cell),
                parameters.sensor,
                parameters.camera,
                (parameters.lowest, parameters.highest),
                occlusion,
            )
    return climb_to(
        vertical.altitude,
        vertical.rate,
        memory.goal,
        vertical.max_rate,
        vertical.max_acceleration,
        uav.dt,
    )
