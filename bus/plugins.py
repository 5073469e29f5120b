"""Laws, drivers and sensors of other packages, by the entry points of the packages that are installed.

An entry point of the group `outrider.laws`, `outrider.drivers` or `outrider.sensors` names a row: `module:NAME`.
"""

from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

_Row = TypeVar("_Row")


def plugin_rows(group: str, kind: type[_Row]) -> tuple[_Row, ...]:
    """Return the rows that other packages add to a table, in the order of their entry points' names.

    Raises:
        ImportError: If an entry point cannot be loaded, or names something else.
    """
    rows = []
    for point in sorted(entry_points(group=group), key=lambda one: (one.name, one.value)):
        where = f"{group}: {point.name} = {point.value}"
        try:
            row = point.load()
        except (ImportError, AttributeError) as error:
            raise ImportError(f"{where}: {error}") from error
        if not isinstance(row, kind):
            raise ImportError(f"{where}: no {kind.__name__}; allowed: a row of bus.rows")
        rows.append(row)
    return tuple(rows)


def package_files(module: str) -> list[Path]:
    """Return the source files of the package that a module is in, without importing the module."""
    spec = find_spec(module.partition(".")[0])
    if spec is None:
        return []
    if spec.submodule_search_locations is None:
        return [Path(spec.origin)] if spec.origin else []
    return sorted(
        path for folder in spec.submodule_search_locations for path in Path(folder).rglob("*.py")
    )
