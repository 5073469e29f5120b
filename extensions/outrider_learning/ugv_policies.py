"""Saved UGV policies of Stable-Baselines3, TorchScript and ONNX, each loaded by its own library."""

from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from agents.drivers.policy import RowPolicy
from bus.errors import ScenarioError, error_with_place, shortened
from bus.observations import HEADING, UGV, Row, names
from bus.policies import policy_forms

_ROWS, _ACTION = ((len(UGV),), (len(UGV + HEADING),)), (2,)
"""Shapes of observations, of a point and of a UGV that steers, and of an action."""


def _reason(error: BaseException) -> str:
    return shortened(error_with_place(error))


def _library(module: str, package: str, where: str) -> ModuleType:
    try:
        return import_module(module)
    except ImportError as error:
        raise ScenarioError(
            f"{where}: needs {package}: pip install {package} ({_reason(error)})"
        ) from error
    except Exception as error:
        raise ScenarioError(f"{where}: {package} cannot be imported: {_reason(error)}") from error


def _one_thread(where: str) -> Any:  # noqa: ANN401 - torch is optional
    """Import torch and let it use one thread: a policy is small, and more threads slow it down."""
    torch = _library("torch", "torch", where)
    torch.set_num_threads(1)
    return torch


def _file(path: str, where: str, forms: str = "") -> str:
    if not Path(path).is_file():
        raise ScenarioError(
            f"{where}: no such file: {path or 'no file given'}; allowed: {forms or policy_forms('ugv')}"
        )
    return path


def _check_shapes(row: object, action: object, where: str) -> None:
    """Reject a policy of another agent; None is an unknown shape."""
    if row not in (None, *_ROWS) or action not in (None, _ACTION):
        raise ScenarioError(
            f"{where}: observations of shape {row} and actions of shape {action}; "
            f"allowed: {_ROWS[0]}, the UGV's row, or {_ROWS[1]} if it steers, and {_ACTION}, its acceleration"
        )


def _row_of(space: object, where: str) -> object:
    """Return the row's space in a policy's observation, alone or beside the picture of the tiles."""
    parts = getattr(space, "spaces", None)
    if not isinstance(parts, Mapping):
        return space
    shapes = {name: getattr(part, "shape", None) for name, part in parts.items()}
    side, *more = shapes.get("tiles") or (0,)
    if shapes.keys() != {"row", "tiles"} or more != [side] or side % 2 == 0:
        raise ScenarioError(
            f"{where}: observations of shapes {shapes}; allowed: the UGV's row, alone or with 'tiles', a square "
            "picture with an odd number of rows"
        )
    return parts["row"]


def _check_units(row: object, where: str) -> None:
    """Reject a policy trained on normalized rows, because it receives SI units.

    Rows in SI units start at 0, except for the velocity; infinite bounds are not checked.
    """
    low = getattr(row, "low", None)
    if low is None:
        return
    signed = {"vx", "vy", *names(HEADING)}
    below = np.array([name in signed for name in names(UGV + HEADING)][: len(low)])
    if (np.isfinite(low) & ((low < 0.0) != below)).any():
        raise ScenarioError(
            f"{where}: observations from {low.tolist()} on are not rows in SI units; allowed: rows of the "
            "environment, or your own policy that transforms them"
        )


def load_sb3(rest: str, where: str) -> RowPolicy:
    """Load `ALGORITHM:FILE.zip` for a UGV, and check observations and actions."""
    model: RowPolicy = load_sb3_model(rest, where, policy_forms("ugv"))
    row = _row_of(getattr(model, "observation_space", None), where)
    done = getattr(model, "action_space", None)
    _check_shapes(getattr(row, "shape", None), getattr(done, "shape", None), where)
    _check_units(row, where)
    return model


