"""The compile cache of numba, and the options with which our functions are compiled.

Strict floating point, one cache for one source text.
"""

import contextlib
import fcntl
import functools
import hashlib
import logging
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
"""The arrays that compiled functions take: C-contiguous float64."""

IntArray = npt.NDArray[np.int64]
"""Likewise int64."""

_LOG = logging.getLogger("outrider.compile")
_F = TypeVar("_F", bound=Callable[..., Any])
_interpreted = False
_KEEP, _IN_USE = 6, 3600.0
"""So many caches of source texts (checkouts, versions) stay, and those that a process began with within this [s]."""


_MARKS = (b"@compiled", b"@borrowing", b"@inlined", b"@released", b"@intrinsic")
_IMPORT = re.compile(rb"^from ((?:bus|sim|agents|outrider)\.[\w.]+) import", re.MULTILINE)


def _source_digest() -> str:
    """A digest of all the text that compiled code is made of.

    numba looks only at the file that holds a function, not at those that it calls: after a change in a called
    file it would run the old code. So each state of the sources has a cache of its own.
    """
    import numba  # noqa: PLC0415 - see `interpret`

    root = Path(__file__).resolve().parents[2]
    sources = {
        path.relative_to(root).as_posix(): path.read_bytes()
        for folder in ("bus", "sim", "agents", "outrider")
        for path in sorted((root / folder).rglob("*.py"))
    }
    made_of = {name for name, text in sources.items() if any(mark in text for mark in _MARKS)}
    made_of.add("sim/kernels/linking.py")  # it says what is kept of each
    for name in tuple(made_of):  # what such a file imports may be a constant in its code
        made_of |= {
            f"{module.decode().replace('.', '/')}.py" for module in _IMPORT.findall(sources[name])
        }
    digest = hashlib.sha256(f"{sys.version}{numba.__version__}{np.__version__}".encode())
    for name in sorted(made_of & sources.keys()):
        digest.update(sources[name])
    return digest.hexdigest()[:16]


def _cache_home() -> Path:
    chosen = os.environ.get("OUTRIDER_CACHE")
    if chosen:
        return Path(chosen)
    shared = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # Its specification says that a relative path is invalid and ignored.
    return (shared if shared.is_absolute() else Path.home() / ".cache") / "outrider"


def _drop_old(home: Path) -> None:
    used: list[tuple[float, Path]] = []
    for path in home.glob("numba-*"):
        # Another process that starts may have dropped it just now.
        with contextlib.suppress(FileNotFoundError):
            used.append((path.stat().st_mtime, path))
    for last, path in sorted(used, reverse=True)[_KEEP:]:
        if time.time() - last > _IN_USE:
            shutil.rmtree(path, ignore_errors=True)


@functools.cache
def cache_folder() -> Path | None:
    """The folder of the compile cache, which numba is told; None where none can be written."""
    import numba  # noqa: PLC0415 - see `interpret`

    name = f"numba-{_source_digest()}"
    try:
        folder = _cache_home() / name
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            os.utime(folder)
        _drop_old(folder.parent)
    except (OSError, RuntimeError) as error:  # a RuntimeError: this user has no home folder
        _LOG.warning(
            "no compile cache (%s): every start compiles, which takes a while; set OUTRIDER_CACHE to a folder",
            f"{error.filename or name}: {error.strerror}" if isinstance(error, OSError) else error,
        )
        return None
    numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
    return folder


def interpret() -> None:
    """Leave all functions to the interpreter: for a process that computes next to nothing, and must start at once.

    It loads no numba then. To be called before anything that is compiled is imported: compiled functions cannot call
    others. Where numba is loaded already, it changes nothing.
    """
    global _interpreted  # noqa: PLW0603 - a process is the one or the other, from its start
    _interpreted = _interpreted or "numba" not in sys.modules


def is_interpreted() -> bool:
    """True in a process that leaves all functions to the interpreter: no pilot of ours flies in it."""
    return _interpreted


def _compile(function: _F, **options: Any) -> _F:  # noqa: ANN401 - numba's
    """No `fastmath`: the bits must not depend on who calls."""
    if _interpreted:
        return function
    import numba  # noqa: PLC0415 - see `interpret`

    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    from sim.kernels.linking import dispatcher  # noqa: PLC0415 - it loads numba

    is_kept = cache_folder() is not None
    return cast("_F", dispatcher(function, cached=is_kept, error_model="numpy", **options))


