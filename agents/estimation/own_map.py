"""The coverage map that a UAV keeps of its own observations, at the start of a run."""

from bus.messages.vehicle import UavBriefing
from sim.compiling.compile import FloatArray
from sim.models.buildings import building_table, footprint_cells
from sim.models.field import cover, empty_coverage


def own_map(briefing: UavBriefing) -> FloatArray:
    """Return the map of a UAV that has observed nothing yet. Shape (rows, columns).

    The ground under known buildings can never be seen, so for a UAV with an altitude it counts as covered: no law is
    drawn to it.
    """
    area = briefing.area
    coverage = empty_coverage(area.width, area.height, area.cell)
    for region in briefing.covered:
        cover(coverage, region.lower, region.upper, area.cell, briefing.desired_coverage)
    if briefing.altitude is not None:
        known = building_table([(one.corners, one.height) for one in briefing.buildings])
        coverage[footprint_cells(*known, area.cell, coverage.shape)] = briefing.desired_coverage
    return coverage
