"""Saved policies that drive a UGV: of Stable-Baselines3, TorchScript and ONNX, each loaded by its own library."""

from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from agents.drivers.policy import RowPolicy
from bus.errors import ScenarioError, error_with_place, shortened
from bus.observations import UGV, Row, names
from bus.policies import policy_forms

_ROW, _ACTION = (len(UGV),), (2,)
"""Shapes of the observation and of the action."""


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


def _file(path: str, where: str, forms: str = "") -> str:
    if not Path(path).is_file():
        raise ScenarioError(
            f"{where}: no such file: {path or 'none is named'}; allowed: {forms or policy_forms('ugv')}"
        )
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
    model: RowPolicy = load_sb3_model(rest, where, policy_forms("ugv"))
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
        raise ScenarioError(f"{where}: names no algorithm; allowed: {forms}")
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
