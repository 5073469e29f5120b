"""Laws for the compiled tick: the law of one pilot, or of each UAV in a batch, chosen by its row.

Compiling a batch for a new set of laws takes 15 s. So a batch contains all laws that compile quickly, and only those
slow ones that are flown.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.law_parameters import law_parameters
from bus.messages.scenario import Law
from bus.registry import LAWS, module_of, usable
from sim.compiling.compile import IntArray
from sim.compiling.dispatch import commands
from sim.compiling.records import RecordArray, fill, fresh_nested, nested_type, records

_USABLE = usable(
    (row for row in LAWS.values() if row.module), lambda row: module_of(row, "Memory", "command")
)
_ROWS = {name: LAWS[name] for name in _USABLE}
_FILES = tuple(dict.fromkeys(row.module for row in _ROWS.values()))
_ALL_CODES = {name: _FILES.index(row.module) for name, row in _ROWS.items()}
CODES = {name: code for name, code in _ALL_CODES.items() if not _ROWS[name].own}
"""Index of the file of each law that flies in batches."""
_MODULES = {row.module.replace(".", "_"): _USABLE[name] for name, row in _ROWS.items()}
"""Module of each law by the name of its nested record, in the order of its code."""
_PARAMETERS = {row.module.replace(".", "_"): row.parameters for row in reversed(_ROWS.values())}
"""Class of the parameters of each law by the same name."""
_SEPARATE = {_ALL_CODES[name] for name, row in _ROWS.items() if row.separate or row.own}
law_command = commands({name: module.command for name, module in _MODULES.items()})
"""`law_command(code, uav, parameters, memory, inputs)`: command of the law with this code, before the bound of (1).

`parameters`, `memory`: records that nest one record for each law in use.
"""


class FlownLaw(NamedTuple):
    """Law of one UAV in a tick."""

    code: int
    """Index of its file."""
    parameters: RecordArray
    memory: RecordArray
    """Parameters and memory, nested by law; the memory is changed in place. Shape (1,)."""


def flown_law(law: Law) -> FlownLaw:
    """Return a law with a new memory, for one UAV.

    Raises:
        ScenarioError: If a parameter is not allowed.
    """
    code = _ALL_CODES[law.name]
    name = list(_MODULES)[code]
    parameters: RecordArray = np.zeros(1, nested_type({name: LAWS[law.name].parameters}))
    fill(parameters[name][0], law_parameters(law))
    return FlownLaw(code, parameters, fresh_nested({name: _MODULES[name].Memory}, (1,)))


class LawTables(NamedTuple):
    """Laws of a batch's UAVs."""

    codes: IntArray
    """A value of `CODES`. Shape (UAVs,)."""
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


def law_tables(laws: Sequence[Law]) -> LawTables:
    """Return the tables of the UAVs' laws, keys of `CODES`."""
    codes = np.array([CODES[law.name] for law in laws], dtype=np.int64)
    kinds = {name: _PARAMETERS[name] for name in _contained(codes)}
    table = np.zeros(len(laws), nested_type(kinds))
    for name, code in _contained(codes).items():
        own = [k for k, other in enumerate(codes) if other == code]
        if own:
            table[name][own] = records(kinds[name], [law_parameters(laws[k]) for k in own])
    return LawTables(codes, table)


def law_memories(tables: LawTables, worlds: int) -> RecordArray:
    """Return the memories of the laws in all worlds, nested by name. Shape (worlds, UAVs)."""
    kinds = {name: _MODULES[name].Memory for name in _contained(tables.codes)}
    return fresh_nested(kinds, (worlds, len(tables.codes)))
