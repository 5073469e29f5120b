"""Assumptions of the guarantee that a cautious UGV stays on tiles that it knows to be drivable.

See docs/explanation/ground.md. Lost, late and scattered commands are none: commands carry the stop that follows them.
"""

from collections.abc import Iterator

from bus.registry import CAUTIONS
from sim.models.ground import span
from sim.models.hazards import BLOCK, TOUCH
from sim.scenario.ground_tables import ground_tables
from sim.scenario.types import Scenario, Ugv

_CAUTIOUS = CAUTIONS[0]


def ground_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of each cautious UGV that navigates without the guarantee, with the assumption that fails."""
    if not scenario.has_ground:
        return
    for k, ugv in enumerate(scenario.ugv):
        if ugv.driver == "navigate" and ugv.caution == _CAUTIOUS:
            for reason in (*_start_faults(scenario, k, ugv), *_told_faults(scenario, ugv)):
                yield f"{ugv.name}: not certified to stay on tiles that it knows: {reason}"


def _start_faults(scenario: Scenario, k: int, ugv: Ugv) -> Iterator[str]:
    """A UGV starts at rest, and on tiles that are all drivable: on an edge or a corner on several."""
    if ugv.velocity != (0.0, 0.0):
        yield f"ugv.{k}.velocity = {list(ugv.velocity)}: it starts moving; allowed: from rest"
    tiles, tile = ground_tables(scenario).tiles, scenario.ground.tile
    rows, columns = tiles.shape
    x, y = ugv.position
    around = tiles[
        slice(*span(y - TOUCH, y + TOUCH, tile, rows)),
        slice(*span(x - TOUCH, x + TOUCH, tile, columns)),
    ]
    if (around == BLOCK).any():
        yield f"ugv.{k}.position = {list(ugv.position)}: it starts on an edge of a blocked tile"


def _told_faults(scenario: Scenario, ugv: Ugv) -> Iterator[str]:
    """No tile is told as drivable that is not; and of two UAVs none tells it otherwise than the other."""
    ground = scenario.ground
    tellers = [uav for uav in scenario.uav if uav.escorts == ugv.name]
    if tellers and ground.miss > 0.0:
        yield f"ground.miss = {ground.miss:g}: a tile with a hazard may be told as clear"
    if len(tellers) > 1 and ground.false_alarm > 0.0:
        yield (
            f"ground.false_alarm = {ground.false_alarm:g}: {len(tellers)} UAVs tell it of the ground, and may "
            "contradict each other; allowed: one of them, or no false alarms"
        )
