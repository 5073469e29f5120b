"""Our functions are compiled strictly, into the cache, and to the numbers of the text as it is written."""

import copy
import importlib
import os
import pkgutil
import shutil
import struct
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numba.core import inline_closurecall, types
from numba.core.caching import NullCache
from numba.core.codegen import CPUCodeLibrary
from numba.core.errors import TypingError
from processes import python, ran
from seeded import a_key

import agents
import sim
from agents.control.certificate import HeldPlan
from bus.registry import SENSORS
from sim.kernels import compile as kernels
from sim.kernels import linking
from sim.kernels.compile import compiled
from sim.kernels.records import record_type
from sim.models.vehicles import Motion


def _compiled_functions() -> Iterator[tuple[str, Any]]:
    """Those of every module that flies."""
    for package in (agents, sim):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            for attribute, function in vars(importlib.import_module(module.name)).items():
                if hasattr(function, "py_func") and function.py_func.__module__ == module.name:
                    yield f"{module.name}.{attribute}", function


FUNCTIONS = dict(_compiled_functions())


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_is_compiled_strictly_and_kept(name: str) -> None:
    """No fast mathematics, nor arrays' own products summed in another order; `test_closed_loop` compares the bits."""
    function = FUNCTIONS[name]
    assert not {"fastmath", "parallel"} & {key for key, on in function.targetoptions.items() if on}
    assert function.targetoptions["error_model"] == "numpy"
    assert type(function._cache).__name__ != "NullCache"


