"""Registration of `outrider/Escort-v0` with Gymnasium and PettingZoo.

Gymnasium imports the module before the colon of `outrider.registration:outrider/Escort-v0` and expects it to register
the name. Therefore the import of this module has a side effect. Gymnasium 1 and PettingZoo read no entry points of
installed packages, so a name without its module needs an import, in any order. PettingZoo has a registry from 1.27 on.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import gymnasium
import pettingzoo  # type: ignore[import-untyped]
from pettingzoo.utils import parallel_to_aec  # type: ignore[import-untyped]

if TYPE_CHECKING:
    from pettingzoo import AECEnv, ParallelEnv

    from outrider.envs.single import SingleEnv
    from outrider.envs.vector import OutriderVectorEnv

ESCORT = "outrider/Escort-v0"
_Maker = TypeVar("_Maker", bound=Callable[..., Any])


def drawing(maker: _Maker) -> _Maker:
    """Add the metadata that Gymnasium reads before it makes an environment."""
    maker.metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # type: ignore[attr-defined]
    return maker


@drawing
def single(**settings: Any) -> "SingleEnv":  # noqa: ANN401 - settings of the environment
    """Make the environment of `gymnasium.make`: `outrider.single_env`."""
    from outrider.envs.single import SingleEnv  # noqa: PLC0415 - it imports compiled code

    return SingleEnv(**settings)


def vector(*, num_envs: int, **settings: Any) -> "OutriderVectorEnv":  # noqa: ANN401
    """Make the environment of `gymnasium.make_vec`: `outrider.vector_env`.

    Raises:
        ValueError: If the settings limit the steps, which Gymnasium supports for single environments only.
    """
    from outrider.envs.vector import OutriderVectorEnv  # noqa: PLC0415 - it imports compiled code

    refuse_limit(settings, "max_episode_steps", "not for many worlds at once")
    return OutriderVectorEnv(num_envs=num_envs, **settings)


def parallel(**settings: Any) -> "ParallelEnv[str, Any, Any]":  # noqa: ANN401
    """Make the environment of `pettingzoo.make("parallel", ...)`: `outrider.parallel_env`.

    Raises:
        ValueError: If the settings limit the cycles: the scenario's duration ends an episode.
    """
    from outrider.envs.parallel import parallel_env  # noqa: PLC0415 - it imports compiled code

    refuse_limit(settings, "max_cycles", "episodes have a length")
    return parallel_env(**settings)


def turn_based(**settings: Any) -> "AECEnv[str, Any, Any]":  # noqa: ANN401
    """Make the environment of `pettingzoo.make("aec", ...)`, whose agents act one after the other."""
    return parallel_to_aec(parallel(**settings))


def refuse_limit(settings: Mapping[str, Any], name: str, why: str) -> None:
    """Check that the settings have no second limit of an episode's length.

    Raises:
        ValueError: If they have one.
    """
    if name in settings:
        raise ValueError(f"{name} = {settings[name]!r}: {why}; allowed: duration=..., in s")


def register_names(names: Mapping[str, Mapping[str, str]], module: str) -> None:
    """Register environments with Gymnasium, and with PettingZoo if it has a registry; repeated calls do nothing.

    No limit of steps is registered: the scenario's duration ends an episode.

    Args:
        names: Arguments of the makers of each environment, by its name.
        module: Module with the makers `single`, `vector`, `parallel` and `turn_based`.
    """
    for env_id, kwargs in names.items():
        if env_id not in gymnasium.registry:
            gymnasium.register(
                env_id,
                entry_point=f"{module}:single",
                vector_entry_point=f"{module}:vector",
                kwargs=dict(kwargs),
            )
    if hasattr(pettingzoo, "parallel_registry"):
        for env_id, kwargs in names.items():
            if env_id not in pettingzoo.parallel_registry:
                for kind, maker in (("parallel", "parallel"), ("aec", "turn_based")):
                    entry_point = f"{module}:{maker}"
                    pettingzoo.register(kind, env_id, entry_point=entry_point, kwargs=dict(kwargs))


def register() -> None:
    """Register `outrider/Escort-v0`."""
    register_names({ESCORT: {"scenario": "escort"}}, __name__)


register()
