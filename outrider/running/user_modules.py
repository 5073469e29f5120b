"""The object that the user names as `module:name`, or as `mine.py:name`."""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from bus.errors import ScenarioError, error_with_place, shortened
from sim.input.faults import near

_HOME = Path(__file__).resolve().parents[2]
"""The folder that our packages lie in."""
_ENDING = ".py"


def find_object(name: str, what: str) -> Any:  # noqa: ANN401 - whatever it is
    """Return the object that `module:name` names. The working folder is searched last.

    Args:
        name: Its module, or its file in the working folder, and its name there.
        what: What it is for, for the error.

    Raises:
        ScenarioError: If it is not there, its module cannot be imported, or Python finds another module.
    """
    module_name, _, wanted = name.partition(":")
    if not (module_name and wanted):
        raise ScenarioError(f"{what} = {name!r}: not of the form module:function")
    module = _module(module_name.removesuffix(_ENDING), f"{what} = {name!r}")
    if _hides_a_file(module, module_name):
        raise ScenarioError(
            f"{what} = {name!r}: {_own_file(module_name).name} in this folder is not found, as Python finds "
            f"{_place(module)} under its name; allowed: a file whose name no other module has"
        )
    try:
        return getattr(module, wanted)
    except AttributeError as error:
        known = [one for one in vars(module) if not one.startswith("_")]
        raise ScenarioError(
            f"{what} = {name!r}: {_place(module)} has no {wanted!r}{near(wanted, known)}"
        ) from error


def _own_file(module_name: str) -> Path:
    """The user's file of a module in the working folder, whether it is there or not."""
    return Path.cwd() / f"{module_name.removesuffix(_ENDING)}{_ENDING}"


def _place(module: ModuleType) -> str:
    """Where a module was found, for a person."""
    file = getattr(module, "__file__", None)
    return str(file) if file else f"the module {module.__name__!r} of Python itself"


def _hides_a_file(module: ModuleType, module_name: str) -> bool:
    """True if the user means a file in the working folder, and Python has found another.

    That is certain where the file itself is named; a library's module may well have a file's name, Python's own may
    not.
    """
    file, found = _own_file(module_name), getattr(module, "__file__", None)
    certain = module_name.endswith(_ENDING) or module.__name__ in sys.stdlib_module_names
    return certain and file.is_file() and (not found or Path(found).resolve() != file.resolve())


def _module(name: str, where: str) -> ModuleType:
    here = Path.cwd()
    _search_last(str(here))
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in (
            name,
            *(name.rsplit(".", k)[0] for k in range(1, name.count(".") + 1)),
        ):
            raise ScenarioError(f"{where}: {error}{_hidden(here)}") from error
        known = sorted(file.stem for file in here.glob(f"*{_ENDING}"))
        raise ScenarioError(
            f"{where}: no module {error.name!r} in this folder or on Python's path{near(name, known)}"
        ) from error
    except ImportError as error:
        raise ScenarioError(f"{where}: {error}{_hidden(here)}") from error
    except Exception as error:
        reason = shortened(error_with_place(error))
        raise ScenarioError(f"{where}: cannot be imported: {reason}") from error


def _search_last(folder: str) -> None:
    """Let modules of a folder be found: behind all libraries, so that no file there takes one's place.

    But before a clone that is installed as it lies there: what a user has written in it beside our packages, which are
    loaded by now, is of no other folder.
    """
    if folder in sys.path:
        return
    is_clone = (_HOME / "pyproject.toml").exists()
    clone = [one for one in sys.path if is_clone and Path(one).resolve() == _HOME]
    sys.path[:] = [*(one for one in sys.path if one not in clone), folder, *clone]


def _hidden(folder: Path) -> str:
    """Name the user's files that Python does not find, as a package of ours has their name."""
    own = [
        path.name
        for name in ("agents", "bus", "outrider", "sim")
        for path in (folder / f"{name}.py", folder / name / "__init__.py")
        if path.exists() and not Path(__file__).is_relative_to(folder)
    ]
    return f" ({', '.join(own)} beside it is not found: Outrider has that name)" if own else ""
