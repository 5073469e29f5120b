"""Entry points through which extensions and other packages extend Outrider, and their optional dependencies."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, metadata, requires
from importlib.metadata import version as version_of
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from bus.errors import OutriderError, ScenarioError

GROUPS = (
    *("commands", "companions", "drivers", "laws"),
    *("policies", "roles", "sensors", "sinks"),
)
"""Groups of entry points, `outrider.<group>`."""

_OURS = "outrider"
_Kind = TypeVar("_Kind")


def registered(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of `outrider.<group>` by name, Outrider's own first.

    If two packages use the same name, the first wins, with a warning: a package must not stop every command.
    """
    found: dict[str, EntryPoint] = {}
    entries = entry_points(group=f"{_OURS}.{group}")
    for entry in sorted(entries, key=lambda one: (_owner(one) != _OURS, _owner(one), one.name)):
        first = found.setdefault(entry.name, entry)
        if first.value != entry.value:
            warn(f"{entry.name!r} of {_owner(entry)} is ignored: {_owner(first)} provides it")
    return found


def load(entry: EntryPoint) -> Any:  # noqa: ANN401 - a command, a law, a sink, ...
    """Import the object of an entry point.

    Raises:
        ScenarioError: If an optional dependency is missing.
        OutriderError: If it cannot be imported for another reason.
    """
    group = entry.group.removeprefix(f"{_OURS}.")
    what = f"{'policy' if group == 'policies' else group.removesuffix('s')} {entry.name!r}"
    with needs(extra_of(entry), what):
        return entry.load()


def extra_of(entry: EntryPoint) -> str:
    """Return the extra that installs the libraries of an entry point; empty if it is not Outrider's."""
    package = entry.module.partition(".")[0]
    extra = package.removeprefix(f"{_OURS}_") if _owner(entry) == _OURS else ""
    return extra if extra in extras() else ""


def load_all(group: str, kind: type[_Kind]) -> dict[str, _Kind]:
    """Import the objects of `outrider.<group>` by name; skip those that fail, with a warning.

    Args:
        group: Name of the group.
        kind: Class of the objects.
    """
    found: dict[str, _Kind] = {}
    for name, entry in registered(group).items():
        if find_spec(entry.module.partition(".")[0]) is None:
            continue  # a copy of the core without extensions
        try:
            one = load(entry)
            if not isinstance(one, kind):
                raise TypeError(f"{entry.value} is not a {kind.__name__}")
            found[name] = one
        except Exception as error:  # noqa: BLE001 - a package must not stop every command
            warn(f"{entry.group}: {name!r} of {_owner(entry)} is ignored: {error}")
    return found


def source_files() -> list[Path]:
    """Return the source files of all packages with Outrider entry points, in a fixed order."""
    installed = entry_points()  # reads the metadata of all packages
    entries = [entry for group in GROUPS for entry in installed.select(group=f"{_OURS}.{group}")]
    found: list[Path] = []
    for name in sorted({entry.module.partition(".")[0] for entry in entries}):
        spec = find_spec(name)
        if spec is not None and spec.submodule_search_locations is not None:
            for folder in spec.submodule_search_locations:
                found += sorted(Path(folder).rglob("*.py"))
        elif spec is not None and spec.origin:
            found.append(Path(spec.origin))
    return found


@contextmanager
def needs(extra: str, what: str = "", kind: type[OutriderError] = ScenarioError) -> Iterator[None]:
    """Explain an import error caused by an extra that is not installed.

    Args:
        extra: Name of the extra; empty: not one of Outrider's.
        what: Prefix of the message, such as an option.
        kind: Class of the error.

    Raises:
        OutriderError: With the missing package and the command that installs it.
    """
    try:
        yield
    except ImportError as error:
        prefix = f"{what}: " if what else ""
        if not extra or (error.name or "").partition(".")[0] in (_OURS, "bus", "sim", "agents"):
            raise OutriderError(f"{prefix}{error}") from error
        raise kind(f"{prefix}{error.name} is missing: {install_command(extra)}") from error


def require(extra: str, what: str = "") -> None:
    """Check that all packages of an extra are installed.

    Raises:
        ScenarioError: If one is missing, with the command that installs it.
    """
    for package in missing(extra):
        prefix = f"{what}: " if what else ""
        raise ScenarioError(f"{prefix}{package} is missing: {install_command(extra)}")


def install_command(extra: str) -> str:
    """Return the shell command that installs an extra from the clone."""
    return f"pip install -e '.[{extra}]'"


def extras() -> tuple[str, ...]:
    """Return the names of all extras that a user can install."""
    names = metadata(_OURS).get_all("Provides-Extra") or []
    return tuple(name for name in names if name not in ("dev", "docs"))


def packages(extra: str) -> tuple[str, ...]:
    """Return the distributions that an extra adds, by name."""
    from packaging.requirements import Requirement  # noqa: PLC0415 - 10 ms, seldom needed

    wanted = [Requirement(text) for text in requires(_OURS) or ()]
    return tuple(
        one.name
        for one in wanted
        if one.marker is not None and one.marker.evaluate({"extra": extra})
    )


def missing(extra: str) -> tuple[str, ...]:
    """Return the distributions of an extra that are not installed, by name."""
    return tuple(name for name in packages(extra) if not _is_installed(name))


def warn(text: str) -> None:
    """Write a line to standard error."""
    sys.stderr.write(f"{_OURS}: {text}\n")


def _is_installed(name: str) -> bool:
    try:
        version_of(name)
    except PackageNotFoundError:
        return False
    return True


def _owner(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else ""
