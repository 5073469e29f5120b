# ruff: noqa: ANN401 - numba infers these types
"""Selection among compiled functions by an integer, or by an argument that may be None, with numba's `overload`.

Functions passed as arguments would be compiled again in each process. Here the caller's compiled code contains the
functions, so that the cache stores it.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload, register_jitable

Function = Callable[..., Any]

_BRANCHES = 3
"""Branches of a selection. Each of its levels compiles the functions below again, so a long chain compiles slowly."""


def choice(functions: Sequence[Function]) -> Function:
    """Return a function for compiled code: `call(index, inputs)` calls the function at this index with the inputs.

    Args:
        functions: Compiled functions with the same arguments and results.
    """

    def call(index: Any, inputs: Any) -> Any:
        return functions[index](*inputs)

    def chain(k: int) -> Function:
        function = functions[k]
        if k == len(functions) - 1:
            last: Function = register_jitable(lambda _, inputs: function(*inputs))
            return last
        others = chain(k + 1)

        @register_jitable
        def choose(index: Any, inputs: Any) -> Any:
            if index == k:
                return function(*inputs)
            return others(index, inputs)

        return choose

    @overload(call, jit_options={"error_model": "numpy"})
    def _call(index: Any, inputs: Any) -> Function:
        choose = chain(0)

        def chosen(index: Any, inputs: Any) -> Any:
            return choose(index, inputs)

        return chosen

    return call


def unless_none(given: Function) -> Function:
    """Return a function that calls `given(first, *others)`, or returns None if its first argument is None.

    A decorator: it makes `given` a function of an optional part. Compiled code contains only one of both. After a test
    `first is None`, numba would compile both, and join their results.
    """

    @functools.wraps(given, updated=())
    def call(first: Any, *others: Any) -> Any:
        return None if first is None else given(first, *others)

    @overload(call, jit_options={"error_model": "numpy"})
    def _call(first: Any, *others: Any) -> Function:
        def nothing(first: Any, *others: Any) -> None:
            return None

        def chosen(first: Any, *others: Any) -> Any:
            return given(first, *others)

        return nothing if isinstance(first, types.NoneType) else chosen

    return call


def commands(functions: Mapping[str, Function]) -> Function:
    """Return a function for compiled code that computes a vehicle's command by its own law or driver.

    `call(code, vehicle, parameters, memory, inputs)` calls the function with this index as `function(vehicle,
    parameters.name, memory.name, inputs)`. Both records nest one record for each name. A function whose name they lack
    is not compiled; if it is called nevertheless, the command is NaN. A name that is alone needs no selection.
    """

    def call(
        code: Any, vehicle: Any, parameters: Any, memory: Any, inputs: Any
    ) -> tuple[float, float]:
        raise NotImplementedError("for compiled code only")

    def among(rows: list[tuple[int, str]]) -> Function:
        if len(rows) <= _BRANCHES:
            return last(*(rows * _BRANCHES)[:_BRANCHES])
        size = (len(rows) + 1) // _BRANCHES
        first, second, third = among(rows[:size]), among(rows[size:-size]), among(rows[-size:])
        begin, end = rows[size][0], rows[-size][0]

        @register_jitable
        def choose(code: Any, vehicle: Any, parameters: Any, memory: Any, inputs: Any) -> Any:
            if code < begin:
                return first(code, vehicle, parameters, memory, inputs)
            if code < end:
                return second(code, vehicle, parameters, memory, inputs)
            return third(code, vehicle, parameters, memory, inputs)

        return choose

    def last(a: tuple[int, str], b: tuple[int, str], c: tuple[int, str]) -> Function:
        (i, own_i), (j, own_j), (k, own_k) = a, b, c
        first, second, third = functions[own_i], functions[own_j], functions[own_k]

        @register_jitable
        def choose(code: Any, vehicle: Any, parameters: Any, memory: Any, inputs: Any) -> Any:
            if code == i:
                return first(vehicle, parameters[own_i], memory[own_i], inputs)
            if code == j:
                return second(vehicle, parameters[own_j], memory[own_j], inputs)
            if code == k:
                return third(vehicle, parameters[own_k], memory[own_k], inputs)
            return np.nan, np.nan

        return choose

    def alone(name: str) -> Function:
        function = functions[name]

        def only(code: Any, vehicle: Any, parameters: Any, memory: Any, inputs: Any) -> Any:
            return function(vehicle, parameters[name], memory[name], inputs)

        return only

    @overload(call, jit_options={"error_model": "numpy"})
    def _call(code: Any, vehicle: Any, parameters: Any, memory: Any, inputs: Any) -> Function:
        rows = [(k, one) for k, one in enumerate(functions) if one in parameters.fields]
        if len(rows) == 1:
            return alone(rows[0][1])
        choose = among(rows)

        def chosen(code: Any, vehicle: Any, parameters: Any, memory: Any, inputs: Any) -> Any:
            return choose(code, vehicle, parameters, memory, inputs)

        return chosen

    return call
