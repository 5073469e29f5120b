"""Every compiled function gives the same bits to Python and to compiled code that calls it."""

import importlib
import inspect
import pkgutil
import struct
from collections.abc import Callable, Iterator
from typing import Any

import numba
import numpy as np
import pytest
from flights import HERE, escort, parameters

import agents.control
from agents.control.certificate import no_plan
from agents.control.discs import no_detections
from agents.control.handover import certificate
from agents.control.laws import LAWS, OwnTerms
from sim.field import SENSORS

MODULES = (
    *(f"agents.control.{module.name}" for module in pkgutil.iter_modules(agents.control.__path__)),
    "sim.vehicles",
    "sim.detection",
    "sim.field",
    "sim.randomness",
    "agents.drivers.waypoints",
)


def _compiled_functions() -> Iterator[tuple[str, Any]]:
    for name in MODULES:
        for attribute, function in vars(importlib.import_module(name)).items():
            if hasattr(function, "py_func") and function.py_func.__module__ == name:
                yield f"{name}.{attribute}", function


FUNCTIONS = dict(_compiled_functions())

_RNG = np.random.default_rng(11)
_GROUND = _RNG.uniform(0.0, 3.0, (160, 160))
_WORDS = [np.uint64(word) for word in _RNG.integers(0, 2**63, 6)]

_DETECTIONS = no_detections()
_DETECTIONS[:2] = (20.1, 20.2, 0.3), (19.4, 20.9, 0.1)

BY_NAME: dict[str, object] = {
    "promise": certificate(r_v=4.75, v_a=0.6, u_a=0.3, v_g=0.2, dt=0.05, eps=0.3, age=1.0, width=40.0, height=40.0),
    "detections": _DETECTIONS,
    "plan": no_plan(),
    "pending": _RNG.normal(size=(3, 2)),
    "new": 0,
    "near": 1,
    "turn": 3,
    "cruise": 4,
    "brake_ticks": 5,
    "ticks": 6,
    "acts": 1,
    "contradicted": False,
    "p_x": 20.7,
    "p_y": 21.3,
    "coverage": _GROUND,
    "state": np.array([0.4, -1.0, 20.3, 21.1, 1.0]),
    "terms": _RNG.normal(size=77),
    "parameters": parameters(escort("logarithmic")),
    "own": OwnTerms(alpha=0.3, beta=0.8),
    "sensor": SENSORS["hill"],
    "cell": 0.25,
    "uncovered": True,
    "p_ax": 20.7,
    "p_ay": 21.3,
    "p_gx": HERE[0],
    "p_gy": HERE[1],
    "q_x": 22.375,
    "q_y": 18.125,
    "reach": 5.0,
    "r_v": 4.75,
    "r_o": 9.75,
    "r_s": 3.68,
    "r_pv": 3.68,
    "desired": 2.0,
    "width": 40.0,
    "height": 40.0,
    "margin": 0.63,
    "dt": 0.05,
    "dropout": 0.1,
    "count": 77,
    "seed": 12345,
    "key": 98765,
    "purpose": 3,
    "who": 1,
    "uav": 1,
    "tick": 41,
    "index": 2,
    "word": _WORDS[0],
    "a": _WORDS[0],
    "b": _WORDS[1],
    **{f"key_{k}": _WORDS[k] for k in range(2)},
    **{f"c_{k}": _WORDS[k + 2] for k in range(4)},
    "c_c": -8.0 / 3.0,
}
"""An argument of this name has this value, in every function."""

POSITIVE = (
    *("size", "v_", "u_max", "limit", "speed", "distance", "tolerance", "rho2", "peak", "duration", "half", "radius"),
    *("sigma", "cut", "k_", "length", "center", "omega", "t"),
)
"""Any other argument is a number of its own; positive where its name begins so."""

