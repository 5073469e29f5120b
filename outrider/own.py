"""Functions of the user's own, named as module:function."""

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from bus.errors import ScenarioError


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
