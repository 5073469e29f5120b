"""Compilation with numba: strict floating point, and one cache for each state of the sources."""

import contextlib
import functools
import hashlib
import logging
import os
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from bus import plugins
from bus.errors import ScenarioError
from bus.registry import DRIVERS, LAWS, SENSORS
from sim.compiling.cache import failure_in_numba, open_cache

FloatArray = npt.NDArray[np.float64]
"""C-contiguous array of float64."""
IntArray = npt.NDArray[np.int64]
"""C-contiguous array of int64."""

_LOG = logging.getLogger("outrider.compile")
_F = TypeVar("_F", bound=Callable[..., Any])
_KEPT_CACHES, _MIN_AGE = 6, 3600.0
"""Number of newest caches kept, and time of last use within which all are kept [s]."""


def _source_digest() -> str:
    """Return a digest of all sources, of the registry's names and of the compiler versions.

    numba compares only the file of a function, not the files of the functions that it calls. Compiled code must never
    outlive a change of either, so each state of the sources has its own cache. The sources include extensions and other
    packages with entry points. The order of names is the order in which compiled code selects functions.
    """
    digest = hashlib.sha256(f"{sys.version}{numba.__version__}{np.__version__}".encode())
    root = Path(__file__).resolve().parents[2]
    for folder in ("bus", "sim", "agents", "outrider"):
        for path in plugins.python_files(root / folder):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    for path in plugins.source_files():
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    for table in (LAWS, DRIVERS, SENSORS):
        for row in table.values():
            digest.update(f"{row.name} {row.module} ".encode())
    return digest.hexdigest()[:16]


def _cache_home() -> Path:
    chosen = os.environ.get("OUTRIDER_CACHE")
    if chosen:
        return Path(chosen)
    shared = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # The XDG specification declares relative paths invalid; they must be ignored.
    return (shared if shared.is_absolute() else Path.home() / ".cache") / "outrider"


def _remove_old(home: Path) -> None:
    used: list[tuple[float, Path]] = []
    for path in home.glob("numba-*"):
        with contextlib.suppress(FileNotFoundError):  # another process may have removed it
            used.append((path.stat().st_mtime, path))
    for last, path in sorted(used, reverse=True)[_KEPT_CACHES:]:
        if time.time() - last > _MIN_AGE:
            shutil.rmtree(path, ignore_errors=True)


class Cache(NamedTuple):
    """Compile cache of this process."""

    folder: Path | None
    """Folder of the cache; None: each process compiles again."""
    fault: str = ""
    """Reason why there is no folder, or what was repaired in it; empty: neither."""


def compile_cache() -> Cache:
    """Return the compile cache for the laws, drivers and sensors that can be used.

    A row whose code fails is removed from its table. Functions that are compiled afterwards have another cache.
    """
    rows = (row for table in (LAWS, DRIVERS, SENSORS) for row in table.values())
    return _cache_of(tuple((row.name, row.module) for row in rows))


def cache_folder() -> Path | None:
    """Return the folder of the compile cache; None if there is none."""
    return compile_cache().folder


def cache_fault(error: BaseException) -> str:
    """Describe a failure to read or write the compile cache in one line; empty if the error is another one."""
    fault = failure_in_numba(error)
    remedy = "remove it, or set OUTRIDER_CACHE to a folder on another disk"
    return f"compile cache {cache_folder()}: {fault}; {remedy}" if fault else ""


@functools.cache
def _cache_of(_rows: tuple[tuple[str, str], ...]) -> Cache:
    try:
        folder = _cache_home() / f"numba-{_source_digest()}"
        removed = open_cache(folder)
        _remove_old(folder.parent)
    except (OSError, RuntimeError) as error:  # RuntimeError: this user has no home folder
        fault = str(error)
        if isinstance(error, OSError) and error.filename is not None:
            fault = f"{error.filename}: {error.strerror}"
        _LOG.warning(
            "no compile cache (%s): every start compiles for about a minute; set OUTRIDER_CACHE to a writable folder",
            fault,
        )
        return Cache(None, fault)
    numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
    if not removed:
        return Cache(folder)
    fault = f"{removed} damaged files removed"
    _LOG.warning("compile cache %s: %s; the next run compiles again", folder, fault)
    return Cache(folder, fault)


def constant(value: int) -> int:
    """Return a module constant for use as an argument of compiled functions.

    numba compiles a function once per plain number in its callers' code, but only once for all constants of its own
    integer type.
    """
    return cast("int", np.int64(value))


def _compile(function: _F, **options: Any) -> _F:  # noqa: ANN401 - numba's options
    """Compile without `fastmath`: results must not depend on the caller.

    Raises:
        ScenarioError: If numba's compiler is disabled; records have no fields in plain Python.
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        raise ScenarioError("NUMBA_DISABLE_JIT = 1: Outrider needs compiled code; allowed: 0")
    cached = cache_folder() is not None
    return cast("_F", numba.njit(cache=cached, error_model="numpy", **options)(function))


def compiled(function: _F) -> _F:
    """Compile a function of numbers, arrays and records; the Python original is its attribute `py_func`."""
    return _compile(function)


def inlined(function: _F) -> _F:
    """Compile a function into each caller, where a call would pass many arrays."""
    return _compile(function, inline="always")


def released(function: _F) -> _F:
    """Compile a loop over worlds, which runs without the interpreter's lock."""
    return _compile(function, nogil=True)