def load_sb3_model(rest: str, where: str, forms: str) -> Any:  # noqa: ANN401 - the library's
    """Load `ALGORITHM:FILE.zip` of stable_baselines3 or sb3_contrib, which are imported only here.

    Args:
        rest: Algorithm and file.
        where: Field and value, for errors.
        forms: Allowed forms, for errors.

    Raises:
        ScenarioError: If the model cannot be loaded.
    """
    algorithm, separator, path = rest.partition(":")
    if not separator:
        raise ScenarioError(f"{where}: algorithm missing; allowed: {forms}")
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
    _one_thread(where)
    try:
        return found.load(file, device="cpu")
    except Exception as error:
        raise ScenarioError(f"{where}: cannot be loaded: {_reason(error)}") from error


def _algorithms(library: ModuleType) -> dict[str, Any]:
    """Return the library's algorithms by name in lower case."""
    known = {name.lower(): found for name, found in vars(library).items()}
    return {
        name: found
        for name, found in known.items()
        if hasattr(found, "load") and hasattr(found, "predict")
    }


class _Torch:
    """TorchScript module that receives the row as a float32 tensor."""

    def __init__(self, torch: Any, module: Any) -> None:  # noqa: ANN401 - torch is optional
        self._torch, self._module = torch, module

    def predict(self, row: Row) -> object:
        """Return the action."""
        with self._torch.no_grad():
            answer = self._module(self._torch.as_tensor(row, dtype=self._torch.float32))
        return answer.tolist() if hasattr(answer, "tolist") else answer


def load_torch(path: str, where: str) -> RowPolicy:
    """Load a TorchScript file, `FILE.pt`; torch is imported only here."""
    file, torch = _file(path, where), _one_thread(where)
    try:
        module = torch.jit.load(file, map_location="cpu")
        module.eval()
    except Exception as error:
        raise ScenarioError(
            f"{where}: cannot be loaded as TorchScript: {_reason(error)}"
        ) from error
    return _Torch(torch, module)


_ONNX_TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}
_ONNX_SHAPES = tuple(shape for row in _ROWS for shape in ([*row], [1, *row]))


def _may_be(declared: list[Any], shape: list[int]) -> bool:
    """Return true if an input can have this shape; sizes that are not numbers are free.

    An empty list of sizes is unknown.
    """
    return len(declared) in (0, len(shape)) and all(
        size == wanted or not isinstance(size, int)
        for size, wanted in zip(declared, shape, strict=False)
    )


class _Onnx:
    """ONNX graph with one input: the row, or a batch of one."""

    def __init__(self, session: Any, where: str) -> None:  # noqa: ANN401 - onnxruntime is optional
        inputs = session.get_inputs()
        if len(inputs) != 1:
            raise ScenarioError(f"{where}: {len(inputs)} inputs; allowed: one, the UGV's row")
        (declared,) = inputs
        fits = any(_may_be(declared.shape, shape) for shape in _ONNX_SHAPES)
        if declared.type not in _ONNX_TYPES or not fits:
            raise ScenarioError(
                f"{where}: input of type {declared.type} and shape {declared.shape}; "
                f"allowed: {', '.join(_ONNX_TYPES)} of shape {' or '.join(map(str, _ONNX_SHAPES))}, the UGV's row"
            )
        self._session, self._name = session, declared.name
        self._dtype = _ONNX_TYPES[declared.type]
        self._batched = len(declared.shape) == 2

    def predict(self, row: Row) -> object:
        """Return the action: the first output."""
        values = row.astype(self._dtype)
        given = values[np.newaxis] if self._batched else values
        answer = self._session.run(None, {self._name: given})[0]
        return answer[0] if self._batched and len(answer) == 1 else answer


def load_onnx(path: str, where: str) -> RowPolicy:
    """Load `FILE.onnx` by onnxruntime, which is imported only here."""
    file, runtime = _file(path, where), _library("onnxruntime", "onnxruntime", where)
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1  # a policy is small; leave the cores to the simulation
    try:
        session = runtime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise ScenarioError(f"{where}: cannot be loaded as ONNX: {_reason(error)}") from error
    return _Onnx(session, where)