_TRACK = {"p_x": 20.7, "p_y": 21.3, "duration": 0.43}
_PAIR = {"p_ax": 20.7, "p_ay": 21.3, "p_gx": 20.0, "p_gy": 20.0, "r_o": 9.75, "desired": 2.0}
_SENSOR = {"peak": 0.9, "reach": 5.0}
_ERROR = {name: _PAIR[name] for name in ("p_gx", "p_gy", "r_o", "desired")}
KERNELS: dict[str, list[dict[str, Any]]] = {
    "sim.kernels.lanes.lane_sum": [{"begin": 3, "count": count} for count in (77, *range(20))],
    "sim.models.field.disc_chords": [
        {"p_x": 20.7, "p_y": p_y, "radius": radius, "rows": 160, "columns": 160}
        for radius in (0.01, 5.0, 9.75, 70.0)
        for p_y in (21.3, 0.1, -3.0, -80.0)
    ],
    **{
        f"sim.models.field.{name}": [
            given | _SENSOR | {"sensor": row.code} for row in SENSORS.values()
        ]
        for name, given in (
            ("accumulate", _TRACK),
            ("accumulate_with_gain", _PAIR | {"duration": 0.43}),
            ("coverage_gradient", _PAIR),
        )
    },
    "sim.models.field.coverage_error": [_ERROR, _ERROR | {"p_gx": 0.1}],
    "sim.models.field.nearest_uncovered": [_PAIR | {"key": a_key(98765, 12345), "tick": 41}],
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


@compiled
def _scaled(number: float, times: int) -> float:
    return number * times


@compiled
def _by_constants(number: float, times: int) -> float:
    return _scaled(number, 2) + _scaled(number, times=3) + _scaled(number, times)


def test_a_constant_that_a_caller_hands_over_makes_no_version_of_its_own(monkeypatch) -> None:
    """Each would be compiled with all that it calls in turn."""
    scaled: Any = _scaled
    for function in (scaled.linked, _by_constants):  # else they may come from an earlier session
        monkeypatch.setattr(function, "_cache", NullCache())
    assert _by_constants(1.5, 4) == 13.5
    assert len(scaled.linked.overloads) == 1


class _Both(NamedTuple):
    rows: object
    number: float


def _read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


def _arguments() -> Iterator[object]:
    """Twice each, of other values: what the second is taken for was seen at the first."""
    columns = [("x", np.float64), ("y", np.float64)]
    packed, padded = np.dtype(columns), np.dtype(columns, align=True)  # equal, but not to numba
    for k in range(2):
        yield from (k, 2**62 + k, float(k), bool(k), np.float32(k), "text", None, np.int64(k))
        arrays = [np.full((4, 3), k, kind) for kind in (np.float64, np.float32, np.int64, np.bool_)]
        for kind in (record_type(HeldPlan), record_type(Motion), packed, padded):
            arrays += [np.zeros((4, 3), kind), np.zeros((4, 3), kind).view(np.recarray)]
        for array in arrays:
            yield from (array, array.T, array[::2], array[:, 1], array[0], array[:1, :1], array[:0])
            yield from ((array, array.T), (array, 1.0), _Both(array, 1.0), [1.0])
            yield from ((array, k), (array, 2**63 + k))
            yield _read_only(array.copy())


def test_the_type_of_an_argument_is_numbas_however_often_it_was_seen() -> None:
    seen = 0
    for argument in _arguments():
        assert kernels._type_of(numba.typeof, argument) == numba.typeof(argument), argument
        seen += kernels._kind_of(argument) is not None
    assert seen > 200


def test_what_only_compiled_code_has_called_is_no_machine_code(monkeypatch) -> None:
    scaled: Any = _scaled
    assert _by_constants(1.5, 4) == 13.5
    (version,) = scaled.linked.overloads.values()
    assert version.library.get_pointer_to_function(version.fndesc.llvm_func_name) == 0
    assert scaled(1.5, 4) == 6.0  # for Python it is compiled when Python calls it
    (version,) = scaled.overloads.values()
    assert version.library.get_pointer_to_function(version.fndesc.llvm_func_name) > 0


CALLED = """
import sys
import numpy as np
from sim.kernels.compile import borrowing, compiled, inlined

@inlined
def first(numbers):
    return numbers[0]

@borrowing
def checked(numbers, least):
    if first(numbers) < least:
        raise ValueError("too small")
    return first(numbers) * least

@borrowing
def fall(count, numbers):
    return checked(numbers, 2.0) if count == 0 else fall(count - 1, numbers)

@compiled
def one(numbers):
    return checked(numbers, 2.0) + fall(3, numbers)

@compiled
def other(numbers):
    return fall(2, numbers) - 1.0

call = {"one": one, "other": other}[sys.argv[1]]
print(call(np.array([3.5])))
try:
    call(np.array([1.5]))
except ValueError as error:
    print(error)
print(*(sum(each.linked.stats.cache_hits.values()) for each in (checked, fall)))
"""


def test_a_part_is_kept_for_callers_in_other_processes(tmp_path) -> None:
    """Also one that calls itself, one that raises, and one that has another one within."""
    (tmp_path / "called.py").write_text(CALLED, encoding="utf-8")

    def call(name: str) -> list[str]:
        environment = {"PYTHONPATH": os.pathsep.join(sys.path), "OUTRIDER_CACHE": str(tmp_path)}
        words = [sys.executable, tmp_path / "called.py", name]
        ended = ran(words, env=os.environ | environment, check=True)
        assert not ended.stderr
        return ended.stdout.splitlines()

    assert call("one") == ["14.0", "too small", "0 0"]
    assert call("one") == ["14.0", "too small", "0 0"]  # a whole needs no parts
    assert call("other") == ["6.0", "too small", "0 1"]  # with all that it calls


@pytest.mark.parametrize("name", ["linking.py", "compile.py", "visibility.py"])
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
    kernels._drop_old(tmp_path)
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
    code = "from sim.kernels.compile import cache_folder; print(cache_folder())"
    own = os.environ | {"HOME": str(tmp_path / "home"), "XDG_CACHE_HOME": "shared"}
    told = python(code, env=own, cwd=tmp_path).stdout
    assert Path(told).parent == tmp_path / "home" / ".cache" / "outrider"
    assert [path.name for path in tmp_path.iterdir()] == ["home"]


def test_a_cache_that_is_cleared_while_a_process_lives_is_begun_anew(tmp_path, monkeypatch) -> None:
    folder = tmp_path / "numba-k"
    monkeypatch.setattr(kernels, "cache_folder", lambda: folder)
    with kernels.compiling("uav"):
        shutil.rmtree(folder)
    assert not folder.exists()
    with kernels.compiling("uav"):
        assert folder.is_dir()
    assert (folder / "uav.compiled").exists()


def test_another_numba_compiles_as_it_does(monkeypatch) -> None:
    scaled, adds = compiled(_by_constants.py_func), compiled(_adds.py_func)  # type: ignore[attr-defined]
    monkeypatch.setattr(linking, "_IS_KNOWN", False)
    for function in (scaled, adds):
        monkeypatch.setattr(function, "_cache", NullCache())
    assert (scaled(1.5, 4), adds(1.0)) == (13.5, 2.0)


@compiled
def _adds(number: float) -> float:
    return number + 1.0


def test_numbas_own_passes_are_left_out_of_our_functions_alone(monkeypatch):
    """They are there again for others' functions, also after one of ours that cannot be compiled."""
    passes, seen = CPUCodeLibrary._optimize_functions, []
    monkeypatch.setattr(
        CPUCodeLibrary,
        "_optimize_functions",
        lambda library, module: (seen.append(library.name), passes(library, module))[1],
    )
    assert _adds(np.float32(1.0)) == 2.0
    _adds.recompile()  # type: ignore[attr-defined]  # it may have been loaded
    with pytest.raises(TypingError):
        _adds("text")
    assert seen == []
    assert inline_closurecall.copy is copy  # likewise what inlines a function
    assert types.Function.get_call_type is types.functions.BaseFunction.get_call_type
    assert numba.njit(lambda x: x + 1)(1) == 2
    assert seen


def test_all_equations_are_among_the_compiled_functions() -> None:
    found = {name.rpartition(".")[2] for name in FUNCTIONS}
    assert {"step_vehicle", "sensor_quality", "uav_control", "circle", "philox", "detect"} < found
    assert len(FUNCTIONS) > 300
