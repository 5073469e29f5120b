"""A house, a UGV that passes it, and the buildings of random towns, for the tests of buildings."""

import math
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation

from bus.messages.buildings import Building
from sim.engine.run_keys import derive_keys
from sim.models.buildings import tables_of
from sim.models.ground import UNSEEN
from sim.models.hazards import BLOCK, distance_to_hazard
from sim.models.randomness import BUILDING_FIELDS
from sim.scenario.building_tables import run_buildings
from sim.scenario.checks import check_scenario
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Ugv

HOUSE = Building(polygon=((10.0, 10.0), (14.0, 10.0), (14.0, 14.0), (10.0, 14.0)), height=5.0)
PASSING = Ugv(position=(7.0, 8.8), goals=((17.0, 8.8),), building_clearance=1.5)
"""A UGV whose straight path to its goal leads past the house in 1.2 m."""
UNKNOWN_MAP = {
    "buildings.known": False,
    "ugv.0.building_clearance": 1.0,
    "ground.sensing_range": 2.0,
}


def scenario(ugv: Ugv = PASSING, **fields: Any) -> Scenario:
    """A UGV without a UAV, and a house."""
    given = {"ugv": (ugv,), "building": (HOUSE,), "duration": 100.0} | fields
    return check_scenario(Scenario(**given))


def drawn(one: Scenario, seed: int, secret: str = "") -> tuple[Building, ...]:
    first, second = derive_keys((seed,), 1, secret)[0, BUILDING_FIELDS, 0]
    return run_buildings(one, (first, second))


def distances(buildings: tuple[Building, ...], x: float, y: float) -> list[float]:
    rows, corners = tables_of(buildings)
    return [distance_to_hazard(rows, corners, k, x, y) for k in range(len(rows))]


def as_reported(tiles: np.ndarray, clearance: float) -> np.ndarray:
    """Block the tiles with a blocked tile within the clearance, in sides of a tile; then close those near unseen ones.

    By dilation, unlike the code of the UGV.
    """
    margin = math.floor(clearance) + 1 if clearance > 0.0 else 0
    away = np.maximum(np.abs(np.arange(-margin, margin + 1)) - 1, 0)
    near = np.hypot(away[:, None], away[None, :]) <= clearance
    found = tiles.copy()
    for state in (UNSEEN, BLOCK):
        found[binary_dilation(tiles == state, near)] = state
    return found
