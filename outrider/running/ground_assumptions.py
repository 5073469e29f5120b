"""Checks of the assumptions under which a cautious UGV is certified to stay on tiles that it knows to be drivable.

See docs/explanation/ground.md. Lost, late and reordered commands break none of them: each command carries the stop
that follows it.
"""

from collections.abc import Iterator

from bus.registry import CAUTIONS
from sim.models.ground import span
from sim.models.hazards import BLOCK, TOUCH
from sim.scenario.clearance import report_faults
from sim.scenario.ground_tables import ground_tables
from sim.scenario.types import Scenario, Ugv

GUIDE = "docs/explanation/ground.md"
"""Page that explains the guarantee."""
_CAUTIOUS = CAUTIONS[0]


def ground_warnings(scenario: Scenario) -> Iterator[str]:
    """Warn of each cautious UGV that navigates without the guarantee, and name the broken assumption."""
    if not scenario.has_ground:
        return
    for k, ugv in enumerate(scenario.ugv):
        if ugv.driver == "navigate" and ugv.caution == _CAUTIOUS:
            reports = () if scenario.only_known_buildings else report_faults(scenario, ugv)
            for reason in (*_start_faults(scenario, k, ugv), *reports):
                yield f"{ugv.name}: not certified to stay on known tiles: {reason}; see {GUIDE}"


def _start_faults(scenario: Scenario, k: int, ugv: Ugv) -> Iterator[str]:
    """Yield the faults of a start: the UGV must be at rest, and all tiles that it touches drivable."""
    if ugv.velocity != (0.0, 0.0):
        yield f"ugv.{k}.velocity = {list(ugv.velocity)}: the UGV starts moving; allowed: 0"
    tiles, tile = ground_tables(scenario).tiles, scenario.ground.tile
    rows, columns = tiles.shape
    x, y = ugv.position
    around = tiles[
        slice(*span(y - TOUCH, y + TOUCH, tile, rows)),
        slice(*span(x - TOUCH, x + TOUCH, tile, columns)),
    ]
    if (around == BLOCK).any():
        yield f"ugv.{k}.position = {list(ugv.position)}: the UGV touches a blocked tile; move it"
