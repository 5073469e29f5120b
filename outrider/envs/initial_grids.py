"""Initial occupancy grids of all UGVs, with the buildings of their maps."""

from collections.abc import Iterable, Sequence

from agents.drivers.compiled import briefed_grid
from agents.drivers.tile_map import OccupancyGrid
from outrider.envs.pilot_numbers import repeated
from sim.engine.briefing import ugv_briefing
from sim.scenario.types import Scenario, Ugv


def grids_of(grids: Sequence[OccupancyGrid], worlds: int) -> OccupancyGrid:
    """Return the grids of all UGVs in all worlds. Shape (worlds, UGVs, ...).

    Args:
        grids: Grid of each UGV; they share one area, and each has as many rows of commands as its delay requires.
        worlds: Number of worlds.
    """
    longest = max(grids, key=lambda memory: len(memory.sent))
    memories = repeated(longest, worlds, len(grids))
    for n, memory in enumerate(grids):
        _enter(memories, (slice(None), n), memory)
    return memories


def _enter(grids: OccupancyGrid, place: tuple[slice | int, int], memory: OccupancyGrid) -> None:
    """Copy the initial tiles of a UGV."""
    grids.tiles[place], grids.reported[place] = memory.tiles, memory.reported
    grids.blocked[place], grids.unseen[place] = memory.blocked, memory.unseen
    grids.measured[place], grids.flags[place] = memory.measured, memory.flags


def map_random_buildings(
    grids: OccupancyGrid, scenario: Scenario, runs: Iterable[tuple[int, int]], secret: str
) -> None:
    """Enter the buildings of runs with fields of buildings, which differ with the seed.

    Args:
        grids: Grids of all UGVs in all worlds; changed.
        scenario: Scenario of all worlds.
        runs: World and seed of each run.
        secret: Common secret of the runs.
    """
    names = [one.name for one in scenario.vehicles if isinstance(one, Ugv)]
    for world, seed in runs:
        for n, name in enumerate(names):
            memory = briefed_grid(ugv_briefing(scenario, name, int(seed), secret))
            _enter(grids, (world, n), memory)
