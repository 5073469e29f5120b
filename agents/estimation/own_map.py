"""The coverage map that a UAV keeps of its own observations, at the start of a run."""

from collections.abc import Sequence

from bus.messages.buildings import Building
from bus.messages.vehicle import UavBriefing
from sim.compiling.compile import FloatArray
from sim.models.buildings import cover_footprint, tables_of
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
        cover_buildings(coverage, briefing, briefing.buildings)
    return coverage


def cover_buildings(
    coverage: FloatArray, briefing: UavBriefing, buildings: Sequence[Building]
) -> None:
    """Count the ground under buildings as covered.

    Args:
        coverage: Map of the UAV; changed. Shape (rows, columns).
        briefing: Briefing of the UAV.
        buildings: Buildings that it has learnt of.
    """
    known = tables_of(buildings)
    for k in range(len(buildings)):
        cover_footprint(coverage, *known, k, briefing.area.cell, briefing.desired_coverage)
