"""Sums in eight lanes: one vector instruction of the processor adds eight terms, and the order is always the same.

numba leaves eight running sums as they are written, one addition after the other; here they are told to be one
vector. The bits are those of the plain loop, on every processor: lanes do not meet until the end.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload
from numba.np.arrayobj import make_array

from sim.kernels.compile import FloatArray, borrowing, compiled

LANES = 8
"""Lanes of a sum, and cells of a block: a cache line, and the widest vector of today's processors."""


@compiled
def widened(first: int, end: int, count: int) -> tuple[int, int]:
    """The cells from `first` to `end`, widened to whole blocks if the line of `count` cells has room for them.

    A compiled loop over whole blocks has no cells left over, which it would take one by one.
    """
    whole = (end - first + LANES - 1) // LANES * LANES
    start = max(0, min(first, count - whole))
    return start, min(count, start + whole)


def eight_lanes(terms: FloatArray, begin: int, blocks: int) -> float:
    """Sum of `8 blocks` terms from `begin` on: eight running sums, then ((a + e) + (c + g)) + ((b + f) + (d + h))."""
    lanes = [0.0] * LANES
    for i in range(LANES * blocks):
        lanes[i % LANES] += float(terms[begin + i])
    a, b, c, d, e, f, g, h = lanes
    return ((a + e) + (c + g)) + ((b + f) + (d + h))


@overload(eight_lanes, strict=False)
def _compiled_eight_lanes(terms: Any, begin: Any, blocks: Any) -> Callable[..., float]:  # noqa: ANN401 - numba's own types
    return lambda terms, begin, blocks: _vector_sum(terms, begin, blocks)  # type: ignore[call-arg]  # noqa: PLW0108 - numba takes no intrinsic here


@intrinsic
def _vector_sum(typingctx: Any, terms: Any, begin: Any, blocks: Any) -> Any:  # noqa: ANN401 - numba's own types
    """`eight_lanes` as vector instructions."""
    signature = types.float64(terms, types.intp, types.intp)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        lanes = ir.VectorType(ir.DoubleType(), LANES)
        data = make_array(signature.args[0])(context, builder, arguments[0]).data  # type: ignore[no-untyped-call]
        total = cgutils.alloca_once_value(builder, ir.Constant(lanes, [0.0] * LANES))  # type: ignore[no-untyped-call]
        with cgutils.for_range(builder, arguments[2]) as loop:
            offset = builder.mul(loop.index, ir.Constant(loop.index.type, LANES))
            place = builder.gep(data, [builder.add(arguments[1], offset)])
            block = builder.load(builder.bitcast(place, lanes.as_pointer()))
            block.align = 8
            builder.store(builder.fadd(builder.load(total), block), total)
        sums = builder.load(total)
        a, b, c, d, e, f, g, h = (
            builder.extract_element(sums, ir.Constant(ir.IntType(32), k)) for k in range(LANES)
        )
        add = builder.fadd
        return add(add(add(a, e), add(c, g)), add(add(b, f), add(d, h)))

    return signature, codegen


@borrowing
def lane_sum(terms: FloatArray, begin: int, count: int) -> float:
    """Sum of `count` terms from `begin` on: whole blocks in eight lanes, then the rest one by one.

    The rest always takes seven additions, of nothing where it is shorter: the processor would not foresee how many.

    Args:
        terms: With room for `LANES` numbers behind the last one that is summed.
        begin: The first.
        count: How many.
    """
    blocks = count // LANES
    behind, left = begin + LANES * blocks, count - LANES * blocks
    rest = 0.0
    for i in range(LANES - 1):
        rest += terms[behind + i] if i < left else 0.0
    return eight_lanes(terms, begin, blocks) + rest
