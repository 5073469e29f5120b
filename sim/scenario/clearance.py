"""Distance that UGVs keep from buildings, and what prevents it."""

from collections.abc import Iterator

from bus.numbers import exact
from bus.registry import CAUTIONS, DRIVERS
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Ugv

_TILES_TO_STOP = 1.5
"""Tiles between the clearance of a building and a free point, or tile: more than the diagonal of a tile."""


def guaranteed_clearance(scenario: Scenario, ugv: Ugv, driver: str | None = None) -> float:
    """Return the distance from every building that a UGV guarantees to keep [m]; 0: none.

    Arguments as in `clearance_fault`.
    """
    return 0.0 if clearance_fault(scenario, ugv, driver) else ugv.building_clearance


def clearance_fault(scenario: Scenario, ugv: Ugv, driver: str | None = None) -> str:
    """Return why a UGV guarantees no distance from buildings; empty if it does.

    The cautious driver `navigate` keeps it from known buildings if no hazard is missed: ground that slows the UGV
    unexpectedly lets it leave its predicted trajectory. From unknown ones it does so if all reports are true: a UGV
    beside a false alarm leaves tiles that it takes for blocked, past ground that it does not know.

    Args:
        scenario: The scenario.
        ugv: The UGV.
        driver: Driver in control, `EXTERNAL` for external actions; None: the scenario's.
    """
    name = driver or ugv.driver
    if ugv.keeps_clearance and name in DRIVERS and (DRIVERS[name].outside or DRIVERS[name].own):
        return "" if ugv.building_clearance > 0.0 else "building_clearance = 0"
    # a UGV executes the stops of `navigate` only if the scenario names that driver
    if {name, ugv.driver} != {"navigate"} or ugv.caution != CAUTIONS[0]:
        return f'requires driver = "navigate" and caution = "{CAUTIONS[0]}"'
    if ugv.velocity != (0.0, 0.0):
        return "the UGV starts moving"
    if ugv.building_clearance == 0.0:
        return "building_clearance = 0"
    if scenario.buildings.known:
        return "" if scenario.only_known_buildings else _miss_fault(scenario, ugv)
    if scenario.ground.false_alarm > 0.0:
        return f"ground.false_alarm = {exact(scenario.ground.false_alarm)}; allowed among unknown buildings: 0"
    return next(report_faults(scenario, ugv), "")


def _miss_fault(scenario: Scenario, ugv: Ugv) -> str:
    """Return why a tile with a hazard may be reported drivable; empty if none is."""
    miss = scenario.ground.miss
    if miss == 0.0 or not any(uav.escorts == ugv.name for uav in scenario.uav):
        return ""
    return f"ground.miss = {exact(miss)}: a tile with a hazard may be reported clear; allowed: 0"


def report_faults(scenario: Scenario, ugv: Ugv) -> Iterator[str]:
    """Yield the faults of tile reports: no blocked tile may be reported drivable, and no two reports may differ."""
    ground = scenario.ground
    escorts = [uav for uav in scenario.uav if uav.escorts == ugv.name]
    if missed := _miss_fault(scenario, ugv):
        yield missed
    if len(escorts) > 1 and ground.false_alarm > 0.0:
        yield (
            f"ground.false_alarm = {exact(ground.false_alarm)}: the reports of {len(escorts)} UAVs may contradict each "
            "other; allowed: one UAV, or 0"
        )


def enlargement(scenario: Scenario) -> float:
    """Return by how much all that blocks is enlarged where UGVs keep a distance from unknown buildings [m].

    They keep it from every tile that is not known to be drivable, thus up to a tile's diagonal farther than declared.
    """
    kept = scenario.max_building_clearance
    if scenario.buildings.known or not scenario.has_buildings or kept == 0.0:
        return 0.0
    return kept + _TILES_TO_STOP * scenario.ground.tile


def least_distance(scenario: Scenario) -> float:
    """Return the distance of a building from a point whose tile is outside its clearance, whatever the tile [m]."""
    enlarged = max(scenario.max_building_clearance, enlargement(scenario))
    return enlarged + _TILES_TO_STOP * scenario.ground.tile
