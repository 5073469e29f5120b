"""Functions of the user's own, named as module:function."""

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.control.orbit import check_path
from agents.control.visibility import switching_radius
from agents.control.weighting import check_weighting
from bus.errors import ScenarioError

if TYPE_CHECKING:
    from sim.scenario import Scenario


def load_function(name: str, *, what: str) -> Callable[..., Any] | None:
    """The function that `module:function` names; None for an empty name. The working folder is searched too.

    Args:
        name: Where it is.
        what: What it is for, for the error.

    Raises:
        ScenarioError: If it is not there, or no function.
    """
    if not name:
        return None
    module_name, separator, function_name = name.partition(":")
    if not (separator and module_name and function_name):
        raise ScenarioError(f"{what} = {name!r}: not of the form module:function")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    try:
        function = getattr(import_module(module_name), function_name)
    except (ImportError, AttributeError) as error:
        raise ScenarioError(f"{what} = {name!r}: {error}") from error
    if not callable(function):
        raise ScenarioError(f"{what} = {name!r}: not a function")
    loaded: Callable[..., Any] = function
    return loaded


def check_own_functions(scenario: "Scenario") -> tuple[str, ...]:
    """Load the scenario's own functions and hold them against what the paper asks of them, before anything is started.

    Returns:
        Warnings, one a line, where a path cannot be followed.

    Raises:
        ScenarioError: If a function is not there or does not fit.
    """
    weighting = load_function(scenario.custom.weighting, what="custom.weighting")
    path = load_function(scenario.custom.path, what="custom.path")
    load_function(scenario.custom.policy, what="custom.policy")
    ugvs = {ugv.name: ugv for ugv in scenario.ugv}
    warnings: list[str] = []
    for uav in scenario.uav:
        r_v, v_g = scenario.visibility.radius, ugvs[uav.escorts].max_speed
        if weighting is not None and scenario.law.name == "weighted":
            check_weighting(weighting, switching_radius(r_v, uav.max_speed, v_g, uav.max_acceleration))
        if path is not None and scenario.law.name == "path":
            warnings += check_path(path, scenario.duration, r_v, uav.max_speed, v_g, uav.max_acceleration)
    return tuple(dict.fromkeys(warnings))
