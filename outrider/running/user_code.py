"""Functions of the user's own, named as module:function, and policies that a learning library has saved."""

from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.drivers.policy import RowPolicy
from bus.errors import ScenarioError, shortened, told_with_place
from bus.observations import UGV, Row, names
from bus.registry import (
    LAWS,
    POLICY_FORMS,
    SAVED_POLICIES,
    UAV_POLICIES,
    UAV_POLICY_FORMS,
    resolve,
)
from outrider.running.user_modules import find_object
from sim.input.faults import one_line

if TYPE_CHECKING:
    from agents.control.uav_policy import UavPolicy
    from sim.scenario.types import Scenario

_ROW, _ACTION = (len(UGV),), (2,)
"""Shapes of what a saved policy sees and answers."""
_FORMS = f"allowed: {POLICY_FORMS}"


def _reason(error: BaseException) -> str:
    return shortened(told_with_place(error))


def load_function(name: str, *, what: str) -> Callable[..., Any] | None:
    """The function that `module:function` names; None for an empty name. The working folder is searched last.

    Args:
        name: Where it is.
        what: What it is for, for the error; a `policy` may also be saved, or an object that predicts: see
            `load_policy`; so may a `uav_policy`: see `load_uav_policy`.

    Raises:
        ScenarioError: If it is not there, or no function.
    """
    if not name:
        return None
    if what.rpartition(".")[2] == "uav_policy":
        return load_uav_policy(name, what=what)
    if what.rpartition(".")[2] == "policy":
        policy: Callable[..., Any] = load_policy(name, what=what)
        return policy
    found = _named(name, what)
    if not callable(found):
        raise ScenarioError(f"{what} = {name!r}: not a function")
    loaded: Callable[..., Any] = found
    return loaded


def _named(name: str, what: str) -> Any:  # noqa: ANN401 - whatever it is
    """The object that `module:name` names."""
    return find_object(name, what)


def load_policy(name: str, *, what: str = "policy") -> Any:  # noqa: ANN401 - a function, or an object that predicts
    """A policy for the driver `policy`.

    What a library has saved is loaded by that library, which must be installed, and runs code that is in the file:
    load only what you trust. It sees the UGV's row as the environment gives it (`bus.observations.UGV`) and answers the
    acceleration.

    Args:
        name: `module:function`, or `module:object` with a method `predict`; `sb3:ALGORITHM:FILE.zip` of
            Stable-Baselines3; `torch:FILE.pt`, a TorchScript file; `onnx:FILE.onnx`;
            `fmu:FILE.fmu`, an FMI 3.0 unit.
        what: What it is for, for the error.

    Raises:
        ScenarioError: If it is not there, cannot be loaded, or is none.
    """
    kind, separator, rest = name.partition(":")
    if separator and kind in SAVED_POLICIES:
        return resolve(SAVED_POLICIES[kind].load)(rest, f"{what} = {name!r}")
    if Path(name).suffix in (".zip", ".pt", ".onnx", ".fmu"):
        raise ScenarioError(f"{what} = {name!r}: of which library? {_FORMS}")
    found = _named(name, what)
    if isinstance(found, type) or not (callable(found) or isinstance(found, RowPolicy)):
        raise ScenarioError(
            f"{what} = {name!r}: neither a function nor an object with a method predict"
        )
    return found


def load_uav_policy(name: str, *, what: str = "uav_policy") -> "UavPolicy":
    """A policy for UAVs: the observations of one UAV in all worlds in, its accelerations out, shape (worlds, 2).

    What a library has saved is loaded with the observation that it was trained on, and may run code that is in the
    file: load only what you trust.

    Args:
        name: `module:function`; `npz:FILE.npz` of `outrider_learning.mlp.save_policy`; `sb3:ALGORITHM:FILE.zip` of
            `outrider_learning.saved.save_sb3_policy`.
        what: What it is for, for the error.

    Raises:
        ScenarioError: If it is not there, cannot be loaded, or is none.
    """
    kind, separator, rest = name.partition(":")
    if separator and kind in UAV_POLICIES:
        saved: UavPolicy = resolve(UAV_POLICIES[kind].load)(rest, f"{what} = {name!r}")
        return saved
    if Path(name).suffix in (".npz", ".zip"):
        raise ScenarioError(f"{what} = {name!r}: of which library? allowed: {UAV_POLICY_FORMS}")
    found = _named(name, what)
    if isinstance(found, type) or not callable(found):
        raise ScenarioError(f"{what} = {name!r}: neither a function nor an object that is called")
    policy: UavPolicy = found
    return policy


def _library(module: str, package: str, where: str) -> ModuleType:
    try:
        return import_module(module)
    except ImportError as error:
        raise ScenarioError(
            f"{where}: needs {package}: pip install {package} ({_reason(error)})"
        ) from error
    except Exception as error:
        raise ScenarioError(f"{where}: {package} cannot be imported: {_reason(error)}") from error


def _file(path: str, where: str, forms: str = _FORMS) -> str:
    if not Path(path).is_file():
        raise ScenarioError(f"{where}: no such file: {path or 'none is named'}; {forms}")
    return path


