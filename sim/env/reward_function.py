"""Rewards by a user's function of the true metrics."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Metrics = dict[str, dict[str, FloatArray]]
"""True metrics of each vehicle in all worlds: arrays of shape (worlds,), one world included."""

RewardFunction = Callable[[Metrics], Mapping[str, npt.ArrayLike]]
"""Function from the metrics after a tick to the rewards of some vehicles, shape (worlds,) each.

The other vehicles receive the rewards of `RewardWeights`. The metrics are true: rewards train a policy, and no vehicle
observes them.
"""


def rewards_by(
    function: RewardFunction, metrics: Metrics, names: Sequence[str], weighted: FloatArray
) -> FloatArray:
    """Return the rewards of one tick by a user's function. Shape (worlds, vehicles).

    Args:
        function: The user's function.
        metrics: Its argument; copies, so that it cannot change the state.
        names: Vehicles in the order of the rewards.
        weighted: Rewards by `RewardWeights`, for vehicles without a reward by the function. Shape (worlds, vehicles).

    Raises:
        TypeError: If the function does not return rewards by vehicle.
        ValueError: If a vehicle is unknown, or a reward is not finite or of another shape.
    """
    found: Any = function(metrics)
    if not isinstance(found, Mapping):
        raise TypeError(f"reward_function: returned {found!r}; allowed: rewards by vehicle")
    paid = weighted.copy()
    for name, reward in found.items():
        if name not in names:
            raise ValueError(
                f"reward_function: {name!r}: no such vehicle; allowed: {', '.join(names)}"
            )
        try:
            given = np.asarray(reward, dtype=np.float64)
        except (TypeError, ValueError):
            given = np.full((), np.nan)
        if given.shape not in ((), (len(paid),)) or not np.isfinite(given).all():
            raise ValueError(
                f"reward_function: {name!r}: {reward!r}; allowed: finite numbers of shape ({len(paid)},)"
            )
        paid[:, names.index(name)] = given
    return paid
