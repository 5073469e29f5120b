"""Compiled functions as numba makes them: for Python, or as parts of others.

By itself numba optimizes each function for itself, makes machine code of it and an entry for Python, whoever calls it.
Most of ours are called by other compiled functions alone, which link them in and are optimized as a whole: what was
made of the parts before is thrown away, and takes half of the time that compiling takes.
"""

import contextlib
import copy
import functools
import gc
from collections.abc import Callable, Iterator
from types import FunctionType, SimpleNamespace
from typing import Any

from numba.core import inline_closurecall
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.targetconfig import ConfigStack
from numba.core.types import Dispatcher, Function, unliteral

from sim.kernels.lazy_packages import enter

enter("scipy.linalg")  # numba passes it on the way to one module, and nobody here needs the rest

_Library: Any = JITCodeLibrary  # numba's classes have no types, or wrong ones
_Dispatcher: Any = CPUDispatcher
_plain: Any = unliteral
_call_type: Any = Function.get_call_type
_flags: Any = ConfigStack.top_or_none

_INSIDE = {
    JITCodeLibrary: ("_optimize_functions", "_optimize_final_module", "_finalize_final_module"),
    inline_closurecall: ("copy",),
    Function: ("get_call_type",),
}
_IS_KNOWN = all(hasattr(owner, name) for owner, names in _INSIDE.items() for name in names)
"""True if numba's insides, which another version may do without, are those that are dealt with here."""


class _Whole(_Library):  # type: ignore[misc]
    """Code that Python calls, with all of its parts: optimized once, after they are linked in."""

    def _optimize_functions(self, module: Any) -> None:  # noqa: ANN401 - numba's
        module.data_layout = self._codegen._data_layout


class _Part(_Whole):
    """Code that only compiled functions call: neither optimized for itself nor made into machine code."""

    has_dynamic_globals = False
    """It names the functions that it calls by their addresses here; nobody uses those, and optimizing drops them."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """None: 0."""
        self._ensure_finalized()
        return 0

    def serialize_using_object_code(self) -> Any:  # noqa: ANN401 - numba's
        """For the cache; there is no object code."""
        return self.serialize_using_bitcode()


_Calls = dict[tuple[object, ...], object]
_typed: list[tuple[object, _Calls]] = []
"""The calls of numba's own functions that have been typed, by the flags of their callers."""


def _type_call(
    function: object, context: object, arguments: tuple[object, ...], named: dict[str, object]
) -> object:
    """The signature of a call of one of numba's functions, looked for once.

    By itself numba tries all kinds of operands, from datetimes to sets, wherever two numbers are added.
    """
    flags, call = getattr(_flags(), "_values", None), (function, *arguments, *named.items())
    calls = next((calls for known, calls in _typed if known == flags), None)
    if calls is None:
        calls = {}
        _typed.append((flags and dict(flags), calls))
    if call not in calls:
        calls[call] = _call_type(function, context, arguments, named)
    return calls[call]


@contextlib.contextmanager
def _replaced(owner: object, **attributes: object) -> Iterator[None]:
    """While this lasts an object has attributes of its own that are these."""
    before = {name: vars(owner)[name] for name in attributes if name in vars(owner)}
    for name, value in attributes.items():
        setattr(owner, name, value)
    try:
        yield
    finally:
        for name in attributes:
            if name in before:
                setattr(owner, name, before[name])
            else:
                delattr(owner, name)


@contextlib.contextmanager
def _compiling_to(kind: type[_Whole]) -> Iterator[None]:
    """While this lasts nobody else compiles, and numba compiles to code of this kind.

    What is inlined is not copied before: it was made for this and is used once.
    """
    codegen = cpu_target.target_context.codegen()
    kept = SimpleNamespace(**vars(copy) | {"deepcopy": lambda block: block})
    with (
        global_compiler_lock,
        _collecting_seldom(),
        _replaced(codegen, _library_class=kind, set_env=functools.partial(_set_env, codegen)),
        _replaced(inline_closurecall, copy=kept),
        _replaced(Function, get_call_type=_type_call),
    ):
        yield


def _set_env(codegen: Any, name: str, environment: object) -> None:  # noqa: ANN401 - numba's
    """Hands code the objects that it refers to, as numba does, where that code is machine code."""
    if codegen._engine.get_global_value_address(name):
        type(codegen).set_env(codegen, name, environment)


@contextlib.contextmanager
def _collecting_seldom() -> Iterator[None]:
    """Look for cycles among a compiler's many objects seldom: by default that is an eighth of the time."""
    before = gc.get_threshold()
    gc.set_threshold(50_000, 20, 100)
    try:
        yield
    finally:
        gc.set_threshold(*before)


class _Kept(_Dispatcher):  # type: ignore[misc]
    """One function, whose versions are kept as code of one kind."""

    _kind: type[_Whole]

    def compile(self, types: Any) -> Any:  # noqa: ANN401 - numba's
        """The version for arguments of these types."""
        with _compiling_to(self._kind) if _IS_KNOWN else contextlib.nullcontext():
            return super().compile(types)


class _Linked(_Kept):
    """One function, for compiled callers."""

    _kind = _Part

    def get_call_template(self, arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:  # noqa: ANN401 - numba's
        """Tells a compiled caller of the one version that serves all constants it may hand over.

        By itself numba would compile a version for each, with all that it calls in turn: 32 of `draw`.
        """
        plain = {name: _plain(one) for name, one in named.items()}
        return super().get_call_template(tuple(_plain(one) for one in arguments), plain)


class _Entry(_Kept):
    """One function, for Python, and for compiled callers by its twin."""

    _kind = _Whole

    @functools.cached_property
    def linked(self) -> Any:  # noqa: ANN401 - numba's
        """The same function for compiled callers."""
        ours = self.py_func
        named = ours.__code__, ours.__globals__, ours.__name__, ours.__defaults__, ours.__closure__
        twin = FunctionType(*named)
        twin.__module__, twin.__kwdefaults__ = ours.__module__, ours.__kwdefaults__
        twin.__qualname__ = f"{ours.__qualname__}.linked"  # a place of its own in the cache
        options = self.targetoptions | {"no_cpython_wrapper": True}
        return _dispatcher(_Linked, twin, options, cached=type(self._cache).__name__ != "NullCache")

    @property
    def _numba_type_(self) -> Any:  # noqa: ANN401 - numba's
        return Dispatcher(self.linked)


def _dispatcher(kind: Any, function: Any, options: dict[str, Any], *, cached: bool) -> Any:  # noqa: ANN401 - numba's
    made = kind(py_func=function, targetoptions=options)
    if cached:
        made.enable_caching()
    return made


def dispatcher(function: Callable[..., Any], *, cached: bool, **options: Any) -> Any:  # noqa: ANN401 - numba's
    """A function that numba compiles when it is called, from Python or by another.

    Args:
        function: Of plain floats and arrays.
        cached: Whether what is compiled is kept in numba's cache.
        **options: numba's. No entry for C is made, which nobody uses and which takes time.
    """
    chosen = {"nopython": True, "no_cfunc_wrapper": True, **options}
    inline = options.get("inline") == "always"  # no code of its own, in whoever calls it
    return _dispatcher(CPUDispatcher if inline else _Entry, function, chosen, cached=cached)