def _check_shapes(row: object, action: object, where: str) -> None:
    """Refuse a policy of another agent; None is a shape that is not known."""
    if row not in (None, _ROW) or action not in (None, _ACTION):
        raise ScenarioError(
            f"{where}: made for observations of shape {row} and actions of shape {action}; "
            f"allowed: {_ROW}, the UGV's row, and {_ACTION}, its acceleration"
        )


def _row_of(space: object, where: str) -> object:
    """The space of the row in what a policy observes: all of it, or that beside the picture of the tiles."""
    parts = getattr(space, "spaces", None)
    if not isinstance(parts, Mapping):
        return space
    shapes = {name: getattr(part, "shape", None) for name, part in parts.items()}
    side, *more = shapes.get("tiles") or (0,)
    if shapes.keys() != {"row", "tiles"} or more != [side] or side % 2 == 0:
        raise ScenarioError(
            f"{where}: made for observations of shapes {shapes}; allowed: the UGV's row, alone or with 'tiles', a "
            "picture of as many rows as columns, an odd number"
        )
    return parts["row"]


def _check_units(row: object, where: str) -> None:
    """Refuse a policy of rows that were normalized: here it is given SI units.

    Theirs begin at 0, but for the velocity; a bound that is infinite says nothing.
    """
    low = getattr(row, "low", None)
    if low is None:
        return
    below = np.array([name in {"vx", "vy"} for name in names(UGV)])
    if (np.isfinite(low) & ((low < 0.0) != below)).any():
        raise ScenarioError(
            f"{where}: made for observations from {low.tolist()} on, which are no rows in SI units; allowed: rows as "
            "the environment gives them, or a policy of your own that transforms them"
        )


def load_sb3(rest: str, where: str) -> RowPolicy:
    """`ALGORITHM:FILE.zip`, for a UGV: `load_sb3_model` whose observations and actions are a UGV's."""
    model: RowPolicy = load_sb3_model(rest, where, _FORMS)
    row = _row_of(getattr(model, "observation_space", None), where)
    done = getattr(model, "action_space", None)
    _check_shapes(getattr(row, "shape", None), getattr(done, "shape", None), where)
    _check_units(row, where)
    return model


def load_sb3_model(rest: str, where: str, forms: str) -> Any:  # noqa: ANN401 - the library's
    """`ALGORITHM:FILE.zip`, of stable_baselines3 or of sb3_contrib, imported here, and never else.

    Args:
        rest: The algorithm and the file.
        where: Field and value, for errors.
        forms: The allowed forms, for errors.

    Raises:
        ScenarioError: If it cannot be loaded.
    """
    algorithm, separator, path = rest.partition(":")
    if not separator:
        raise ScenarioError(f"{where}: names no algorithm; {forms}")
    file = _file(path, where, forms)
    library = _library("stable_baselines3", "stable-baselines3", where)
    known = _algorithms(library)
    if algorithm.lower() not in known and find_spec("sb3_contrib") is not None:
        known |= _algorithms(_library("sb3_contrib", "sb3-contrib", where))
    found = known.get(algorithm.lower())
    if found is None:
        raise ScenarioError(
            f"{where}: unknown algorithm {algorithm!r}; installed: {', '.join(sorted(known))}"
        )
    try:
        return found.load(file, device="cpu")
    except Exception as error:
        raise ScenarioError(f"{where}: cannot be loaded: {_reason(error)}") from error


def _algorithms(library: ModuleType) -> dict[str, Any]:
    """The library's algorithms by name in lower case."""
    known = {name.lower(): found for name, found in vars(library).items()}
    return {
        name: found
        for name, found in known.items()
        if hasattr(found, "load") and hasattr(found, "predict")
    }


class _Torch:
    """A TorchScript module that is given the row as a float32 tensor."""

    def __init__(self, torch: Any, module: Any) -> None:  # noqa: ANN401 - torch need not be there
        self._torch, self._module = torch, module

    def predict(self, row: Row) -> object:
        """The action."""
        with self._torch.no_grad():
            answer = self._module(self._torch.as_tensor(row, dtype=self._torch.float32))
        return answer.tolist() if hasattr(answer, "tolist") else answer


def load_torch(path: str, where: str) -> RowPolicy:
    """`FILE.pt`, a TorchScript file; torch is imported here, and never else."""
    file, torch = _file(path, where), _library("torch", "torch", where)
    try:
        module = torch.jit.load(file, map_location="cpu")
        module.eval()
    except Exception as error:
        raise ScenarioError(
            f"{where}: cannot be loaded as TorchScript: {_reason(error)}"
        ) from error
    return _Torch(torch, module)


_ONNX_TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}
_ONNX_SHAPES = ([*_ROW], [1, *_ROW])


def _may_be(told: list[Any], shape: list[int]) -> bool:
    """True if an input can have this shape: a size that is no number is free, and no sizes at all are not known."""
    return len(told) in (0, len(shape)) and all(
        size == wanted or not isinstance(size, int)
        for size, wanted in zip(told, shape, strict=False)
    )


