"""Drivers for the compiled tick: the driver of one pilot, or of each UGV in a batch, chosen by its row.

A batch contains all drivers; those that need ground only if its scenario has ground.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from agents.drivers.parameters import DriverInputs, UgvParameters, driver_parameters, ugv_parameters
from bus.messages.vehicle import UgvBriefing
from bus.registry import DEFAULT_DRIVER, DRIVERS, module_of, usable
from sim.compiling.compile import IntArray, compiled
from sim.compiling.dispatch import commands
from sim.compiling.records import RecordArray, fill, fresh_nested, nested_type, records
from sim.models.randomness import words_of

_MODULES = usable(
    (row for row in DRIVERS.values() if row.module),
    lambda row: module_of(row, "Parameters", "Memory", "command"),
)
_ROWS = {name: DRIVERS[name] for name in _MODULES}
CODES = {name: code for code, name in enumerate(_ROWS)}
"""Index of each compiled driver's file."""
_driver_command = commands({name: module.command for name, module in _MODULES.items()})


class ChosenDriver(NamedTuple):
    """Driver of one UGV in a tick."""

    code: int
    """A value of `CODES`."""
    ugv: RecordArray
    """`UgvParameters`. Shape (1,)."""
    parameters: RecordArray
    memory: RecordArray
    """Parameters and memory, nested by driver; the memory is changed in place. Shape (1,)."""


def chosen_driver(briefing: UgvBriefing, name: str, given: Any) -> ChosenDriver:  # noqa: ANN401
    """Return a driver with a new memory, for one UGV. `given`: its parameters, from `driver_parameters`."""
    parameters: RecordArray = np.zeros(1, nested_type({name: type(given)}))
    fill(parameters[name][0], given)
    memory = fresh_nested({name: _MODULES[name].Memory}, (1,))
    if "key_0" in (memory[name].dtype.names or ()):
        memory[name]["key_0"], memory[name]["key_1"] = words_of(briefing.key)
    own = ugv_parameters(briefing, unbounded=DRIVERS[name].unbounded)
    return ChosenDriver(CODES[name], records(UgvParameters, [own]), parameters, memory)


class DriverTables(NamedTuple):
    """Drivers of a batch's UGVs, with their constants."""

    codes: IntArray
    """A value of `CODES`. Shape (UGVs,)."""
    ugvs: RecordArray
    """`UgvParameters`. Shape (1, UGVs), or (worlds, UGVs) if worlds differ."""
    parameters: RecordArray
    """`Parameters` of each driver that the batch contains, nested by name. Shape as `ugvs`.

    A batch without ground contains no driver that needs it.
    """


def driver_tables(briefings: Sequence[UgvBriefing], drivers: Sequence[str]) -> DriverTables:
    """Return the tables of the UGVs with these briefings, each with its driver.

    Raises:
        ScenarioError: If a driver has no compiled form.
    """
    chosen = list(zip(briefings, drivers, strict=True))
    given = [driver_parameters(one, name) for one, name in chosen]
    ugvs = [ugv_parameters(one, unbounded=DRIVERS[name].unbounded) for one, name in chosen]
    # Without ground, the navigating driver equals the default one, which needs no other code.
    codes = [
        CODES[DEFAULT_DRIVER if DRIVERS[name].separate and one.ground is None else name]
        for one, name in chosen
    ]
    grounded = any(one.ground is not None for one in briefings)
    # Drivers that need ground come first: numba would treat a record as another one that it begins with.
    names = sorted(_ROWS, key=lambda name: not _ROWS[name].separate)
    kinds = {
        name: _MODULES[name].Parameters for name in names if grounded or not _ROWS[name].separate
    }
    table = np.zeros(len(chosen), nested_type(kinds))
    for k, name in enumerate(drivers):
        if codes[k] == CODES[name]:
            fill(table[name][k], given[k])
    rows = records(UgvParameters, ugvs)
    return DriverTables(np.array(codes, dtype=np.int64), rows[None], table[None])


def driver_memories(tables: DriverTables, worlds: int) -> RecordArray:
    """Return the memories of the drivers in all worlds, nested by name. Shape (worlds, UGVs)."""
    kinds = {name: _MODULES[name].Memory for name in tables.parameters.dtype.names or ()}
    return fresh_nested(kinds, (worlds, len(tables.codes)))


@compiled
def drive(driver: ChosenDriver, inputs: DriverInputs) -> tuple[float, float]:
    """Return the acceleration of a UGV's driver [m/s²], for a pilot and for each UGV of a batch.

    Before it, `agents.drivers.tile_map.record_tiles` and `record_block` update the occupancy grid from the messages of
    the tick.

    Args:
        driver: The driver; its memory is changed in place.
        inputs: State of the UGV and what it knows; the plan of its occupancy grid is changed in place.
    """
    u_x, u_y = _driver_command(
        driver.code, driver.ugv[0], driver.parameters[0], driver.memory[0], inputs
    )
    return u_x, u_y
