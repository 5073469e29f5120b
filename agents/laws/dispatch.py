"""Law of each UAV in a batch: chosen by its row, compiled with the batch.

Compiling a batch for a new set of laws takes 15 s. So a batch contains all laws that compile quickly, and only those
slow ones that are flown.
"""

from collections import namedtuple
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from agents.uav_parameters import Target, UavParameters, uav_parameters
from bus.law_parameters import law_parameters
from bus.messages.scenario import Law
from bus.messages.vehicle import UavBriefing
from bus.registry import LAWS
from sim.compiling.compile import FloatArray, IntArray, compiled
from sim.compiling.dispatch import commands
from sim.compiling.records import RecordArray, fresh, record_type, records
from sim.models.shadows import Occlusion
from sim.models.vehicles import Motion, brake, clip_norm

_ROWS = {row.name: row for row in LAWS.values() if row.module and not row.own}
_FILES = tuple(dict.fromkeys(row.module for row in _ROWS.values()))
CODES = {name: _FILES.index(row.module) for name, row in _ROWS.items()}
"""Index of the file of each law that flies in batches."""
_FIELDS = tuple(file.replace(".", "_") for file in _FILES)
_MODULES = tuple(map(import_module, _FILES))
_SEPARATE = {CODES[name] for name, row in _ROWS.items() if row.separate}
PerLaw: Any = namedtuple("PerLaw", _FIELDS)  # type: ignore[misc] # of the table
"""Structured array of each file; None if the batch does not contain the law."""
_law_command = commands([module.command for module in _MODULES])


class LawTables(NamedTuple):
    """Laws of a batch's UAVs, with their constants."""

    codes: IntArray
    """A value of `CODES`. Shape (UAVs,)."""
    uavs: RecordArray
    """`UavParameters`. Shape (UAVs,)."""
    parameters: Any
    """`PerLaw`: `Parameters` of the laws. Shape (UAVs,)."""


def law_tables(briefings: Sequence[UavBriefing], laws: Sequence[Law]) -> LawTables:
    """Return the tables of the UAVs with these briefings, each with its law, a key of `CODES`."""
    codes = np.array([CODES[law.name] for law in laws], dtype=np.int64)
    tables = []
    for code, module in enumerate(_MODULES):
        table = np.zeros(len(laws), record_type(module.Parameters))
        own = [k for k, law in enumerate(laws) if CODES[law.name] == code]
        if own:
            table[own] = records(module.Parameters, [law_parameters(laws[k]) for k in own])
        tables.append(table if own or code not in _SEPARATE else None)
    uavs = records(UavParameters, list(map(uav_parameters, briefings)))
    return LawTables(codes, uavs, PerLaw(*tables))


def law_memories(tables: LawTables, worlds: int) -> Any:  # noqa: ANN401 - `PerLaw`
    """Return the memories of the laws in all worlds. Shape (worlds, UAVs) each."""
    shape = worlds, len(tables.codes)
    return PerLaw(
        *(
            None if table is None else fresh(module.Memory, shape)
            for module, table in zip(_MODULES, tables.parameters, strict=True)
        )
    )


@compiled
def nominal_command(
    tables: LawTables,
    uav: UavParameters,
    memories: Any,  # noqa: ANN401 - `PerLaw`
    place: tuple[int, int],
    coverage: FloatArray,
    tick: int,
    own: Motion,
    target: Target,
    occlusion: Occlusion | None = None,
) -> tuple[float, float]:
    """Return the command of a UAV from its law, within the bound of (1) [m/s²]; without an estimate, brake.

    Args:
        tables: Tables of the batch.
        uav: Constants of this UAV, with its sensor at its altitude.
        memories: Memories of the laws, changed in place.
        place: World and UAV.
        coverage: The UAV's coverage grid C. Shape (rows, columns).
        tick: Current tick.
        own: State of the UAV.
        target: Estimate of the UGV.
        occlusion: Known buildings as the UAV sees them; None: there are none.
    """
    row = place[1]
    if not target.known:
        return brake(own.v_x, own.v_y, uav.max_acceleration, uav.dt)
    inputs = coverage, tick, own, target, occlusion
    u_x, u_y = _law_command(tables.codes[row], uav, tables.parameters, memories, place, inputs)
    return clip_norm(u_x, u_y, uav.max_acceleration)
