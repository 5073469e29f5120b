"""Import of objects that the user names as `module:name` or `mine.py:name`."""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from bus.errors import Ended, ScenarioError, error_with_place, shortened
from sim.input.faults import near

_HOME = Path(__file__).resolve().parents[2]
"""Folder that holds Outrider's packages."""
_ENDING = ".py"


def find_object(name: str, what: str) -> Any:  # noqa: ANN401 - any object
    """Return the object named `module:name`; modules in the working folder are found last.

    Args:
        name: Module or file in the working folder, a colon, and the object's name.
        what: Field that names the object, for errors.

    Raises:
        ScenarioError: If the object does not exist, its module cannot be imported, or Python finds another module.
    """
    module_name, _, wanted = name.partition(":")
    if not (module_name and wanted):
        raise ScenarioError(f"{what} = {name!r}: wrong form; allowed: module:function")
    module = _module(module_name.removesuffix(_ENDING), f"{what} = {name!r}")
    if _hides_a_file(module, module_name):
        raise ScenarioError(
            f"{what} = {name!r}: {_own_file(module_name).name} in this folder is hidden by {_place(module)}; allowed: "
            "a file whose name no other module has"
        )
    try:
        return getattr(module, wanted)
    except AttributeError as error:
        known = [one for one in vars(module) if not one.startswith("_")]
        raise ScenarioError(
            f"{what} = {name!r}: {_place(module)} has no {wanted!r}{near(wanted, known)}"
        ) from error


def _own_file(module_name: str) -> Path:
    """Return the path of a module's file in the working folder; the file need not exist."""
    return Path.cwd() / f"{module_name.removesuffix(_ENDING)}{_ENDING}"


def _place(module: ModuleType) -> str:
    """Describe the file in which Python found a module."""
    file = getattr(module, "__file__", None)
    return str(file) if file else f"Python's own module {module.__name__!r}"


def _hides_a_file(module: ModuleType, module_name: str) -> bool:
    """Return true if the user means a file in the working folder, but Python has found another module.

    A name that ends in .py, or the name of a module of Python's own, surely means the file. The name of a library's
    module may mean the library.
    """
    file, found = _own_file(module_name), getattr(module, "__file__", None)
    certain = module_name.endswith(_ENDING) or module.__name__ in sys.stdlib_module_names
    return certain and file.is_file() and (not found or Path(found).resolve() != file.resolve())


def _module(name: str, where: str) -> ModuleType:
    working_folder = Path.cwd()
    _search_last(str(working_folder))
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name not in (
            name,
            *(name.rsplit(".", k)[0] for k in range(1, name.count(".") + 1)),
        ):
            raise ScenarioError(f"{where}: {error}{_hidden(working_folder)}") from error
        known = sorted(file.stem for file in working_folder.glob(f"*{_ENDING}"))
        raise ScenarioError(
            f"{where}: no module {error.name!r} in this folder or on Python's path{near(name, known)}"
        ) from error
    except ImportError as error:
        raise ScenarioError(f"{where}: {error}{_hidden(working_folder)}") from error
    except Ended:
        raise
    except (Exception, SystemExit) as error:
        reason = shortened(error_with_place(error))
        raise ScenarioError(f"{where}: cannot be imported: {reason}") from error


def _search_last(folder: str) -> None:
    """Add a folder to Python's path, after all libraries, so that no file in it replaces a library.

    It comes before a clone of Outrider that is installed in editable mode: other files in the clone must not hide the
    user's. Outrider's own packages are loaded by then.
    """
    if folder in sys.path:
        return
    is_clone = (_HOME / "pyproject.toml").exists()
    clone = [one for one in sys.path if is_clone and Path(one).resolve() == _HOME]
    sys.path[:] = [*(one for one in sys.path if one not in clone), folder, *clone]


def _hidden(folder: Path) -> str:
    """Name the user's files that Python does not find because a package of Outrider has the same name."""
    own = [
        path.name
        for name in ("agents", "bus", "outrider", "sim")
        for path in (folder / f"{name}.py", folder / name / "__init__.py")
        if path.exists() and not Path(__file__).is_relative_to(folder)
    ]
    return (
        f" ({', '.join(own)} in this folder is hidden by Outrider's package of that name)"
        if own
        else ""
    )
