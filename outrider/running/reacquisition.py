"""Times after which a search sees the UGV again, before a run; see docs/explanation/proof.md, "Search"."""

import math
from typing import NamedTuple

from agents.safety.discs import MARGIN
from agents.safety.levels import bounds_of
from agents.safety.search import search_time
from sim.engine.briefing import uav_briefing
from sim.scenario.types import Scenario
from sim.scenario.vehicle_types import Uav

_NEAR = 2.0
"""Distance of the first time, in radii of sight."""
_PLACES = (0.0, 0.5, 1.0)
"""Starts that are tried, as shares of the area's width and height."""


class Reacquisition(NamedTuple):
    """Times of a search, from the UAV's arrival at the newest measurement, for a UGV that stays put."""

    distance: float
    """Distance of the UGV from its newest measurement [m] for `near`."""
    near: float
    """Time [s] for this distance."""
    area: float
    """Estimate of the time for any distance in the area [s]."""
    hidden: bool
    """True if buildings may hide the UGV, so that neither time is certain."""

    @property
    def line(self) -> str:
        """Times in one clause."""
        unless = ", unless a building hides it" if self.hidden else ""
        return (
            f"searches after lost sight: sees a UGV that stays put within {math.ceil(self.near)} s up to "
            f"{self.distance:.3g} m from its newest measurement, in about {math.ceil(self.area)} s anywhere in the "
            f"area{unless}"
        )


def reacquisition(scenario: Scenario, uav: Uav) -> Reacquisition | None:
    """Return the times of a UAV's search, at its initial altitude; None: it does not search."""
    if not (uav.search and scenario.filters(uav)):
        return None
    bounds, area = bounds_of(uav_briefing(scenario, uav.name, scenario.seed)), scenario.area
    distance = _NEAR * bounds.search_radius
    near = search_time(bounds, distance)
    if not math.isfinite(near):
        return None
    starts = [(x * area.width, y * area.height) for x in _PLACES for y in _PLACES]
    times = [
        search_time(
            bounds, math.hypot(max(x, area.width - x), max(y, area.height - y)), start=(x, y)
        )
        for x, y in starts
    ]
    return Reacquisition(
        distance, near, max(times), bounds.search_radius > bounds.radius + 2.0 * MARGIN
    )
