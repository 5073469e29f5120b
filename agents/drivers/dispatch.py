"""Driver of each UGV in a batch: chosen by its row, compiled with the batch.

A batch contains all drivers; those that need ground only if its scenario has ground.
"""

from collections import namedtuple
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from agents.drivers.compiled import driver_parameters
from agents.drivers.parameters import DriverInputs, UgvParameters, ugv_parameters
from bus.messages.vehicle import UgvBriefing
from bus.registry import DEFAULT_DRIVER, DRIVERS
from sim.compiling.compile import IntArray, compiled
from sim.compiling.dispatch import commands
from sim.compiling.records import RecordArray, fresh, record_type, records
from sim.models.vehicles import Motion

_ROWS = {row.name: row for row in DRIVERS.values() if row.module}
CODES = {name: code for code, name in enumerate(_ROWS)}
"""Index of each compiled driver's file."""
_MODULES = tuple(import_module(row.module) for row in _ROWS.values())
PerDriver: Any = namedtuple("PerDriver", tuple(_ROWS))  # type: ignore[misc] # of the table
"""Structured array of each driver; None for drivers that need ground, in a batch without it."""
_driver_command = commands([module.command for module in _MODULES])


class DriverTables(NamedTuple):
    """Drivers of a batch's UGVs, with their constants."""

    codes: IntArray
    """A value of `CODES`. Shape (UGVs,)."""
    ugvs: RecordArray
    """`UgvParameters`. Shape (UGVs,)."""
    parameters: Any
    """`PerDriver`: `Parameters` of the drivers. Shape (UGVs,)."""


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
    tables = []
    for code, (row, module) in enumerate(zip(_ROWS.values(), _MODULES, strict=True)):
        table = np.zeros(len(chosen), record_type(module.Parameters))
        own = [k for k, other in enumerate(codes) if other == code and drivers[k] == row.name]
        if own:
            table[own] = records(module.Parameters, [given[k] for k in own])
        tables.append(table if grounded or not row.separate else None)
    table = records(UgvParameters, ugvs)
    return DriverTables(np.array(codes, dtype=np.int64), table, PerDriver(*tables))


def driver_memories(tables: DriverTables, worlds: int) -> Any:  # noqa: ANN401 - `PerDriver`
    """Return the memories of the drivers in all worlds. Shape (worlds, UGVs) each."""
    shape = worlds, len(tables.codes)
    return PerDriver(
        *(
            None if table is None else fresh(module.Memory, shape)
            for module, table in zip(_MODULES, tables.parameters, strict=True)
        )
    )


@compiled
def driver_command(
    tables: DriverTables,
    memories: Any,  # noqa: ANN401 - `PerDriver`
    place: tuple[int, int],
    inputs: DriverInputs,
    tick: int,
    own: Motion,
) -> tuple[float, float]:
    """Return the command of a UGV from its driver [m/s²].

    Args:
        tables: Tables of the batch.
        memories: Memories of the drivers, changed in place.
        place: World and UGV.
        inputs: Goals, script, and messages received in this tick.
        tick: Current tick.
        own: State of the UGV.
    """
    row = place[1]
    u_x, u_y = _driver_command(
        tables.codes[row],
        tables.ugvs[row],
        tables.parameters,
        memories,
        place,
        (inputs, tick, own),
    )
    return u_x, u_y
