"""The environments' names at Gymnasium and PettingZoo: `outrider/Escort-v0`, and one for each task of the suite.

Gymnasium asks no package for its names; it imports the module in front of a colon,
`outrider.registration:outrider/Escort-v0`,
and expects it to have registered them. Therefore, and only here, importing does something. PettingZoo, which has a
registry from 1.27 on, is told where it has been imported; nobody else pays for its import.
"""

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import gymnasium

from outrider_learning.suite.tasks import BASE, MISSIONS, TASKS, Suite

if TYPE_CHECKING:
    from pettingzoo import AECEnv, ParallelEnv  # type: ignore[import-untyped]

    from outrider.envs.single import SingleEnv
    from outrider.envs.vector import OutriderVectorEnv

ESCORT = "outrider/Escort-v0"
_Maker = TypeVar("_Maker", bound=Callable[..., Any])
_TASKS = Suite((*TASKS, *MISSIONS))


def _drawing(maker: _Maker) -> _Maker:
    """Say what the environments draw: Gymnasium reads it before it makes one."""
    maker.metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # type: ignore[attr-defined]
    return maker


@_drawing
def single(*, task: str = "", **settings: Any) -> "SingleEnv":  # noqa: ANN401 - those of the environment
    """Makes what `gymnasium.make` returns: `outrider.single_env`, of a task of the suite if one is named."""
    from outrider.envs.single import SingleEnv  # noqa: PLC0415 - compiled code stands behind it

    return _TASKS[task].make_single(**settings) if task else SingleEnv(**settings)


def vector(*, num_envs: int, task: str = "", **settings: Any) -> "OutriderVectorEnv":  # noqa: ANN401
    """Makes what `gymnasium.make_vec` returns: `outrider.vector_env`, of a task of the suite if one is named.

    Raises:
        ValueError: If it is given a limit of steps, which Gymnasium can put around single environments only.
    """
    from outrider.envs.vector import OutriderVectorEnv  # noqa: PLC0415

    if "max_episode_steps" in settings:
        limit = settings["max_episode_steps"]
        raise ValueError(
            f"max_episode_steps = {limit!r}: not for many worlds at once; allowed: duration=..., in s"
        )
    return (
        _TASKS[task].make(num_envs, **settings)
        if task
        else OutriderVectorEnv(num_envs=num_envs, **settings)
    )


def parallel(*, task: str = "", **settings: Any) -> "ParallelEnv[str, Any, Any]":  # noqa: ANN401
    """Makes `outrider.parallel_env`, of a task of the suite if one is named, for `pettingzoo.make("parallel", ...)`.

    Raises:
        ValueError: If it is given a limit of cycles: episodes end by themselves.
    """
    from outrider.envs.parallel import parallel_env  # noqa: PLC0415

    if "max_cycles" in settings:
        limit = settings["max_cycles"]
        raise ValueError(
            f"max_cycles = {limit!r}: episodes have a length; allowed: duration=..., in s"
        )
    return parallel_env(_TASKS[task].scenario, **settings) if task else parallel_env(**settings)


def turn_based(**settings: Any) -> "AECEnv[str, Any, Any]":  # noqa: ANN401
    """Makes the same with agents that act one after the other, for `pettingzoo.make("aec", ...)`."""
    from pettingzoo.utils import parallel_to_aec  # type: ignore[import-untyped]  # noqa: PLC0415

    return parallel_to_aec(parallel(**settings))


def env_ids() -> tuple[str, ...]:
    """All the names, the shipped escort's first."""
    return (ESCORT, *(task.env_id for task in _TASKS))


def register() -> None:
    """Tell Gymnasium, and PettingZoo where it has been imported, the environments' names; again does nothing.

    No limit of steps is registered: the episodes end by themselves, and a second limit would only hide it.
    """
    settings: dict[str, dict[str, str]] = {ESCORT: {"scenario": BASE}} | {
        task.env_id: {"task": task.name} for task in _TASKS
    }
    for env_id, kwargs in settings.items():
        if env_id not in gymnasium.registry:
            gymnasium.register(
                env_id,
                entry_point="outrider.registration:single",
                vector_entry_point="outrider.registration:vector",
                kwargs=kwargs,
            )
    pettingzoo = sys.modules.get("pettingzoo")
    if pettingzoo is not None and hasattr(pettingzoo, "parallel_registry"):
        for env_id, kwargs in settings.items():
            if env_id not in pettingzoo.parallel_registry:
                for kind, maker in (("parallel", "parallel"), ("aec", "turn_based")):
                    entry_point = f"outrider.registration:{maker}"
                    pettingzoo.register(kind, env_id, entry_point=entry_point, kwargs=kwargs)


register()
