"""Checks of the agents' actions, which become the world's commands."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sim.compiling.compile import FloatArray

LARGEST = 1e6
"""Largest component of an action [m/s²]; the same limit as on the bus."""


def take_actions(
    actions: Mapping[str, npt.ArrayLike], names: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Check each agent's action and return it as plain numbers [m/s²].

    Args:
        actions: Acceleration of each agent [m/s²].
        names: Names of the agents.

    Raises:
        ValueError: If an action is missing, belongs to no agent, or is not two finite numbers.
    """
    if len(actions) != len(names) or any(name not in actions for name in names):
        given = ", ".join(map(str, actions)) or "none"
        raise ValueError(f"actions for: {given}; required: one for each of {', '.join(names)}")
    taken = {}
    for name in names:
        x, y = _pair(name, actions[name])
        if not (-LARGEST <= x <= LARGEST and -LARGEST <= y <= LARGEST):
            raise ValueError(
                f"action of {name} = [{x}, {y}]: not in range; allowed: two finite numbers of at most {LARGEST:g} m/s²"
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
            f"action of {name} = {action!r}: not a vector; allowed: two numbers, the acceleration x and y [m/s²]"
        )
    values: list[float] = pair.astype(np.float64).tolist()
    return values


def _array(given: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return an array of the values; empty for a ragged list."""
    try:
        return np.asarray(given)
    except (TypeError, ValueError):
        return np.empty(0, dtype=object)


def take_batch(name: str, actions: npt.ArrayLike, worlds: int) -> FloatArray:
    """Check one vehicle's actions in many worlds. Shape (worlds, 2).

    Raises:
        ValueError: If they are not two finite numbers for each world.
    """
    pairs = _array(actions)
    if pairs.shape != (worlds, 2) or pairs.dtype.kind not in "fiu":
        what = f"an array of shape {pairs.shape} and type {pairs.dtype}"
        raise ValueError(
            f"actions of {name}: {what}; allowed: ({worlds}, 2) numbers, the acceleration x and y [m/s²] in each world"
        )
    values: FloatArray = pairs.astype(np.float64, copy=False)
    if not np.abs(values).max() <= LARGEST:
        worst = int(np.flatnonzero(~(np.abs(values) <= LARGEST).all(axis=1))[0])
        where = f"action of {name} in world {worst} = {values[worst].tolist()}"
        raise ValueError(
            f"{where}: not in range; allowed: two finite numbers of at most {LARGEST:g} m/s²"
        )
    return values
