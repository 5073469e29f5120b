"""Checks of the agents' actions, which become the world's commands."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import FloatArray

LARGEST = 1e6
"""Largest component of an action [m/s²]; the same limit as on the bus."""


Lengths = Mapping[str, int]
"""Number of entries of an action by agent: 2, or 3 for a UAV that has an altitude."""

_COUNTS = {2: "two", 3: "three"}
_MEANINGS = {2: "the acceleration x and y [m/s²]", 3: "the acceleration x, y and z [m/s²]"}


def check_by_agent(actions: object, agents: Iterable[str]) -> None:
    """Check that actions are given by agent.

    Raises:
        ValueError: If they are not a mapping.
    """
    if not isinstance(actions, Mapping):
        raise ValueError(
            f"actions = {actions!r}: not by agent; allowed: a dictionary with one for each of {', '.join(agents)}"
        )


def take_actions(actions: Mapping[str, npt.ArrayLike], lengths: Lengths) -> list[list[float]]:
    """Check each agent's action and return them as plain numbers [m/s²], in the order of `lengths`.

    Args:
        actions: Acceleration of each agent [m/s²].
        lengths: Agents, and the number of entries of their actions.

    Returns:
        Three numbers for each agent; the third is 0 for a vehicle without an altitude.

    Raises:
        ValueError: If an action is missing, belongs to no agent, or is not two (three) finite numbers.
    """
    if len(actions) != len(lengths) or any(name not in actions for name in lengths):
        given = ", ".join(map(str, actions)) or "none"
        raise ValueError(f"actions for: {given}; required: one for each of {', '.join(lengths)}")
    rows = []
    for name, length in lengths.items():
        values = _numbers(name, actions[name], length)
        if not all(-LARGEST <= value <= LARGEST for value in values):
            raise ValueError(
                f"action of {name} = {values}: not in range; allowed: {_COUNTS[length]} finite numbers of at most "
                f"{LARGEST:g} m/s²"
            )
        rows.append([*values, 0.0][:3])
    return rows


def _numbers(name: str, action: npt.ArrayLike, length: int) -> list[float]:
    if isinstance(action, np.ndarray) and action.shape == (length,) and action.dtype.kind == "f":
        plain: list[float] = action.tolist()
        return plain
    given = _array(action)
    if given.shape != (length,) or given.dtype.kind not in "fiu":
        raise ValueError(
            f"action of {name} = {action!r}: not a vector; allowed: {_COUNTS[length]} numbers, {_MEANINGS[length]}"
        )
    values: list[float] = given.astype(np.float64).tolist()
    return values


def _array(given: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return an array of the values; empty for a ragged list."""
    try:
        return np.asarray(given)
    except (TypeError, ValueError):
        return np.empty(0, dtype=object)


def take_batch(name: str, actions: npt.ArrayLike, worlds: int, length: int) -> FloatArray:
    """Check one vehicle's actions in many worlds. Shape (worlds, length).

    Raises:
        ValueError: If they are not finite numbers of this shape.
    """
    given = _array(actions)
    if given.shape != (worlds, length) or given.dtype.kind not in "fiu":
        what = f"an array of shape {given.shape} and type {given.dtype}"
        raise ValueError(
            f"actions of {name}: {what}; allowed: ({worlds}, {length}) numbers, {_MEANINGS[length]} in each world"
        )
    values: FloatArray = given.astype(np.float64, copy=False)
    if not np.abs(values).max() <= LARGEST:
        worst = int(np.flatnonzero(~(np.abs(values) <= LARGEST).all(axis=1))[0])
        where = f"action of {name} in world {worst} = {values[worst].tolist()}"
        raise ValueError(
            f"{where}: not in range; allowed: {_COUNTS[length]} finite numbers of at most {LARGEST:g} m/s²"
        )
    return values
