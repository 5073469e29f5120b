"""Files that a scenario names: a trace, or a file of profiles."""

import os
from pathlib import Path

from bus.errors import ScenarioError
from bus.files import read_regular
from sim.input.faults import one_line


def read_named(name: str, where: str, folder: Path | None, *, most: int, rule: str) -> bytes:
    """Return the content of a file.

    Args:
        name: Path as given, relative to the folder.
        where: Prefix of error messages.
        folder: Folder in which the file must lie, or below, as the scenario's file names it; None: the user names it,
            relative to the current folder.
        most: Maximum size [bytes].
        rule: Allowed files, for error messages.

    Raises:
        ScenarioError: If it cannot be read, or lies outside.
    """
    try:
        path = Path(name) if folder is None else _below(folder, name, where)
        return read_regular(path, most)
    except ScenarioError:
        raise
    except (OSError, ValueError) as error:  # a ValueError: a NUL in the path
        reason = one_line(str(getattr(error, "strerror", None) or error))
        raise ScenarioError(f"{where}: cannot be read: {reason}; allowed: {rule}") from error


def _below(folder: Path, name: str, where: str) -> Path:
    """Return the path of a file in this folder or below.

    Raises:
        ScenarioError: If it lies outside.
    """
    path = Path(os.path.realpath(folder / name))
    if Path(name).is_absolute() or not path.is_relative_to(os.path.realpath(folder)):
        raise ScenarioError(
            f"{where}: outside the scenario's folder; allowed: a file in that folder or below, "
            "or any file with --set"
        )
    return path
