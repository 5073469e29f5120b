"""Our functions are compiled strictly, into the cache, and to the numbers of the text as it is written."""

import importlib
import os
import pkgutil
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import agents
import sim
from bus.registry import SENSORS
from processes import python
from seeded import a_key
from sim.compiling import compile as kernels
from sim.models.sensor import SensorParameters


def _compiled_functions() -> Iterator[tuple[str, Any]]:
    """Those of every module that flies."""
    for package in (agents, sim):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            for attribute, function in vars(importlib.import_module(module.name)).items():
                if hasattr(function, "py_func") and function.py_func.__module__ == module.name:
                    yield f"{module.name}.{attribute}", function


FUNCTIONS = dict(_compiled_functions())


_TRACK = {"p_x": 20.7, "p_y": 21.3, "duration": 0.43}
_PAIR = {"p_ax": 20.7, "p_ay": 21.3, "p_gx": 20.0, "p_gy": 20.0, "r_o": 9.75, "desired": 2.0}
_ERROR = {name: _PAIR[name] for name in ("p_gx", "p_gy", "r_o", "desired")}
KERNELS: dict[str, list[dict[str, Any]]] = {
    "sim.compiling.lanes.lane_sum": [{"begin": 3, "count": count} for count in (77, *range(20))],
    "sim.models.field.disc_chords": [
        {"p_x": 20.7, "p_y": p_y, "radius": radius, "rows": 160, "columns": 160}
        for radius in (0.01, 5.0, 9.75, 70.0)
        for p_y in (21.3, 0.1, -3.0, -80.0)
    ],
    **{
        f"sim.models.field.{name}": [
            given | {"sensor": SensorParameters(model, 0.9, 5.0)} for model in range(len(SENSORS))
        ]
        for name, given in (
            ("accumulate", _TRACK),
            ("accumulate_with_gain", _PAIR | {"duration": 0.43}),
            ("coverage_gradient", _PAIR),
        )
    },
    "sim.models.field.coverage_error": [_ERROR, _ERROR | {"p_gx": 0.1}],
    "agents.control.nearest_point.nearest_uncovered": [
        _PAIR | {"key": a_key(98765, 12345), "tick": 41}
    ],
}


def _bits(value: object) -> bytes:
    """The bits of a result: type by type, -0.0 and NaN as they are."""
    if isinstance(value, tuple):
        return b"".join(map(_bits, value))
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, float):
        return struct.pack("<d", value)
    return repr((type(value).__name__, value)).encode()


def _answer(
    function: Callable[..., object], names: tuple[str, ...], given: dict[str, Any]
) -> bytes:
    """The bits of the result and of the arrays, which it may have changed."""
    rng = np.random.default_rng(3)
    arrays = {"coverage": rng.uniform(0.0, 3.0, (160, 160)), "terms": rng.normal(size=90)}
    named = arrays | {"cell": 0.25} | given
    arguments = [named[name] for name in names]
    result = _bits(function(*arguments))
    return result + b"".join(_bits(value) for value in arguments if isinstance(value, np.ndarray))


@pytest.mark.parametrize("kernel", KERNELS)
def test_compiling_changes_no_bit_of_a_kernel(kernel: str) -> None:
    """Sums and products stay in the order in which they are written."""
    function = FUNCTIONS[kernel]
    code = function.py_func.__code__
    names = code.co_varnames[: code.co_argcount]
    for given in KERNELS[kernel]:
        assert _answer(function.py_func, names, given) == _answer(function, names, given), given


@pytest.mark.parametrize("name", ["compile.py", "visibility.py", "registry.py"])
def test_whatever_code_is_made_of_has_a_cache_of_its_own(name: str, monkeypatch) -> None:
    before, read = kernels._source_digest(), Path.read_bytes
    changed = lambda path: read(path) + b"#" * (path.name == name)  # noqa: E731
    monkeypatch.setattr(Path, "read_bytes", changed)
    assert kernels._source_digest() != before


@pytest.mark.parametrize(("apart", "kept"), [(1800.0, 6), (60.0, 9)])
def test_old_caches_go_but_for_some_and_those_in_use(apart: float, kept: int, tmp_path) -> None:
    for k in range(9):
        (tmp_path / f"numba-{k}").mkdir()
        os.utime(tmp_path / f"numba-{k}", (time.time() - k * apart,) * 2)
    # as if another process had just dropped it
    (tmp_path / "numba-gone").symlink_to(tmp_path / "nowhere")
    kernels._remove_old(tmp_path)
    assert {path.name for path in tmp_path.glob("*-?")} == {f"numba-{k}" for k in range(kept)}


def test_without_a_home_folder_there_is_no_cache_and_a_warning(monkeypatch, caplog) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for variable in ("OUTRIDER_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    assert kernels.cache_folder.__wrapped__() is None
    assert "no compile cache (Could not determine home directory.)" in caplog.text


def test_a_relative_cache_home_is_ignored(tmp_path, monkeypatch) -> None:
    monkeypatch.delenv("OUTRIDER_CACHE", raising=False)
    code = "from sim.compiling.compile import cache_folder; print(cache_folder())"
    own = os.environ | {"HOME": str(tmp_path / "home"), "XDG_CACHE_HOME": "shared"}
    told = python(code, env=own, cwd=tmp_path).stdout
    assert Path(told).parent == tmp_path / "home" / ".cache" / "outrider"
    assert [path.name for path in tmp_path.iterdir()] == ["home"]


def test_all_equations_are_among_the_compiled_functions() -> None:
    found = {name.rpartition(".")[2] for name in FUNCTIONS}
    assert {"step_vehicle", "sensor_quality", "coverage_term", "circle", "philox", "detect"} < found
    assert len(FUNCTIONS) > 300
