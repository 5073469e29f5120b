"""The kernels in C.

Built by the system's compiler when they are asked for, checked against ours, called through ctypes.
"""

import ctypes
import math
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from bus.registry import SENSORS
from sim.kernels.compile import FloatArray
from sim.models.field import accumulate, coverage_error, coverage_gradient

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-O3", "-march=native", "-std=c11", "-ffp-contract=off", "-shared", "-fPIC")
"""Strict floating point: no -ffast-math, and no contraction to fused operations, which would round otherwise."""

_DOUBLE, _LONG, _INT = ctypes.c_double, ctypes.c_long, ctypes.c_int
_ARRAY = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
_CLOSE = 1e-12
"""The largest relative difference of one running sum from eight: they round differently."""


class CKernels:
    """`kernels.c`, compiled and loaded; its functions take the arguments of ours, in their order.

    Args:
        path: Of the shared library.
    """

    def __init__(self, path: Path) -> None:
        self._library = library = ctypes.CDLL(str(path))
        grid, sensor = (_ARRAY, _LONG, _LONG), (_INT, _DOUBLE, _DOUBLE)
        places = 6 * (_DOUBLE,)  # of UAV and UGV, and what counts around the UGV
        library.accumulate.argtypes = (*grid, *places[:2], *sensor, _DOUBLE, _DOUBLE)
        library.coverage_error.argtypes = (_INT, *grid, *places[2:], _DOUBLE)
        library.coverage_gradient.argtypes = (_INT, *grid, *places, *sensor, _DOUBLE, _ARRAY)
        library.passes.argtypes = (_INT, *grid, _LONG)
        library.accumulate.restype = library.coverage_gradient.restype = None
        library.coverage_error.restype = library.passes.restype = _DOUBLE

    @classmethod
    @contextmanager
    def build(cls) -> Iterator["CKernels | None"]:
        """Build and load them in a temporary folder; None where there is no C compiler, or it fails."""
        compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
        if compiler is None:
            yield None
            return
        with (
            tempfile.TemporaryDirectory(prefix="outrider-c-") as folder,
            as_file(files("outrider.bench") / "kernels.c") as source,
        ):
            library = Path(folder) / "kernels.so"
            built = subprocess.run(
                [compiler, *FLAGS, "-o", str(library), str(source), "-lm"],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                check=False,
            )
            yield cls(library) if built.returncode == 0 else None

    def accumulate(self, coverage: FloatArray, *look: float) -> None:
        """`sim.models.field.accumulate`."""
        self._library.accumulate(coverage, *coverage.shape, *look)

    def coverage_error(self, coverage: FloatArray, *around: float, lanes: bool) -> float:
        """`sim.models.field.coverage_error`, with one running sum or with eight lanes."""
        return float(self._library.coverage_error(lanes, coverage, *coverage.shape, *around))

    def coverage_gradient(
        self, coverage: FloatArray, *around: float, lanes: bool
    ) -> tuple[float, float, float]:
        """`sim.models.field.coverage_gradient`, likewise."""
        found = np.zeros(3)
        self._library.coverage_gradient(lanes, coverage, *coverage.shape, *around, found)
        return float(found[0]), float(found[1]), float(found[2])

    def passes(self, coverage: FloatArray, count: int, *, lanes: bool) -> float:
        """All three in a loop, as `outrider.bench.kernels.passes`."""
        return float(self._library.passes(lanes, coverage, *coverage.shape, count))

    def check(self, places: int = 50) -> None:
        """Refuse kernels that compute something else than ours: they are no reference.

        Args:
            places: How many random grids, sensors and positions, inside Q and outside, are compared.

        Raises:
            ArithmeticError: If they do not: lanes to the bit, one running sum to 1e-12.
        """
        rng = np.random.default_rng(3)
        for _ in range(places):
            rows, columns = (int(count) for count in rng.integers(1, 100, 2))
            ours = rng.uniform(0.0, 4.0, (rows, columns))
            theirs = ours.copy()
            sensor = int(rng.choice([row.code for row in SENSORS.values()]))
            cell, reach = float(rng.choice((0.1, 0.25, 1.0))), rng.uniform(0.1, 8.0)
            a_x, g_x = rng.uniform(-2.0, columns * cell + 2.0, 2).tolist()
            a_y, g_y = rng.uniform(-2.0, rows * cell + 2.0, 2).tolist()
            seen = (a_x, a_y, sensor, 1.3, reach, cell, 0.05)
            accumulate(ours, *seen)
            self.accumulate(theirs, *seen)
            near = (g_x, g_y, reach + 4.75, 2.0, cell)
            around = (a_x, a_y, g_x, g_y, reach + 4.75, 2.0, sensor, 1.3, reach, cell)
            e, pull = coverage_error(ours, *near), coverage_gradient(ours, *around)
            same = ours.tobytes() == theirs.tobytes()
            same &= e == self.coverage_error(ours, *near, lanes=True)
            same &= pull == self.coverage_gradient(ours, *around, lanes=True)
            plain = self.coverage_gradient(ours, *around, lanes=False)
            same &= math.isclose(e, self.coverage_error(ours, *near, lanes=False), rel_tol=_CLOSE)
            same &= all(
                abs(one - other) <= _CLOSE * pull[2] for one, other in zip(pull, plain, strict=True)
            )
            if not same:
                raise ArithmeticError("the kernels in C compute something else than ours")
