"""True metrics of the vehicles in many worlds, as arrays by name."""

from typing import Any

import numpy as np
import numpy.typing as npt

from sim.env.rewards import MISSION_TERMS, UAV_TERMS, UGV_TERMS
from sim.env.rows import RowState, RowTables
from sim.models.sight import sight_margin
from sim.scenario.types import Scenario


def true_metrics(
    scenario: Scenario, tables: RowTables, state: RowState, name: str
) -> dict[str, npt.NDArray[Any]]:
    """Return a vehicle's true metrics and the terms of its last reward in all worlds: new arrays, shape (worlds,)."""
    number = [vehicle.name for vehicle in scenario.vehicles].index(name)
    standing, found = state.standings[:, number].copy(), dict[str, npt.NDArray[Any]]()
    if tables.kind_row[number] >= 0:
        error = (
            standing["error"] if tables.episode["error"].item() else np.full(len(standing), np.nan)
        )
        found = {
            "distance": standing["distance"],
            "margin": sight_margin(standing["distance"], standing["sight_radius"]),
            "max_distance": standing["max_distance"],
            "visibility_violations": standing["violations"],
            "coverage_error": error,
            "uncovered_share": error / tables.episode["full"].item(),
        }
        terms = UAV_TERMS
    else:
        found = {"goals_reached": standing["reached"], "way_to_goal": standing["to_go"]}
        terms = UGV_TERMS
    paid = {
        f"reward_{term}": standing["terms"][:, n]
        for n, term in enumerate(terms)
        if scenario.has_ground or term not in MISSION_TERMS
    }
    return {key: array.copy() for key, array in (found | paid).items()}
