"""Sums of eight interleaved partial sums, which the compiler vectorizes."""

from sim.compiling.compile import FloatArray, compiled

LANES = 8
"""Number of partial sums, and of cells in a block."""


@compiled
def widened(first: int, end: int, count: int) -> tuple[int, int]:
    """Widen a range of cells to whole blocks if the line of `count` cells is long enough.

    A compiled loop over whole blocks has no remainder to process one by one.
    """
    whole = (end - first + LANES - 1) // LANES * LANES
    start = max(0, min(first, count - whole))
    return start, min(count, start + whole)


@compiled
def lane_sum(terms: FloatArray, begin: int, count: int) -> float:
    """Sum `count` terms from `begin` on.

    Whole blocks go into eight partial sums, added as ((a + e) + (c + g)) + ((b + f) + (d + h)); the remainder is added
    term by term.

    Args:
        terms: Terms, with room for `LANES` more numbers at the end.
        begin: Index of the first term.
        count: Number of terms.
    """
    a = b = c = d = e = f = g = h = 0.0
    behind = begin + count // LANES * LANES
    for i in range(begin, behind, LANES):
        a += terms[i]
        b += terms[i + 1]
        c += terms[i + 2]
        d += terms[i + 3]
        e += terms[i + 4]
        f += terms[i + 5]
        g += terms[i + 6]
        h += terms[i + 7]
    rest, left = 0.0, begin + count - behind
    for i in range(LANES - 1):  # always seven additions: the branch is predictable
        rest += terms[behind + i] if i < left else 0.0
    return (((a + e) + (c + g)) + ((b + f) + (d + h))) + rest