def compiled(function: _F) -> _F:
    """Compile a function of plain floats and arrays; the Python original is its attribute `py_func`."""
    return _compile(function, _nrt=True)


def borrowing(function: _F) -> _F:
    """Compile as `compiled` does, but without reference counting: the function borrows its arrays.

    Handing a view or a tuple of arrays about then costs nothing; counted, it costs more than a small kernel, the more
    so where threads count the same array. Such a function cannot make arrays. One that returns views may only be called
    from another that borrows, never from Python or `compiled`, which would count the view down.
    """
    return _compile(function, _nrt=False)


def inlined(function: _F) -> _F:
    """Compile as `borrowing` does, but as a part of each caller: for what is handed the state of many worlds.

    Such a state has a hundred arrays: a call would copy what describes them, some kilobytes, for one world's tick,
    and each function would take seconds to compile for itself.
    """
    return _compile(function, _nrt=False, inline="always")


def released(function: _F) -> _F:
    """Compile as `borrowing` does, and give the interpreter away while it runs.

    For loops over worlds that threads share.
    """
    return _compile(function, _nrt=False, nogil=True)


_types: dict[tuple[object, ...], Any] = {}


def _type_of(typeof: Callable[[object], Any], argument: object) -> Any:  # noqa: ANN401 - numba's
    """Numba's type of an argument, asked for once for all arguments of a kind.

    By itself numba takes each structured array apart anew, and the start of a flight hands over a hundred arrays.
    """
    key = _kind_of(argument)
    if key is None:
        return typeof(argument)
    if key not in _types:
        _types[key] = typeof(argument)
    return _types[key]


def _kind_of(argument: object) -> tuple[object, ...] | None:
    """All that the type of an array, a float, an int, a bool or a tuple of them depends on; None for any other."""
    if isinstance(argument, np.ndarray):
        dtype, flags = argument.dtype, argument.flags
        layout = (flags.c_contiguous, flags.f_contiguous, flags.aligned, flags.writeable)
        kind = (type(argument), dtype, dtype.isalignedstruct)
        return *kind, argument.ndim, *layout
    if isinstance(argument, tuple):
        kinds = tuple(_kind_of(part) for part in argument)
        return None if None in kinds else (type(argument), *kinds)
    if type(argument) is int:
        return (int,) if argument.bit_length() < 64 else None
    return (type(argument),) if type(argument) in (float, bool) else None


def entry_point(function: _F, *arguments: object) -> _F:
    """The machine code of a compiled function for arguments of these types, to be called with such alone.

    numba looks at the type of each argument in each call, number by number and array by array: 5 µs for the state of
    a world whose tick takes one. Whoever calls often with arguments of fixed types looks once. Later arguments are
    not checked: arrays must have the same types, dimensions and layout.
    """
    dispatcher: Any = function
    if not hasattr(dispatcher, "get_overload"):  # it is left to the interpreter
        return function
    import numba  # noqa: PLC0415 - see `interpret`

    types = tuple(_type_of(numba.typeof, argument) for argument in arguments)
    dispatcher.compile(types)
    return cast("_F", dispatcher.get_overload(types))


Share = Literal["world", "uav", "ugv"]
"""Code that is compiled together. One share has next to nothing in common with the others: they may be compiled at
once."""
_SHARES: tuple[Share, ...] = ("uav", "ugv", "world")


def is_compiled(*shares: Share) -> bool:
    """True if these shares have been compiled once, so that they are loaded from the cache."""
    folder = cache_folder()
    return folder is not None and all((folder / f"{one}.compiled").exists() for one in shares)


@contextlib.contextmanager
def compiling(*shares: Share) -> Iterator[None]:
    """While one process compiles, the others wait and then load what it has compiled.

    Args:
        shares: What it compiles; none: something else, which may have parts of each.
    """
    folder = None if _interpreted else cache_folder()
    if folder is None:
        yield
        return
    # Somebody may have cleared the cache since this process began, or while it compiles.
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as locks:
        for share in _SHARES:  # in one order, so that nobody waits in a circle
            if not shares or share in shares:
                lock = locks.enter_context((folder / f"{share}.lock").open("w"))
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield
        with contextlib.suppress(FileNotFoundError):
            for share in shares:
                (folder / f"{share}.compiled").touch()
