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
from draws import a_key
from flights import HERE, escort, parameters

import agents.control
from agents.control.certificate import Known, Plan, no_plan
from agents.control.discs import Disc, no_detections
from agents.control.guard import guard_state, note_position
from agents.control.handover import certificate
from agents.control.laws import OwnTerms, initial_state
from agents.control.promise import Declared
from agents.control.uav_tick import UavMemory
from agents.drivers.compiled import driver_parameters, driver_state
from agents.drivers.parameters import COMPILED_DRIVERS, Route
from agents.estimation.twin import COLUMNS, NUMBERS, KalmanState, kalman_parameters
from bus.messages import Detector, Estimator, Limits
from bus.registry import LAWS, SENSORS
from sim.engine.briefing import briefing
from sim.engine.run_keys import derive_keys
from sim.models.vehicles import Motion

MODULES = (
    *(
        f"agents.control.{module.name}"
        for module in pkgutil.iter_modules(agents.control.__path__)
        if module.name != "promise"  # which holds no function
    ),
    "agents.estimation.motion_model",
    "agents.estimation.twin",
    "sim.models.vehicles",
    "sim.models.detection",
    "sim.models.field",
    "sim.kernels.lanes",
    "sim.models.randomness",
    *(
        f"agents.drivers.{name}"
        for name in ("waypoints", "steering", "wander", "script", "evade", "ugv_tick")
    ),
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
_DETECTIONS[:2] = [(20.1, 20.2, 6), (19.4, 20.9, 2)]
_DISC = Disc(20.3, 20.7, 0.4, 11)
_PLAN = no_plan()
_PLAN["turn"], _PLAN["turn_x"], _PLAN["end_radius"] = 2, 0.1, 1.5

_NUMBERS = {
    "r_v": 4.75,
    "v_a": 0.6,
    "u_a": 0.3,
    "v_g": 0.2,
    "dt": 0.05,
    "eps": 0.3,
    "age": 1.0,
    "width": 40.0,
    "height": 40.0,
}
_PROMISE = certificate(Declared(**_NUMBERS))

_GUARD = guard_state(certificate(Declared(**_NUMBERS, delay=0.15)), depth=50)
note_position(_GUARD, 39, 20.6, 21.2)
_GUARD.detections[:] = _DETECTIONS
_GUARD.course["u_x"][:3], _GUARD.course["u_y"][:3] = (0.2, -0.3, 0.1), (-0.1, 0.0, 0.25)

_KALMAN = kalman_parameters(
    detector=Detector(noise=0.1, period=0.05),
    target=Limits(max_speed=0.2, max_acceleration=0.1),
    dt=0.05,
    settings=Estimator(),
)
_BELIEF = 1.0 + np.abs(_RNG.normal(size=NUMBERS))
_MEMORIES = _RNG.integers(0, 3, (7, COLUMNS)).astype(float)

_DRIVERS = [
    driver_parameters(briefing(escort(), "ugv_0", seed=3), name) for name in COMPILED_DRIVERS
]
_ROUTE = Route(
    goals=np.array([[20.7, 21.3], [3.0, 4.0], [18.0, 1.0]]),
    script=np.array([[10.0, 0.1, 0.2], [30.0, -0.1, 0.3], [1200.0, 3.0, 4.0]]),
)
_STATE = np.array([0.4, -1.0, 20.3, 21.1, 1.0, 0.05, 0.3, -0.2, 0.1, 0.0, -1.0, -0.5])
"""Of a law, and of a driver: which has heard the UAV and is out of its corner."""
_CORNERED = np.array([*_STATE[:-1], 1e3])

BY_NAME: dict[str, object] = {
    "promise": _PROMISE,
    "detections": _DETECTIONS,
    "plan": _PLAN,
    "course": _GUARD.course,
    "known": Known(Disc(20.1, 20.2, 0.3, 39), Disc(19.4, 20.9, 0.3, 36), _DISC, False),
    "disc": _DISC,
    "found": Plan(2, 3, 4, 0.1, -0.2, 0.2, 0.1, _DISC),
    "k": 1,
    "then": Motion(20.8, 21.2, 0.1, 0.0),
    "row": 1,
    "newest": 0,
    "pending": _RNG.normal(size=(3, 2)),
    "turn": 3,
    "cruise": 4,
    "brake_ticks": 5,
    "ticks": 6,
    "acts": 1,
    "contradicted": False,
    "p_x": 20.7,
    "p_y": 21.3,
    "coverage": _GROUND,
    "state": _STATE,
    "goals": _ROUTE.goals,
    "script": _ROUTE.script,
    "route": _ROUTE,
    "law": parameters(escort("logarithmic")),
    "guarded": True,
    "memory": UavMemory(_GROUND, initial_state(), _GUARD),
    "looked": 2,
    "here": Motion(20.7, 21.3, 0.2, -0.1),
    "looks": np.array([[40.0, 0.5, 2.5], [39.0, 1.0, 1.0]]),
    "arrived": 2,
    "target": (True, 20.1, 20.4),
    "radio": np.array([[4.0, 0.7, -0.4], [6.0, 0.9, -0.3], [6.0, 8.0, 9.0]]),
    "received": 2,
    "reached": 1,
    "lead": 4.0,
    "terms": _RNG.normal(size=90),
    "begin": 3,
    "rows": 160,
    "columns": 160,
    "parameters": parameters(escort("logarithmic")),
    "own": OwnTerms(alpha=0.3, beta=0.8),
    "sensor": SENSORS["hill"].code,
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
    **dict.fromkeys(("key", "noise_key", "chance_key"), a_key(98765, 12345)),
    "keys": derive_keys((3,), 2)[0],
    "purpose": 3,
    "vehicle": 1,
    "tick": 41,
    "taken": 39,
    "index": 2,
    "word": _WORDS[0],
    "a": _WORDS[0],
    "b": _WORDS[1],
    **{f"key_{k}": _WORDS[k] for k in range(2)},
    **{f"c_{k}": _WORDS[k + 2] for k in range(4)},
    "c_c": -8.0 / 3.0,
}
"""An argument of this name has this value, in every function."""

IN_MODULE: dict[str, dict[str, object]] = {
    **{
        f"agents.drivers.{name}": {"p": _DRIVERS[-1]}
        for name in ("waypoints", "wander", "script", "evade", "ugv_tick")
    },
    "agents.control.guard": {"commands": np.array([[0.1, -0.2], [0.0, 0.3]]), "state": _GUARD},
    "sim.kernels.lanes": {"first": 13, "end": 76},
    "agents.estimation.twin": {
        "parameters": _KALMAN,
        "numbers": _BELIEF,
        "history": _MEMORIES,
        "state": KalmanState(numbers=_BELIEF, history=_MEMORIES),
        "looks": np.array([[41.0, 1.0, 2.0], [39.0, 0.5, 2.5], [36.0, 1.0, 1.0], [41.0, 1.0, 2.0]]),
        "count": 4,
        "first": 38,
        "place": 2,
        **{name: 0.3 + 0.1 * k for k, name in enumerate(("pv", "vp", "pp", "vv", "least", "most"))},
    },
}
"""But in the functions of this module it has this one."""

POSITIVE = (
    *(
        "size",
        "v_",
        "u_max",
        "limit",
        "speed",
        "distance",
        "tolerance",
        "rho2",
        "peak",
        "duration",
        "half",
        "radius",
    ),
    *("sigma", "cut", "k_", "length", "center", "omega", "t"),
)
"""Any other argument is a number of its own; positive where its name begins so."""

EXTRA: dict[str, dict[str, list[object]]] = {
    "agents.control.laws.uav_control": {"parameters": [parameters(escort(law)) for law in LAWS]},
    "agents.control.laws.weights": {"parameters": [parameters(escort(law)) for law in LAWS]},
    "agents.control.coverage.keep_off_border": {"p_ax": [0.1, 39.9], "p_ay": [0.1, 39.9]},
    "agents.control.tracking.tracking_step": {"a_c": [0.0, -3.0]},
    "agents.control.coverage.velocity_error": {"uncovered": [True, False]},
    "agents.control.guard.note_detection": {"taken": [-1, 38], "p_delta_x": [-30.0, 30.0]},
    "agents.control.uav_tick.uav_tick": {"guarded": [False], "target": [(False, 0.0, 0.0)]},
    "agents.control.uav_tick.uav_perceive": {"guarded": [False], "looked": [0]},
    "sim.models.vehicles.next_goal": {"reached": [0, 2, 3], "tolerance": [1e9]},
    "agents.drivers.ugv_tick.ugv_tick": {
        "p": _DRIVERS,
        "state": [driver_state(), _CORNERED],
        "received": [0, 3],
        "p_x": [0.1, 39.9],
    },
    "agents.drivers.evade.evade_control": {
        "state": [driver_state(), _CORNERED],
        "p_x": [0.1, 39.9],
        "v_x": [30.0, -30.0],
    },
    "agents.drivers.evade.turned": {"time": [0.1 * k for k in range(300)]},
    "agents.drivers.evade.border_side": {"at": [0.1, 0.5, 39.9]},
    "agents.drivers.script.script_control": {
        "tick": [0, 10, 40, 2 * 10**13],
        "script": [np.zeros((0, 3))],
    },
    "agents.drivers.waypoints.waypoint_control": {"goals": [np.zeros((0, 2))]},
    "sim.models.field.sensor_quality": {
        "sensor": [row.code for row in SENSORS.values()],
        "rho2": [0.0, 3.3, 24.9, 25.0, 30.0],
    },
    "sim.models.field.sensor_slope": {
        "sensor": [row.code for row in SENSORS.values()],
        "rho2": [0.0, 3.3, 24.9, 25.0, 30.0],
    },
    "sim.models.field.density": {"rho2": [0.0, 3.3, 90.0, 95.0625, 99.0]},
    "sim.models.field.disc_chords": {"radius": [0.01, 5.0, 9.75, 70.0], "p_y": [0.1, -3.0, -80.0]},
    "sim.models.field.accumulate": {"sensor": [row.code for row in SENSORS.values()]},
    "sim.models.field.coverage_gradient": {"sensor": [row.code for row in SENSORS.values()]},
    "sim.kernels.lanes.lane_sum": {"count": list(range(20))},
    "sim.models.vehicles.stopping_distance": {"u_max": [0.3, float("inf")]},
    "sim.models.vehicles.speed_to_stop_within": {"u_max": [0.3, float("inf")]},
}
"""More values of single arguments, one after the other."""


def _value(qualified: str, name: str, place: int) -> object:
    in_module = IN_MODULE.get(qualified.rpartition(".")[0], {})
    if name in in_module:
        return in_module[name]
    if name in BY_NAME:
        return BY_NAME[name]
    number = 0.371 + 0.173 * place
    return number if name.startswith(POSITIVE) or place % 2 else -number


def _calls(qualified: str, names: list[str]) -> Iterator[list[object]]:
    base = [_value(qualified, name, place) for place, name in enumerate(names)]
    for scale in (1.0, 0.37, 1.9):
        yield [value * scale if isinstance(value, float) else value for value in base]
    for name, values in EXTRA.get(qualified, {}).items():
        for value in values:
            yield [
                value if name == other else given for other, given in zip(names, base, strict=True)
            ]


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


def _copy(value: Any) -> Any:
    if isinstance(value, tuple) and hasattr(value, "_make"):
        return value._make(map(_copy, value))
    return value.copy() if isinstance(value, np.ndarray) else value


def _answer(function: Callable[..., object], given: list[object]) -> bytes:
    """The bits of the result and of the arrays, which it may have changed."""
    arguments = [_copy(value) for value in given]
    result = _bits(function(*arguments))
    return result + b"".join(
        _bits(value) for value in arguments if isinstance(value, (np.ndarray, tuple))
    )


@pytest.mark.parametrize("qualified", FUNCTIONS)
def test_called_from_compiled_code_it_gives_the_bits_that_python_gets(qualified: str) -> None:
    function = FUNCTIONS[qualified]
    names = list(inspect.signature(function.py_func).parameters)
    caller = _caller(function, names)
    for given in _calls(qualified, names):
        assert _answer(caller, given) == _answer(function, given), given


KERNELS = (
    "sim.kernels.lanes.lane_sum",
    *(f"sim.models.field.{name}" for name in ("disc_chords", "accumulate", "accumulate_with_gain")),
    *(
        f"sim.models.field.{name}"
        for name in ("coverage_error", "coverage_gradient", "nearest_uncovered")
    ),
)


@pytest.mark.parametrize("kernel", KERNELS)
def test_compiling_changes_no_bit_of_a_kernel(kernel: str) -> None:
    """No fast mathematics: sums and products stay in the order in which they are written."""
    function = FUNCTIONS[kernel]
    for given in _calls(kernel, list(inspect.signature(function.py_func).parameters)):
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
