"""A hint to the processor: cells that will be needed soon.

A batch of worlds is larger than any cache. While one world is computed, the part of the next one's grid that its tick will touch
is brought near the core; without this the core waits for memory most of the time. No result depends on it.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from sim.compile import FloatArray, borrowing
from sim.field import chord, half_chord

_LINE = 8
"""Numbers in a cache line."""


@intrinsic
def _hint(typingctx: Any, array: Any, row: Any, column: Any) -> Any:  # noqa: ANN401 - numba's own types
    """Bring one cell of a grid near the core."""
    signature = types.void(array, types.intp, types.intp)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        kind = signature.args[0]
        grid = make_array(kind)(context, builder, arguments[0])  # type: ignore[no-untyped-call]
        place = cgutils.get_item_pointer(context, builder, kind, grid, arguments[1:])  # type: ignore[no-untyped-call]
        byte, whole = ir.IntType(8).as_pointer(), ir.IntType(32)
        prefetch = builder.module.declare_intrinsic(
            "llvm.prefetch", [byte], ir.FunctionType(ir.VoidType(), [byte, whole, whole, whole])
        )
        near = [ir.Constant(whole, value) for value in (0, 2, 1)]  # to read, second-level cache, data
        builder.call(prefetch, [builder.bitcast(place, byte), *near])
        return context.get_dummy_value()

    return signature, codegen


@borrowing
def fetch_disc(coverage: FloatArray, p_x: float, p_y: float, radius: float, cell: float, part: int = 0, parts: int = 1) -> None:
    """Bring the cells within `radius` [m] of (p_x, p_y) [m] near the core.

    Args:
        coverage: The grid.
        p_x, p_y, radius, cell: As in `sim.field.disc_chords`.
        part, parts: Only this one of so many parts, from 0: so many cells asked for at once would keep the core from its own.
    """
    rows, columns = coverage.shape
    first_row, end_row = chord(p_y, radius, cell, rows)
    met = max(0, end_row - first_row)
    for j in range(first_row + met * part // parts, first_row + met * (part + 1) // parts):
        first, end = chord(p_x, half_chord(radius, (j + 0.5) * cell - p_y), cell, columns)
        for i in range(first, end + _LINE - 1, _LINE):
            _hint(coverage, j, min(i, columns - 1))  # type: ignore[call-arg]
