"""A hint to the processor: cells that will be needed soon.

A batch of worlds is larger than any cache. While one world is computed, the part of the next one's grid that its tick
will touch is brought near the core; without this the core waits for memory most of the time. No result depends on it.
"""

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from sim.kernels.compile import FloatArray, IntArray, borrowing

_LINE = 64
"""Bytes in a cache line."""


def _prefetch(builder: Any, place: Any) -> None:  # noqa: ANN401 - llvmlite's own types
    """Bring one cache line near the core."""
    byte, whole = ir.IntType(8).as_pointer(), ir.IntType(32)
    kind = ir.FunctionType(ir.VoidType(), [byte, whole, whole, whole])
    hint = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
    near = [ir.Constant(whole, value) for value in (0, 2, 1)]  # to read, second-level cache, data
    builder.call(hint, [builder.bitcast(place, byte), *near])


@intrinsic
def _hint(typingctx: Any, array: Any, row: Any, column: Any) -> Any:  # noqa: ANN401 - numba's own types
    """Bring one cell of a grid near the core."""
    signature = types.void(array, types.intp, types.intp)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        kind = signature.args[0]
        grid = make_array(kind)(context, builder, arguments[0])  # type: ignore[no-untyped-call]
        _prefetch(builder, cgutils.get_item_pointer(context, builder, kind, grid, arguments[1:]))  # type: ignore[no-untyped-call]
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def fetch_rows(typingctx: Any, arrays: Any, k: Any) -> Any:  # noqa: ANN401 - numba's own types
    """Bring row k of each of these arrays, a tuple, near the core.

    Of C-contiguous arrays with an axis for worlds in front.
    """
    signature = types.void(arrays, types.intp)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        for n, kind in enumerate(signature.args[0].types):
            array = make_array(kind)(context, builder, builder.extract_value(arguments[0], n))  # type: ignore[no-untyped-call]
            length = cgutils.unpack_tuple(builder, array.strides)[0]  # type: ignore[no-untyped-call]
            first = builder.bitcast(array.data, ir.IntType(8).as_pointer())
            row = builder.gep(first, [builder.mul(length, arguments[1])])
            zero, line = length.type(0), length.type(_LINE)
            with cgutils.for_range_slice(builder, zero, length, line, length.type) as (offset, _):
                _prefetch(builder, builder.gep(row, [offset]))
        return context.get_dummy_value()

    return signature, codegen


def disc_widths(radius: float, cell: float) -> IntArray:
    """A disc's reach to either side in each row that it may meet, lowest first, wherever in its cell its centre is.

    Args:
        radius: Of the disc [m].
        cell: Width of a cell [m].

    Returns:
        Numbers of cells beside the centre's column. Shape (rows,), odd: the centre's row is in the middle.
    """
    reach = radius / cell
    nearest = np.maximum(np.abs(np.arange(-math.ceil(reach), math.ceil(reach) + 1)) - 0.5, 0.0)
    return np.floor(np.sqrt(np.maximum(reach**2 - nearest**2, 0.0)) + 0.5).astype(np.int64)


@borrowing
def fetch_disc(
    coverage: FloatArray,
    p_x: float,
    p_y: float,
    cell: float,
    widths: IntArray,
    part: int = 0,
    parts: int = 1,
) -> None:
    """Bring the cells of a disc around (p_x, p_y) [m] near the core.

    Args:
        coverage: The grid.
        p_x, p_y: Centre of the disc [m].
        cell: Width of a cell [m].
        widths: The disc, from `disc_widths`.
        part, parts: Only this one of so many parts, from 0: so many cells asked for at once would keep the core
        from its own.
    """
    rows, columns = coverage.shape
    size, line = widths.shape[0], _LINE // coverage.itemsize
    x, lowest = int(p_x / cell), int(p_y / cell) - size // 2
    for n in range(size * part // parts, size * (part + 1) // parts):
        j, width = min(max(lowest + n, 0), rows - 1), widths[n]
        for i in range(x - width, x + width + line, line):
            _hint(coverage, j, min(max(i, 0), columns - 1))  # type: ignore[call-arg]