class _Onnx:
    """An ONNX graph with one input: the row, or a batch of one."""

    def __init__(self, session: Any, where: str) -> None:  # noqa: ANN401 - onnxruntime need not be there
        inputs = session.get_inputs()
        if len(inputs) != 1:
            raise ScenarioError(f"{where}: has {len(inputs)} inputs; allowed: one, the UGV's row")
        (told,) = inputs
        fits = any(_may_be(told.shape, shape) for shape in _ONNX_SHAPES)
        if told.type not in _ONNX_TYPES or not fits:
            raise ScenarioError(
                f"{where}: its input is a {told.type} of shape {told.shape}; allowed: {', '.join(_ONNX_TYPES)} of "
                f"shape {' or '.join(map(str, _ONNX_SHAPES))}, the UGV's row"
            )
        self._session, self._name = session, told.name
        self._dtype = _ONNX_TYPES[told.type]
        self._batched = len(told.shape) == 2

    def predict(self, row: Row) -> object:
        """The action: the first output."""
        seen = row.astype(self._dtype)
        given = seen[np.newaxis] if self._batched else seen
        answer = self._session.run(None, {self._name: given})[0]
        return answer[0] if self._batched and len(answer) == 1 else answer


def load_onnx(path: str, where: str) -> RowPolicy:
    """`FILE.onnx`, by onnxruntime, which is imported here, and never else."""
    file, runtime = _file(path, where), _library("onnxruntime", "onnxruntime", where)
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1  # a policy is small, and the cores are the flight's
    try:
        session = runtime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise ScenarioError(f"{where}: cannot be loaded as ONNX: {_reason(error)}") from error
    return _Onnx(session, where)


def own_code(scenario: "Scenario") -> dict[str, str]:
    """The code that a scenario names, whoever has named it: its fields with their values."""
    custom: Any = scenario.custom
    named = {f"custom.{name}": getattr(custom, name) for name in custom.__struct_fields__}
    return {field: value for field, value in named.items() if value}


def foreign_code(scenario: "Scenario", named: Iterable[str] = ()) -> tuple[str, ...]:
    """The code that a scenario's file names, and not the user.

    It is somebody else's until the user says that it may be loaded.

    Args:
        scenario: What is flown.
        named: What the user has set: fields, or `field=value` as with `--set`.

    Returns:
        A line for each field.
    """
    changes = [change.partition("=") for change in named]
    own = {field.strip() for field, _, _ in changes}
    # ugv.0.driver=fmu:FILE says it too
    said = {value.strip().strip("\"'") for _, _, value in changes}
    given = {} if "custom" in own else own_code(scenario)
    return tuple(
        f"{field} = {value!r}: the file names code, which is loaded with --allow-code alone (in Python: "
        "allow_code=True)"
        for field, value in given.items()
        if field not in own and value not in said
    )


def check_code(
    scenario: "Scenario", named: Iterable[str] = (), *, source: object, allowed: bool
) -> None:
    """Refuse a scenario whose file names code, unless that is allowed; arguments otherwise as of `foreign_code`.

    Raises:
        ScenarioError: The first such field.
    """
    for line in () if allowed else foreign_code(scenario, named):
        raise ScenarioError(f"{one_line(str(source))}: {line}; allowed where you trust both")


def check_own_functions(scenario: "Scenario") -> tuple[str, ...]:
    """Load the scenario's own functions and hold them against what the paper asks of them, before anything is started.

    Returns:
        Warnings, one a line, where a path cannot be followed.

    Raises:
        ScenarioError: If a function is not there or does not fit.
    """
    if not own_code(scenario):
        return ()
    from agents.control.orbit import check_path  # noqa: PLC0415 - nobody else needs the laws
    from agents.control.uav_policy import check_fit  # noqa: PLC0415
    from agents.control.visibility import switching_radius  # noqa: PLC0415
    from agents.control.weighting import check_weighting  # noqa: PLC0415
    from sim.engine.briefing import uav_briefing  # noqa: PLC0415

    weighting = load_function(scenario.custom.weighting, what="custom.weighting")
    path = load_function(scenario.custom.path, what="custom.path")
    load_function(scenario.custom.policy, what="custom.policy")
    own = load_function(scenario.custom.uav_policy, what="custom.uav_policy")
    ugvs = {ugv.name: ugv for ugv in scenario.ugv}
    warnings: list[str] = []
    for uav in scenario.uav:
        if own is not None:
            briefing = uav_briefing(scenario, uav.name, 0)
            warnings += check_fit(briefing, own, scenario.custom.uav_policy)
        r_v, v_g = scenario.visibility.radius, ugvs[uav.escorts].max_speed
        if weighting is not None and LAWS[scenario.law.name].own == "weighting":
            check_weighting(
                weighting, switching_radius(r_v, uav.max_speed, v_g, uav.max_acceleration)
            )
        if path is not None and LAWS[scenario.law.name].own == "path":
            warnings += check_path(
                path, scenario.duration, r_v, uav.max_speed, v_g, uav.max_acceleration
            )
    return tuple(dict.fromkeys(warnings))
