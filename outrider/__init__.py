"""Outrider: simulation of UAVs that escort ground vehicles and keep them in sight.

Main functions: `outrider.load_scenario`, `outrider.run`, `outrider.parallel_env`, and `outrider.vector_env` for many
worlds at once. The module behind a name is loaded on first use.
"""

import os
import sys
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bus.errors import ScenarioError as ScenarioError
    from outrider.envs.parallel import parallel_env as parallel_env
    from outrider.envs.single import single_env as single_env
    from outrider.envs.vector import parallel_vector_env as parallel_vector_env
    from outrider.envs.vector import vector_env as vector_env
    from outrider.running.flying import run as run
    from outrider.running.user_code import load_policy as load_policy
    from sim.env.rewards import RewardWeights as RewardWeights
    from sim.scenario.loading import load_scenario as load_scenario
    from sim.scenario.loading import scenario_names as scenario_names

_WHERE = {
    "RewardWeights": "sim.env.rewards",
    "ScenarioError": "bus.errors",
    "load_policy": "outrider.running.user_code",
    "load_scenario": "sim.scenario.loading",
    "parallel_env": "outrider.envs.parallel",
    "parallel_vector_env": "outrider.envs.vector",
    "run": "outrider.running.flying",
    "scenario_names": "sim.scenario.loading",
    "single_env": "outrider.envs.single",
    "vector_env": "outrider.envs.vector",
}

__all__ = [
    "RewardWeights",
    "ScenarioError",
    "load_policy",
    "load_scenario",
    "parallel_env",
    "parallel_vector_env",
    "run",
    "scenario_names",
    "single_env",
    "vector_env",
]


_OURS = ("agents", "bus", "sim")
"""Other packages of Outrider, with names that a user's project may have, too."""


def _is_module() -> bool:
    """Return true for `python -m outrider`."""
    return sys.argv[:1] == ["-m"] and "outrider" in sys.orig_argv


def _is_command() -> bool:
    """Return true if this process is the command `outrider`, or one of its children."""
    return _is_module() or os.path.basename("".join(sys.argv[:1])) == "outrider"


def _check_names() -> None:
    """Check that no other module hides a package of Outrider.

    Raises:
        ImportError: If one does; the message names it in one line.
    """
    root = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
    as_module = _is_module()
    # `python -m outrider` removes the working folder from the path, but only after this check.
    is_unsafe = as_module and not sys.flags.safe_path
    for name in _OURS:
        spec = PathFinder.find_spec(name, sys.path[1:]) if is_unsafe else find_spec(name)
        places = [spec.origin or "", *(spec.submodule_search_locations or ())] if spec else []
        if not places or os.path.realpath(places[-1]) == os.path.join(root, name):
            continue
        line = (
            f"{places[0] or places[-1]} hides Outrider's package {name!r}: "
            "rename it, or start Python with -P or in another folder"
        )
        if _is_command():
            sys.exit(f"outrider: {line}")
        raise ImportError(line)


_check_names()


def __getattr__(name: str) -> Any:  # noqa: ANN401 - a module's names have any type
    if name in _WHERE:
        return getattr(import_module(_WHERE[name]), name)
    raise AttributeError(f"module 'outrider' has no attribute {name!r}")


# The commands make no environment by name, and the import of Gymnasium takes time.
if not _is_command():
    import_module("outrider.registration")
