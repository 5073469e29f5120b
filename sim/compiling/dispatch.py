# ruff: noqa: ANN401 - numba infers these types
"""Selection among compiled functions by an integer, with numba's public `overload`.

Functions passed as arguments would be compiled again in each process. Here the caller's compiled code contains the
functions, so that the cache stores it.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload, register_jitable

Function = Callable[..., Any]


def choice(functions: Sequence[Function]) -> Function:
    """Return a function for compiled code: `call(place, inputs)` calls the function at this index with the inputs.

    Args:
        functions: Compiled functions with the same arguments and results.
    """

    def call(place: Any, inputs: Any) -> Any:
        return functions[place](*inputs)

    def chain(k: int) -> Function:
        function = functions[k]
        if k == len(functions) - 1:
            last: Function = register_jitable(lambda _, inputs: function(*inputs))
            return last
        others = chain(k + 1)

        @register_jitable
        def choose(place: Any, inputs: Any) -> Any:
            if place == k:
                return function(*inputs)
            return others(place, inputs)

        return choose

    @overload(call, jit_options={"error_model": "numpy"})
    def _call(place: Any, inputs: Any) -> Function:
        choose = chain(0)

        def chosen(place: Any, inputs: Any) -> Any:
            return choose(place, inputs)

        return chosen

    return call


def commands(functions: Sequence[Function]) -> Function:
    """Return a function for compiled code that computes a vehicle's command by its own law or driver.

    `call(code, vehicle, parameters, memories, place, inputs)` calls the function of this code as `function(vehicle,
    parameters[code][row], memories[code][place], *inputs)`, where place is (world, row). `parameters` and `memories`
    are tuples of structured arrays, one for each function. A function whose parameters are None is not compiled; if it
    is called nevertheless, the command is NaN.

    Args:
        functions: Compiled functions, one for each code.
    """

    def call(
        code: Any, vehicle: Any, parameters: Any, memories: Any, place: Any, inputs: Any
    ) -> tuple[float, float]:
        raise NotImplementedError("for compiled code only")

    def chain(codes: list[int]) -> Function:
        if not codes:
            none: Function = register_jitable(lambda *_: (np.nan, np.nan))
            return none
        k, others = codes[0], chain(codes[1:])
        function = functions[k]

        @register_jitable
        def choose(
            code: Any, vehicle: Any, parameters: Any, memories: Any, place: Any, inputs: Any
        ) -> Any:
            if code == k:
                return function(vehicle, parameters[k][place[1]], memories[k][place], *inputs)
            return others(code, vehicle, parameters, memories, place, inputs)

        return choose

    @overload(call, jit_options={"error_model": "numpy"})
    def _call(
        code: Any, vehicle: Any, parameters: Any, memories: Any, place: Any, inputs: Any
    ) -> Function:
        kinds = enumerate(parameters.types)
        choose = chain([k for k, kind in kinds if not isinstance(kind, types.NoneType)])

        def chosen(
            code: Any, vehicle: Any, parameters: Any, memories: Any, place: Any, inputs: Any
        ) -> Any:
            return choose(code, vehicle, parameters, memories, place, inputs)

        return chosen

    return call