EXTRA: dict[str, dict[str, list[object]]] = {
    "agents.control.laws.uav_control": {"parameters": [parameters(escort(law)) for law in LAWS]},
    "agents.control.laws.weights": {"parameters": [parameters(escort(law)) for law in LAWS]},
    "agents.control.coverage.keep_off_border": {"p_ax": [0.1, 39.9], "p_ay": [0.1, 39.9]},
    "agents.control.tracking.tracking_step": {"a_c": [0.0, -3.0]},
    "agents.control.coverage.velocity_error": {"uncovered": [True, False]},
    "sim.field.sensor_quality": {"sensor": list(SENSORS.values()), "rho2": [0.0, 3.3, 24.9, 25.0, 30.0]},
    "sim.field.sensor_slope": {"sensor": list(SENSORS.values()), "rho2": [0.0, 3.3, 24.9, 25.0, 30.0]},
    "sim.field.density": {"rho2": [0.0, 3.3, 90.0, 95.0625, 99.0]},
    "sim.field.accumulate": {"sensor": list(SENSORS.values())},
    "sim.field.coverage_gradient": {"sensor": list(SENSORS.values())},
    "sim.vehicles.stopping_distance": {"u_max": [0.3, float("inf")]},
    "sim.vehicles.speed_to_stop_within": {"u_max": [0.3, float("inf")]},
}
"""More values of single arguments, one after the other."""


def _value(name: str, place: int) -> object:
    if name in BY_NAME:
        return BY_NAME[name]
    number = 0.371 + 0.173 * place
    return number if name.startswith(POSITIVE) or place % 2 else -number


def _calls(qualified: str, names: list[str]) -> Iterator[list[object]]:
    base = [_value(name, place) for place, name in enumerate(names)]
    for scale in (1.0, 0.37, 1.9):
        yield [value * scale if isinstance(value, float) else value for value in base]
    for name, values in EXTRA.get(qualified, {}).items():
        for value in values:
            yield [value if name == other else given for other, given in zip(names, base, strict=True)]


def _bits(value: object) -> bytes:
    """The bits of a result: type by type, -0.0 and NaN as they are."""
    if isinstance(value, tuple):
        return b"".join(map(_bits, value))
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, float):
        return struct.pack("<d", value)
    return repr((type(value).__name__, value)).encode()


def _caller(function: Callable[..., object], names: list[str]) -> Callable[..., object]:
    """A compiled function that calls it by keyword, as compiled code of ours does, with the arguments that it was given."""
    text = f"def caller({', '.join(names)}):\n    return function({', '.join(f'{name}={name}' for name in names)})\n"
    space: dict[str, Any] = {"function": function}
    exec(text, space)  # noqa: S102 - generated here
    caller: Callable[..., object] = numba.njit(error_model="numpy")(space["caller"])
    return caller


def _answer(function: Callable[..., object], given: list[object]) -> bytes:
    """The bits of the result and of the arrays, which it may have changed."""
    arguments = [value.copy() if isinstance(value, np.ndarray) else value for value in given]
    result = _bits(function(*arguments))
    return result + b"".join(_bits(value) for value in arguments if isinstance(value, np.ndarray))


@pytest.mark.parametrize("qualified", FUNCTIONS)
def test_called_from_compiled_code_it_gives_the_bits_that_python_gets(qualified: str) -> None:
    function = FUNCTIONS[qualified]
    names = list(inspect.signature(function.py_func).parameters)
    caller = _caller(function, names)
    for given in _calls(qualified, names):
        assert _answer(caller, given) == _answer(function, given), given


KERNELS = ("_lane_sum", "accumulate", "coverage_error", "coverage_gradient", "nearest_uncovered")


@pytest.mark.parametrize("kernel", KERNELS)
def test_compiling_changes_no_bit_of_a_kernel(kernel: str) -> None:
    """No fast mathematics: sums and products stay in the order in which they are written."""
    qualified = f"sim.field.{kernel}"
    function = FUNCTIONS[qualified]
    for given in _calls(qualified, list(inspect.signature(function.py_func).parameters)):
        assert _answer(function.py_func, given) == _answer(function, given)


def test_all_equations_are_among_the_compiled_functions() -> None:
    found = {name.rpartition(".")[2] for name in FUNCTIONS}
    assert {
        "step_vehicle",
        "sensor_quality",
        "accumulate",
        "coverage_gradient",
        "uav_control",
        "circle",
        "philox",
        "detect",
    } < found
    assert len(FUNCTIONS) > 50
    assert {name.rpartition(".")[0] for name in FUNCTIONS} == set(MODULES)
