"""Buildings of a run: given ones, and random ones of fields."""

from collections.abc import Iterator

import numpy as np

from bus.messages.buildings import Building
from bus.registry import HAZARDS
from sim.compiling.compile import FloatArray
from sim.models.building_fields import Block, BlockLayout, draw_blocks, most_blocks
from sim.models.randomness import Key
from sim.scenario.clearance import least_distance
from sim.scenario.ground_types import BuildingField
from sim.scenario.stops import stops
from sim.scenario.types import Scenario


def block_layout(field: BuildingField) -> BlockLayout:
    """Return the parameters of a field for the simulator."""
    return BlockLayout(*field.block, field.street, *field.height, field.share)


def most_buildings(scenario: Scenario, field: BuildingField) -> float:
    """Return the largest number of buildings in a field; a whole number, or infinite."""
    columns, rows = (
        most_blocks(block_layout(field), side)
        for side in (scenario.area.width, scenario.area.height)
    )
    return columns * rows if columns and rows else 0.0


def building_rooms(scenario: Scenario) -> list[int]:
    """Return the largest number of buildings in each field of a valid scenario."""
    return [int(most_buildings(scenario, field)) for field in scenario.building_field]


def highest_building(scenario: Scenario) -> float:
    """Return the largest possible height of a building in a scenario [m]; 0: there are no buildings."""
    heights = [building.height for building in scenario.building]
    return max([*heights, *(field.height[1] for field in scenario.building_field)], default=0.0)


def max_building_height(scenario: Scenario) -> float | None:
    """Return the declared height of the highest building [m]; None: there are no buildings."""
    if not scenario.has_buildings:
        return None
    return scenario.certificate.max_building_height or highest_building(scenario)


def run_buildings(scenario: Scenario, key: Key | None) -> tuple[Building, ...]:
    """Return the buildings of a run, a pure function of the scenario and the key.

    A block of a field stays free near a start or a goal, and nearer than a street to a given building, to a building of
    an earlier field, or to a hazard that blocks or that is to be found.

    Args:
        scenario: The scenario.
        key: Key of the run's buildings: purpose `BUILDING_FIELDS` of the first vehicle. None: without fields.

    Raises:
        ValueError: If the scenario has fields, and there is no key.
    """
    if not scenario.building_field:
        return scenario.building
    if key is None:
        raise ValueError("key = None: needed for the buildings at random positions")
    points = [uav.position for uav in scenario.uav]
    points += [point for ugv in scenario.ugv for point in stops(ugv)]
    kept = np.array([(*point, *point) for point in points])
    found, area = list(scenario.building), (scenario.area.width, scenario.area.height)
    for number, field in enumerate(scenario.building_field):
        taken = np.array([*_taken(scenario, found)]).reshape(-1, 4)
        clearance = max(field.clearance, least_distance(scenario))
        found += [
            _building(block)
            for block in draw_blocks(block_layout(field), number, area, key)
            if (_distance(taken, block) >= field.street).all()
            and (_distance(kept, block) >= clearance).all()
        ]
    return tuple(found)


def _building(block: Block) -> Building:
    left, low, right, high, height = block
    return Building(polygon=((left, low), (right, low), (right, high), (left, high)), height=height)


def _taken(scenario: Scenario, buildings: list[Building]) -> Iterator[tuple[float, ...]]:
    """Yield the bounding boxes of the hazards and buildings from which blocks stay away: left, low, right, high [m]."""
    for hazard in scenario.hazard:
        if not HAZARDS[hazard.kind].slows:
            (left, low), (right, high) = hazard.bounds
            radius = hazard.radius or 0.0
            yield left - radius, low - radius, right + radius, high + radius
    for building in buildings:
        (left, low), (right, high) = building.bounds
        yield left, low, right, high


def _distance(boxes: FloatArray, block: Block) -> FloatArray:
    """Return the distance of a block from each box [m]. Shape (boxes,)."""
    left, low, right, high = boxes.T
    d_x = np.maximum(np.maximum(left - block.right, block.left - right), 0.0)
    d_y = np.maximum(np.maximum(low - block.high, block.low - high), 0.0)
    distance: FloatArray = np.hypot(d_x, d_y)
    return distance
