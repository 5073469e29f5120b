"""Law of each UAV in a batch: chosen by its row, compiled with the batch.

Compiling a batch for a new set of laws takes 15 s. So a batch contains all laws that compile quickly, and only those
slow ones that are flown.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agents.laws.inputs import LawInputs
from agents.uav_parameters import UavParameters, uav_parameters
from bus.law_parameters import law_parameters
from bus.messages.scenario import Law
from bus.messages.vehicle import UavBriefing
from bus.registry import LAWS, module_of, usable
from sim.compiling.compile import IntArray, compiled
from sim.compiling.dispatch import commands
from sim.compiling.records import RecordArray, fresh_nested, nested_type, records
from sim.models.vehicles import brake, clip_norm

_USABLE = usable(
    (row for row in LAWS.values() if row.module and not row.own),
    lambda row: module_of(row, "Memory", "command"),
)
_ROWS = {name: LAWS[name] for name in _USABLE}
_FILES = tuple(dict.fromkeys(row.module for row in _ROWS.values()))
CODES = {name: _FILES.index(row.module) for name, row in _ROWS.items()}
"""Index of the file of each law that flies in batches."""
_MODULES = {row.module.replace(".", "_"): _USABLE[name] for name, row in _ROWS.items()}
"""Module of each law by the name of its nested record, in the order of its code."""
_PARAMETERS = {row.module.replace(".", "_"): row.parameters for row in reversed(_ROWS.values())}
"""Class of the parameters of each law by the same name."""
_SEPARATE = {CODES[name] for name, row in _ROWS.items() if row.separate}
_law_command = commands({name: module.command for name, module in _MODULES.items()})


class LawTables(NamedTuple):
    """Laws of a batch's UAVs, with their constants."""

    codes: IntArray
    """A value of `CODES`. Shape (UAVs,)."""
    uavs: RecordArray
    """`UavParameters`. Shape (UAVs,)."""
    parameters: RecordArray
    """Parameters of each law that the batch contains, nested by name. Shape (UAVs,)."""


def _contained(codes: IntArray) -> dict[str, int]:
    """Return the laws of a batch, by name, with their codes.

    Laws that are compiled only when used come first: numba would treat a record as another one that it begins with.
    """
    used = {
        name: code for code, name in enumerate(_MODULES) if code in codes or code not in _SEPARATE
    }
    return dict(sorted(used.items(), key=lambda one: one[1] not in _SEPARATE))


def law_tables(briefings: Sequence[UavBriefing], laws: Sequence[Law]) -> LawTables:
    """Return the tables of the UAVs with these briefings, each with its law, a key of `CODES`."""
    codes = np.array([CODES[law.name] for law in laws], dtype=np.int64)
    kinds = {name: _PARAMETERS[name] for name in _contained(codes)}
    table = np.zeros(len(laws), nested_type(kinds))
    for name, code in _contained(codes).items():
        own = [k for k, other in enumerate(codes) if other == code]
        if own:
            table[name][own] = records(kinds[name], [law_parameters(laws[k]) for k in own])
    uavs = records(UavParameters, list(map(uav_parameters, briefings)))
    return LawTables(codes, uavs, table)


def law_memories(tables: LawTables, worlds: int) -> RecordArray:
    """Return the memories of the laws in all worlds, nested by name. Shape (worlds, UAVs)."""
    kinds = {name: _MODULES[name].Memory for name in _contained(tables.codes)}
    return fresh_nested(kinds, (worlds, len(tables.codes)))


@compiled
def nominal_command(
    tables: LawTables,
    uav: UavParameters,
    memories: RecordArray,
    place: tuple[int, int],
    inputs: LawInputs,
) -> tuple[float, float]:
    """Return the command of a UAV from its law, within the bound of (1) [m/s²]; without an estimate, brake.

    Args:
        tables: Tables of the batch.
        uav: Constants of this UAV, with its sensor at its altitude.
        memories: Memories of the laws, changed in place.
        place: World and UAV.
        inputs: Knowledge of the UAV; its estimate of the UGV may be unknown.
    """
    row, own = place[1], inputs.own
    if not inputs.target.known:
        return brake(own.v_x, own.v_y, uav.max_acceleration, uav.dt)
    code, parameters = tables.codes[row], tables.parameters[row]
    u_x, u_y = _law_command(code, uav, parameters, memories[place], (inputs,))
    return clip_norm(u_x, u_y, uav.max_acceleration)
