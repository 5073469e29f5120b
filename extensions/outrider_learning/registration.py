"""Gymnasium and PettingZoo names of the suites' tasks, such as `outrider/Suite-Noise-v0`.

Importing this module registers them; `gymnasium.make("outrider_learning.registration:outrider/Suite-Noise-v0")` needs
no import.
"""

from typing import TYPE_CHECKING, Any

import outrider.registration
from outrider.registration import drawing, refuse_limit, register_names
from outrider_learning.suite.tasks import SUITES, Suite

if TYPE_CHECKING:
    from pettingzoo import AECEnv, ParallelEnv  # type: ignore[import-untyped]

    from outrider.envs.single import SingleEnv
    from outrider.envs.vector import OutriderVectorEnv

_TASKS = Suite(task for tasks in SUITES.values() for task in tasks)


@drawing
def single(*, task: str, **settings: Any) -> "SingleEnv":  # noqa: ANN401 - the environment's settings
    """Create a task's environment for `gymnasium.make`."""
    return _TASKS[task].make_single(**settings)


def vector(*, num_envs: int, task: str, **settings: Any) -> "OutriderVectorEnv":  # noqa: ANN401
    """Create a task's environment for `gymnasium.make_vec`.

    Raises:
        ValueError: If `max_episode_steps` is given, which Gymnasium supports for single environments only.
    """
    refuse_limit(settings, "max_episode_steps", "not supported for many worlds")
    return _TASKS[task].make(num_envs, **settings)


def parallel(*, task: str, **settings: Any) -> "ParallelEnv[str, Any, Any]":  # noqa: ANN401
    """Create a task's environment for `pettingzoo.make("parallel", ...)`.

    Raises:
        ValueError: If a limit of cycles is given: episodes end by themselves.
    """
    return outrider.registration.parallel(scenario=_TASKS[task].scenario, **settings)


def turn_based(*, task: str, **settings: Any) -> "AECEnv[str, Any, Any]":  # noqa: ANN401
    """Create a task's environment for `pettingzoo.make("aec", ...)`."""
    return outrider.registration.turn_based(scenario=_TASKS[task].scenario, **settings)


def register() -> None:
    """Register the names; repeated calls do nothing."""
    register_names({task.env_id: {"task": task.name} for task in _TASKS}, __name__)


register()
