"""The agents' actions as the world's commands, or a line that says what is allowed."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import FloatArray

LARGEST = 1e6
"""Larger components are nonsense [m/s²]; the same limit as on the bus."""


def take_actions(
    actions: Mapping[str, npt.ArrayLike], names: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Each agent's action as plain numbers, checked [m/s²].

    Args:
        actions: An acceleration [m/s²] for each agent.
        names: The agents.

    Raises:
        ValueError: If an action is missing, of no agent, or not two finite numbers.
    """
    if len(actions) != len(names) or any(name not in actions for name in names):
        given = ", ".join(map(str, actions)) or "nobody"
        raise ValueError(f"actions for: {given}; needed is one for each of: {', '.join(names)}")
    taken = {}
    for name in names:
        x, y = _pair(name, actions[name])
        if not (-LARGEST <= x <= LARGEST and -LARGEST <= y <= LARGEST):
            raise ValueError(
                f"action of {name} = [{x}, {y}]: must be two finite numbers, at most {LARGEST:g} m/s² in size"
            )
        taken[name] = x, y
    return taken


def _pair(name: str, action: npt.ArrayLike) -> list[float]:
    if isinstance(action, np.ndarray) and action.shape == (2,) and action.dtype.kind == "f":
        plain: list[float] = action.tolist()
        return plain
    pair = _array(action)
    if pair.shape != (2,) or pair.dtype.kind not in "fiu":
        raise ValueError(
            f"action of {name} = {action!r}: must be two numbers, the acceleration x and y [m/s²]"
        )
    values: list[float] = pair.astype(np.float64).tolist()
    return values


def _array(given: npt.ArrayLike) -> npt.NDArray[Any]:
    """An array of the values; of a ragged list an empty one."""
    try:
        return np.asarray(given)
    except (TypeError, ValueError):
        return np.empty(0, dtype=object)


def take_batch(name: str, actions: npt.ArrayLike, worlds: int) -> FloatArray:
    """One vehicle's actions in many worlds, checked. Shape (worlds, 2).

    Raises:
        ValueError: If they are not two finite numbers for each world.
    """
    pairs = _array(actions)
    if pairs.shape != (worlds, 2) or pairs.dtype.kind not in "fiu":
        what = f"an array of shape {pairs.shape} and type {pairs.dtype}"
        raise ValueError(
            f"actions of {name}: {what}; must be ({worlds}, 2) numbers, the acceleration x and y [m/s²] in each world"
        )
    values: FloatArray = pairs.astype(np.float64, copy=False)
    if not np.abs(values).max() <= LARGEST:
        worst = int(np.flatnonzero(~(np.abs(values) <= LARGEST).all(axis=1))[0])
        where = f"action of {name} in world {worst} = {values[worst].tolist()}"
        raise ValueError(f"{where}: must be two finite numbers, at most {LARGEST:g} m/s² in size")
    return values
