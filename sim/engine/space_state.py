"""Cameras and buildings of many worlds. Planar scenarios have none, and nothing is compiled for them."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.records import RecordArray, records
from sim.engine.ground_state import GroundState
from sim.models.camera import CameraParameters
from sim.scenario.ground_tables import BLOCK_CORNERS
from sim.scenario.types import Scenario


class TownTables(NamedTuple):
    """Buildings of all worlds: rows of the ground's table of hazards, no copies."""

    hazards: RecordArray
    """The array `GroundState.hazards`. Shape (worlds, hazards)."""
    corners: FloatArray
    """The array `GroundState.corners`. Shape (corners, 2)."""
    first: int
    end: int
    """Rows of the buildings, end exclusive; rows of height 0 are empty."""


class TownState(NamedTuple):
    """Knowledge that the UAVs have of the buildings."""

    known: npt.NDArray[np.bool_]
    """True for the buildings that each UAV knows. Shape (worlds, UAVs, buildings)."""
    found: IntArray
    """Tick in which each UAV discovered a building; -1: it did not. Shape (worlds, UAVs, buildings)."""
    sighted: npt.NDArray[np.bool_]
    """True for the corners that each UAV has seen. Shape (worlds, UAVs, buildings, most corners of a building)."""


@compiled
def building_rows(buildings: TownTables, world: int) -> RecordArray:
    """Return the buildings of a world: a view of `HazardRow`. Shape (buildings,)."""
    rows: RecordArray = buildings.hazards[world, buildings.first : buildings.end]
    return rows


def cameras_of(scenario: Scenario) -> RecordArray | None:
    """Return the `CameraParameters` of each UAV; None: the UAVs fly in the plane. Shape (UAVs,)."""
    if not scenario.has_altitude:
        return None
    camera, markers = scenario.camera, {ugv.name: ugv.marker_height for ugv in scenario.ugv}
    uavs = sorted(scenario.uav, key=lambda uav: uav.name)
    return records(
        CameraParameters,
        [
            CameraParameters(
                math.tan(camera.half_angle), camera.reference_altitude, markers[uav.escorts]
            )
            for uav in uavs
        ],
    )


def buildings_of(scenario: Scenario, ground: GroundState | None) -> TownTables | None:
    """Return the buildings of all worlds, which hide ground from cameras; None: there are none."""
    if ground is None or not scenario.has_buildings or not scenario.has_altitude:
        return None
    parameters = ground.parameters[0]
    rows = int(parameters["first_building"]), int(parameters["end_building"])
    return TownTables(ground.hazards, ground.corners, *rows)


def town_of(scenario: Scenario, buildings: TownTables | None) -> TownState | None:
    """Return the initial knowledge of the UAVs; None: there are no buildings.

    They may know the given buildings, but none at a random position.
    """
    if buildings is None:
        return None
    shape = len(buildings.hazards), len(scenario.uav), buildings.end - buildings.first
    known = np.zeros(shape, dtype=np.bool_)
    known[..., : len(scenario.building)] = scenario.buildings.known
    corners = max([BLOCK_CORNERS, *(len(one.corners) for one in scenario.building)])
    sighted = np.zeros((*shape, corners), dtype=np.bool_)
    return TownState(known, np.full(shape, -1), sighted)
