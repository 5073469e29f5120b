"""Checks of the agents' actions, which become the world's commands."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import FloatArray

LARGEST = 1e6
"""Largest component of an action [m/s²]; the same limit as on the bus."""


ACTION_COLUMNS = 4
"""Columns of an array of actions: acceleration x, y and z [m/s²], and the request for a role."""
PLANAR, SPATIAL, REQUEST = (0, 1), (0, 1, 2), 3
"""Columns of an action in the plane, of one in space, and of the request for a role."""

Columns = Mapping[str, tuple[int, ...]]
"""Columns of an action's entries, by agent."""

_COUNTS = {2: "two", 3: "three", 4: "four"}
_MEANINGS = {
    PLANAR: "the acceleration x and y [m/s²]",
    SPATIAL: "the acceleration x, y and z [m/s²]",
}
_MEANINGS |= {
    (*columns, REQUEST): f"{meaning}, and the request for a role"
    for columns, meaning in _MEANINGS.items()
}


def check_by_agent(actions: object, agents: Iterable[str]) -> None:
    """Check that actions are given by agent.

    Raises:
        ValueError: If they are not a mapping.
    """
    if not isinstance(actions, Mapping):
        raise ValueError(
            f"actions = {actions!r}: not by agent; allowed: a dictionary with one for each of {', '.join(agents)}"
        )


def take_actions(actions: Mapping[str, npt.ArrayLike], columns: Columns) -> list[list[float]]:
    """Check each agent's action and return them as rows, in the order of `columns`. Shape (agents, ACTION_COLUMNS).

    Args:
        actions: Action of each agent.
        columns: Agents, and the columns of their actions; the others are 0.

    Raises:
        ValueError: If an action is missing, belongs to no agent, or does not hold finite numbers, one for each column.
    """
    if len(actions) != len(columns) or any(name not in actions for name in columns):
        given = ", ".join(map(str, actions)) or "none"
        raise ValueError(f"actions for: {given}; required: one for each of {', '.join(columns)}")
    rows = []
    for name, own in columns.items():
        values = _numbers(name, actions[name], own)
        if not all(-LARGEST <= value <= LARGEST for value in values):
            raise ValueError(
                f"action of {name} = {values}: not in range; allowed: {_COUNTS[len(own)]} finite numbers of at most "
                f"{LARGEST:g} m/s²"
            )
        row = [0.0] * ACTION_COLUMNS
        for column, value in zip(own, values, strict=True):
            row[column] = value
        rows.append(row)
    return rows


def _numbers(name: str, action: npt.ArrayLike, columns: tuple[int, ...]) -> list[float]:
    length = len(columns)
    if isinstance(action, np.ndarray) and action.shape == (length,) and action.dtype.kind == "f":
        plain: list[float] = action.tolist()
        return plain
    given = _array(action)
    if given.shape != (length,) or given.dtype.kind not in "fiu":
        raise ValueError(
            f"action of {name} = {action!r}: not a vector; allowed: {_COUNTS[length]} numbers, {_MEANINGS[columns]}"
        )
    values: list[float] = given.astype(np.float64).tolist()
    return values


def _array(given: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return an array of the values; empty for a ragged list."""
    try:
        return np.asarray(given)
    except (TypeError, ValueError):
        return np.empty(0, dtype=object)


def take_batch(
    name: str, actions: npt.ArrayLike, worlds: int, columns: tuple[int, ...]
) -> FloatArray:
    """Check one vehicle's actions in many worlds. Shape (worlds, len(columns)).

    Raises:
        ValueError: If they are not finite numbers of this shape.
    """
    given, length = _array(actions), len(columns)
    if given.shape != (worlds, length) or given.dtype.kind not in "fiu":
        what = f"an array of shape {given.shape} and type {given.dtype}"
        raise ValueError(
            f"actions of {name}: {what}; allowed: ({worlds}, {length}) numbers, {_MEANINGS[columns]} in each world"
        )
    values: FloatArray = given.astype(np.float64, copy=False)
    if not np.abs(values).max() <= LARGEST:
        worst = int(np.flatnonzero(~(np.abs(values) <= LARGEST).all(axis=1))[0])
        where = f"action of {name} in world {worst} = {values[worst].tolist()}"
        raise ValueError(
            f"{where}: not in range; allowed: {_COUNTS[length]} finite numbers of at most {LARGEST:g} m/s²"
        )
    return values
