"""Occupancy grid of a UGV that has a map of the buildings."""

import numpy as np

from agents.drivers.tile_map import MAPPED, MEASURED, OccupancyGrid
from bus.messages.vehicle import UgvBriefing
from sim.models.ground import CLEAR, UNSEEN, add_polygon
from sim.models.hazards import BLOCK


def map_buildings(memory: OccupancyGrid, briefing: UgvBriefing) -> None:
    """Block the tiles near known buildings; if there are no other hazards, all other tiles are known to be clear.

    Let c be the clearance that the UGV declares. Blocked are the tiles that a building enlarged by c touches. Every
    point of another tile is therefore farther than c from every building. The safety filter keeps a cautious UGV on
    tiles that are known to be drivable, with its plan and with the stop after any command, so it keeps the distance c.
    No sensor report opens a blocked tile: its ground may be clear, but it is too near to a building.

    Args:
        memory: Empty occupancy grid of the UGV; changed in place.
        briefing: Briefing of the UGV.
    """
    ground = briefing.ground
    if ground is None or not (ground.only_buildings or briefing.buildings):
        return
    if ground.only_buildings:
        memory.tiles[...], memory.measured[...] = CLEAR, MEASURED
    for building in briefing.buildings:
        corners = np.array(building.corners, dtype=np.float64)
        add_polygon(corners, ground.building_clearance, BLOCK, ground.tile, memory.tiles)
    memory.measured[memory.tiles == BLOCK] = MAPPED
    memory.reported[...], memory.blocked[...] = memory.tiles, memory.tiles == BLOCK
    memory.unseen[...] = memory.tiles == UNSEEN
