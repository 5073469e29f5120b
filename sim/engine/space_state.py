"""Cameras and buildings of many worlds. Planar scenarios have none, and nothing is compiled for them."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray, records
from sim.models.buildings import building_table
from sim.models.camera import CameraParameters
from sim.scenario.building_tables import building_rooms
from sim.scenario.types import Scenario


class TownState(NamedTuple):
    """Buildings of each world; rows of height 0 are empty."""

    buildings: RecordArray
    """`BuildingRow`. Shape (worlds, buildings)."""
    corners: FloatArray
    """Corners of their footprints [m]. Shape (worlds, corners, 2)."""
    seen: RecordArray
    """`BuildingRow` of the buildings that each UAV knows, in the rows of `buildings`; the other rows are empty.

    Shape (worlds, UAVs, buildings).
    """
    found: IntArray
    """Tick in which each UAV discovered a building; -1: it did not. Shape (worlds, UAVs, buildings)."""
    sighted: npt.NDArray[np.bool_]
    """True for the corners that each UAV has seen. Shape (worlds, UAVs, corners)."""


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


def town_of(scenario: Scenario, worlds: int) -> TownState | None:
    """Return the given buildings of a scenario in each world, with room for random ones; None: no buildings."""
    if not scenario.has_buildings or not scenario.has_altitude:
        return None
    rows, corners = building_table([(one.corners, one.height) for one in scenario.building])
    room = sum(building_rooms(scenario))
    rows = np.concatenate([rows, np.zeros(room, rows.dtype)])
    corners = np.concatenate([corners, np.zeros((4 * room, 2))])
    seen = rows if scenario.buildings.known else np.zeros_like(rows)
    return TownState(
        np.repeat(rows[None], worlds, axis=0),
        np.repeat(corners[None], worlds, axis=0),
        np.tile(seen, (worlds, len(scenario.uav), 1)),
        np.full((worlds, len(scenario.uav), len(rows)), -1),
        np.zeros((worlds, len(scenario.uav), len(corners)), dtype=np.bool_),
    )
