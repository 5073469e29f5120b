"""The order in which the machine's BLAS sums.

Where it fuses, as on all but old processors, the compiled filter has the pilots' bits.
"""

from functools import cache

import numpy as np

from agents.estimation.twin import fma
from sim.kernels.compile import FloatArray, compiled


@compiled
def fused(a: float, b: float, c: float) -> float:
    """a * b + c, rounded once."""
    return fma(a, b, c)  # type: ignore[no-any-return]


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """The product of two 2 x 2 matrices, fused as OpenBLAS does."""
    return np.array([[fused(a[i, 1], b[1, j], a[i, 0] * b[0, j]) for j in (0, 1)] for i in (0, 1)])


@cache
def blas_fuses() -> bool:
    """Whether numpy's BLAS fuses the products of matrices in the order of their terms, and not that of matrix and
    vector.
    """
    rng = np.random.default_rng(1)
    for _ in range(300):
        a, b, x = rng.normal(size=(2, 2)), rng.normal(size=(2, 2)), rng.normal(size=4)
        A, B = np.kron(a, np.eye(2)), np.kron(b, np.eye(2))
        alike = (np.dot(A, B) == np.kron(_product(a, b), np.eye(2))).all()
        alike &= (np.dot(A, B.T) == np.kron(_product(a, b.T), np.eye(2))).all()
        plain = [a[i, 0] * x[k] + a[i, 1] * x[2 + k] for i in (0, 1) for k in (0, 1)]
        if not alike or not (np.dot(A, x) == plain).all():
            return False
    return True
