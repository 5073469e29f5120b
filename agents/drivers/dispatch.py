"""Driver of each UGV in a batch: chosen by its row, compiled with the batch.

A batch contains all drivers; those that need ground only if its scenario has ground.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agents.drivers.compiled import driver_parameters
from agents.drivers.parameters import DriverInputs, UgvParameters, ugv_parameters
from bus.messages.vehicle import UgvBriefing
from bus.registry import DEFAULT_DRIVER, DRIVERS, module_of, usable
from sim.compiling.compile import IntArray, compiled
from sim.compiling.dispatch import commands
from sim.compiling.records import RecordArray, fill, fresh_nested, nested_type, records, row_of

_MODULES = usable(
    (row for row in DRIVERS.values() if row.module),
    lambda row: module_of(row, "Parameters", "Memory", "command"),
)
_ROWS = {name: DRIVERS[name] for name in _MODULES}
CODES = {name: code for code, name in enumerate(_ROWS)}
"""Index of each compiled driver's file."""
_driver_command = commands({name: module.command for name, module in _MODULES.items()})


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
def driver_command(
    tables: DriverTables,
    memories: RecordArray,
    place: tuple[int, int],
    inputs: DriverInputs,
) -> tuple[float, float]:
    """Return the command of a UGV from its driver [m/s²].

    Args:
        tables: Tables of the batch.
        memories: Memories of the drivers, changed in place.
        place: World and UGV.
        inputs: Knowledge of the UGV.
    """
    row, own_row = place[1], row_of(tables.ugvs.shape[0], place[0])
    u_x, u_y = _driver_command(
        tables.codes[row],
        tables.ugvs[own_row, row],
        tables.parameters[own_row, row],
        memories[place],
        inputs,
    )
    return u_x, u_y
