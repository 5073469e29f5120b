"""Worlds of a closed loop whose episodes draw some fields of their scenario."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.safety.levels import MOST_LEVELS
from bus.errors import ScenarioError
from bus.messages.scenario import Law
from bus.registry import LAWS
from outrider.closed_loop.arrays import Pilots
from outrider.closed_loop.pilots import ChosenPilots, OwnTables
from outrider.running.assumptions import shortfalls
from sim.compiling.compile import FloatArray, IntArray
from sim.engine.batch import Batch
from sim.env.randomization import Randomization
from sim.scenario.laws import with_law
from sim.scenario.types import Scenario

_COMMON = "codes"
"""Table of `DriverTables` that never differs between worlds."""


def _repeated(table: Any, rows: int) -> Any:  # noqa: ANN401 - nested tables
    """Return nested tables with copies of their only row."""
    if hasattr(table, "_asdict"):
        parts = table._asdict().items()
        return table._replace(**{k: _repeated(one, rows) for k, one in parts if k != _COMMON})
    return None if table is None else np.repeat(table, rows, axis=0)


def _set_row(table: Any, world: int, own: Any) -> None:  # noqa: ANN401 - nested tables
    """Write the only row of nested tables into the row of a world."""
    if hasattr(table, "_asdict"):
        for name, part in table._asdict().items():
            if name != _COMMON:
                _set_row(part, world, getattr(own, name))
    elif table is not None:
        table[world] = own[0]


def tables_of_worlds(chosen: ChosenPilots, scenario: Scenario, worlds: int | None) -> OwnTables:
    """Return the tables of this number of worlds that may differ; None: one row serves all."""
    if worlds is None:
        return chosen.own_tables(scenario)
    tables: OwnTables = _repeated(chosen.own_tables(scenario, MOST_LEVELS), worlds)
    return tables


def _check_corners(randomization: Randomization, given: Scenario, chosen: ChosenPilots) -> None:
    """Check that each combination of the ranges' ends suits the laws, and the safety filters if there are any.

    Raises:
        ScenarioError: If a law does not fit, or the filters cannot rely on an assumption that holds without the ranges.
    """
    watched = next(name for name, row in LAWS.items() if row.watched)
    filtered = chosen.filtered.any()

    def broken(scenario: Scenario) -> dict[tuple[str, str], str]:
        inside = with_law(scenario, Law(name=watched))
        return {(one.uav, one.assumption): one.line for one in shortfalls(inside)}

    before = broken(given) if filtered else {}
    for corner in randomization.corners():
        chosen.check_laws(corner)
        for what, line in broken(corner).items() if filtered else ():
            if what not in before:
                raise ScenarioError(f"randomize: {given.name or 'scenario'}: {line}")


class DrawnWorlds:
    """Values and scenarios of worlds with randomized fields.

    Args:
        randomization: Ranges of the fields.
        given: Scenario without the ranges.
        batch: Worlds, which may differ.
        chosen: Laws and drivers; None: all actions are external and there are no estimates.

    Raises:
        ScenarioError: If the ranges break an assumption of the safety filter.
    """

    def __init__(
        self,
        randomization: Randomization,
        given: Scenario,
        batch: Batch,
        chosen: ChosenPilots | None,
    ) -> None:
        if chosen is not None:
            _check_corners(randomization, given, chosen)
        self._randomization, self._batch, self._chosen = randomization, batch, chosen
        self.scenarios = [randomization.widest] * batch.worlds
        """Scenario of each world's episode."""
        self._values = np.zeros((batch.worlds, len(randomization.keys)))

    def begin(
        self,
        worlds: IntArray,
        seeds: Sequence[int] | IntArray,
        secret: str,
        pilots: Pilots | None,
    ) -> None:
        """Draw the values of restored worlds, and write them into the tables and the state of the pilots."""
        for world, seed in zip(worlds.tolist(), seeds, strict=True):
            self._values[world], scenario = self._randomization.draw(int(seed), secret)
            self.scenarios[world] = scenario
            self._batch.set_world(world, scenario)
            if self._chosen is not None and pilots is not None:
                own = self._chosen.own_tables(scenario, MOST_LEVELS)
                pilots.state.uavs.uav[world] = own.uavs.uav[0]
                for name, table in own._asdict().items():
                    _set_row(getattr(pilots.tables, name), world, table)

    def values(self, vehicle: str | None = None) -> dict[str, FloatArray]:
        """Return the values in all worlds by field: all, or those that a vehicle may know. Shape (worlds,)."""
        keys = self._randomization.keys
        known = range(len(keys)) if vehicle is None else self._randomization.known_to(vehicle)
        return {keys[n]: self._values[:, n].copy() for n in known}
