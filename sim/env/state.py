"""The state: everything that is true, as one flat array."""

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from bus.layout import CommonState, bounds
from sim.env.episode import Episode
from sim.env.spaces import box, extent_of
from sim.models.field import coverage_shares
from sim.scenario.types import Scenario
from sim.world import World


def state_space(
    scenario: Scenario, episode: Episode, *, cells: int, dtype: type[np.floating]
) -> spaces.Box:
    """The space of `state_array`; `cells` entries of coverage at the end."""
    vehicles = scenario.vehicles
    low, high = bounds(CommonState, extent_of(scenario, vehicles[0]))
    for vehicle in vehicles:
        least, largest = bounds(episode.state_rows[vehicle.name], extent_of(scenario, vehicle))
        low, high = low + least, high + largest
    return box(low + [0.0] * cells, high + [1.0] * cells, dtype)


def state_array(
    world: World,
    episode: Episode,
    *,
    with_cells: bool,
    dtype: type[np.floating],
) -> npt.NDArray[np.floating[Any]]:
    """The common entries, each vehicle's in name order and, `with_cells`, min(C / C*, 1) of every cell, row by row."""
    desired = world.parameters.desired
    covered, seen = coverage_shares(world.coverage, desired)
    values = [*CommonState(time=world.time, covered=covered, seen=seen)]
    for name in episode.names:
        values += episode.state(name)
    if with_cells:
        shares = np.minimum(world.coverage / desired, 1.0)
        return np.concatenate((values, shares.ravel()), dtype=dtype, casting="same_kind")
    return np.array(values, dtype=dtype)
