"""Entry points through which extensions and other packages extend Outrider, and their optional dependencies.

A package must not stop a command: an entry point that cannot be read or imported is ignored, with one line.
"""

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from importlib import import_module
from importlib.machinery import ModuleSpec
from importlib.metadata import (
    EntryPoint,
    PackageNotFoundError,
    distributions,
    entry_points,
    metadata,
    requires,
)
from importlib.metadata import version as version_of
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from bus.errors import Ended, OutriderError, ScenarioError, place_in_user_code, shortened

GROUPS = (
    *("bodies", "commands", "companions", "drivers", "laws"),
    *("policies", "profiles", "roles", "sensors", "sinks"),
)
"""Groups of entry points, `outrider.<group>`."""

_OURS = "outrider"
_REPORTED = "OUTRIDER_IGNORED"
"""Variable with the lines that were written already: processes started from this one do not repeat them."""
_UNNAMED = "a package without a name"
_Kind = TypeVar("_Kind")


def registered(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of `outrider.<group>` by name, Outrider's own first.

    If two packages use the same name, the first wins, with a warning.
    """
    found: dict[str, EntryPoint] = {}
    entries = _entries(f"{_OURS}.{group}")
    for entry in sorted(entries, key=lambda one: (_owner(one) != _OURS, _owner(one), one.name)):
        if not _names_an_object(entry):
            ignore(entry, f"{entry.value!r} has a wrong form; allowed: module:name")
            continue
        first = found.setdefault(entry.name, entry)
        if first.value != entry.value:
            ignore(entry, f"{_owner(first)} provides it")
    return found


def load(entry: EntryPoint) -> Any:  # noqa: ANN401 - a command, a law, a sink, ...
    """Import the object of an entry point.

    Raises:
        ScenarioError: If an optional dependency is missing.
        OutriderError: If it cannot be imported for another reason.
    """
    group = entry.group.removeprefix(f"{_OURS}.")
    what = f"{'policy' if group == 'policies' else group.removesuffix('s')} {entry.name!r}"
    if _owner(entry) != _OURS:
        what += f" of {_owner(entry)}"
    return _load(entry, what)


def _load(entry: EntryPoint, what: str) -> Any:  # noqa: ANN401 - a command, a law, a sink, ...
    with foreign(what), needs(extra_of(entry), what):
        return entry.load()


@contextmanager
def foreign(what: str = "") -> Iterator[None]:
    """Explain any failure of a package's code, which may even try to exit.

    Args:
        what: Prefix of the message.

    Raises:
        OutriderError: With the failure in one line.
    """
    try:
        yield
    except (OutriderError, KeyboardInterrupt, Ended):
        raise
    except BaseException as error:
        prefix = f"{what}: " if what else ""
        raise OutriderError(f"{prefix}{_reason(error)}") from error


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
        try:
            if not is_installed(entry):
                continue  # a copy of the core without extensions
            one = _load(entry, "")
        except OutriderError as error:
            ignore(entry, error)
            continue
        fault = _fault(one, kind)
        if fault:
            ignore(entry, f"{entry.value} {fault}")
        else:
            found[name] = one
    return found


def _fault(one: object, kind: type) -> str:
    """Describe why an object is not of this kind; empty if it is."""
    if not isinstance(one, kind):
        return f"is not a {kind.__name__}"
    for field in fields(kind) if is_dataclass(kind) else ():
        value = getattr(one, field.name)
        if field.type in (str, bool) and type(value) is not field.type:
            return f"has {field.name} = {value!r}: wrong type; allowed: {field.type.__name__}"
    return ""


def is_installed(entry: EntryPoint) -> bool:
    """Return true if Python finds the package of an entry point.

    Raises:
        OutriderError: If the package cannot be searched for.
    """
    with foreign():
        return find_spec(entry.module.partition(".")[0]) is not None


def about(entry: EntryPoint) -> str:
    """Return the first line of the docstring of an entry point's package.

    By contract, an extension's package imports nothing else.

    Raises:
        OutriderError: If the package cannot be imported.
    """
    with foreign():
        return str(import_module(entry.module.partition(".")[0]).__doc__ or "").partition("\n")[0]


def python_files(folder: Path) -> list[Path]:
    """Return the Python files in a folder, in a fixed order.

    Editors leave other things with such names: Emacs' lock is a dangling link.
    """
    return sorted(path for path in folder.rglob("*.py") if path.is_file())


def source_files() -> list[Path]:
    """Return the source files of all packages with Outrider entry points, in a fixed order."""
    entries = [entry for group in GROUPS for entry in registered(group).values()]
    found: list[Path] = []
    for name in sorted({entry.module.partition(".")[0] for entry in entries}):
        spec = _spec(name)
        if spec is not None and spec.submodule_search_locations is not None:
            for folder in spec.submodule_search_locations:
                found += python_files(Path(folder))
        elif spec is not None and spec.origin and Path(spec.origin).is_file():
            found.append(Path(spec.origin))
    return found


def _spec(package: str) -> ModuleSpec | None:
    try:
        with foreign():
            return find_spec(package)
    except OutriderError:
        return None


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


def ignore(entry: EntryPoint, why: object) -> None:
    """Report that an entry point is ignored, once in this process and in those that it starts."""
    _report(f"{entry.group}: {entry.name!r} of {_owner(entry)} is ignored: {why}")


def ignore_named(group: str, name: str, why: object) -> None:
    """Report that an entry point of `outrider.<group>` is ignored; see `ignore`."""
    known = registered(group)
    if name in known:
        ignore(known[name], why)
    else:
        _report(f"{_OURS}.{group}: {name!r} is ignored: {why}")


def _report(text: str) -> None:
    line = "".join(c if c.isprintable() else "?" for c in shortened(text, 300))
    before = os.environ.get(_REPORTED, "").splitlines()
    if line not in before:
        os.environ[_REPORTED] = "\n".join((*before, line))
        sys.stderr.write(f"{_OURS}: {line}\n")


def _reason(error: BaseException) -> str:
    kind = "" if isinstance(error, ImportError | AttributeError) else f"{type(error).__name__}: "
    place = place_in_user_code(error)
    return shortened(f"{kind}{error}").rstrip(": ") + (f" ({place})" if place else "")


def _names_an_object(entry: EntryPoint) -> bool:
    """Return true if the value of an entry point is `module:name`."""
    try:
        parts = f"{entry.module}.{entry.attr}".split(".")
    except (AttributeError, ValueError):  # by version of Python
        return False
    return all(part.isidentifier() for part in parts)


def _entries(group: str) -> Iterable[EntryPoint]:
    try:
        return entry_points(group=group)
    except Exception:  # noqa: BLE001 - damaged metadata of one package
        return [entry for entry in _readable_entries() if entry.group == group]


def _readable_entries() -> Iterator[EntryPoint]:
    """Yield the entry points of all packages whose metadata can be read; of two copies of a package, only the first."""
    seen: set[str] = set()
    for package in distributions():
        name = _UNNAMED
        try:
            name = package.name or _UNNAMED
            entries = list(package.entry_points) if name not in seen else []
        except Exception as error:  # noqa: BLE001 - damaged metadata
            _report(f"the metadata of {name} is ignored: {_reason(error)}")
        else:
            seen.update({name} - {_UNNAMED})
            yield from entries


def _is_installed(name: str) -> bool:
    try:
        version_of(name)
    except PackageNotFoundError:
        return False
    return True


def _owner(entry: EntryPoint) -> str:
    try:
        return "" if entry.dist is None else entry.dist.name or _UNNAMED
    except Exception:  # noqa: BLE001 - damaged metadata
        return _UNNAMED
