"""Small network in plain NumPy, and its file format with a recipe.

It needs no learning library.
"""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bus.errors import shortened
from bus.files import open_regular, writing

Array = npt.NDArray[np.floating[Any]]

_RECIPE = "recipe"
_MOST_BYTES = 64 << 20
"""Largest size of a policy's file, compressed and uncompressed."""


class Mlp(NamedTuple):
    """Dense layers with tanh between them.

    A world's output has the same bits alone and in a batch, because each world is multiplied separately.
    """

    weights: tuple[Array, ...]
    """Weights of each layer, shape (outputs, inputs)."""
    biases: tuple[Array, ...]
    """Biases of each layer, shape (outputs,)."""

    def __call__(self, inputs: Array) -> Array:
        """Return the outputs, float64. Shape (..., inputs) to (..., outputs)."""
        x = np.asarray(inputs, dtype=np.float64)
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = np.matmul(weight, x[..., None])[..., 0] + bias
            if k < last:
                x = np.tanh(x)
        return x


def save_policy(path: str | Path, network: Mlp, recipe: dict[str, Any]) -> None:
    """Write a network in float32, and its recipe as JSON.

    Args:
        path: File, `.npz`.
        network: Network to save.
        recipe: Observation, action and training of the network.
    """
    arrays: dict[str, Any] = {_RECIPE: np.array(json.dumps(recipe, indent=1))}
    for k, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        arrays |= {f"weight_{k}": weight.astype(np.float32), f"bias_{k}": bias.astype(np.float32)}
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with writing(Path(path)), Path(path).open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_policy(path: str | Path) -> tuple[Mlp, dict[str, Any]]:
    """Load a network and its recipe.

    Raises:
        ValueError: If the file is missing or is not a policy; one line.
    """
    try:
        # Open it here: NumPy does not close the file of a broken archive.
        with (
            open_regular(Path(path), _MOST_BYTES) as file,
            np.load(file, allow_pickle=False) as archive,
        ):
            if sum(member.file_size for member in archive.zip.infolist()) > _MOST_BYTES:
                raise ValueError(f"unpacks to more than {_MOST_BYTES >> 20} MiB")
            arrays = {name: archive[name] for name in archive.files}
        recipe = json.loads(str(arrays.pop(_RECIPE)[()]))
        layers = range(len(arrays) // 2)
        weights, biases = (
            tuple(arrays[f"{part}_{k}"].astype(np.float64, casting="same_kind") for k in layers)
            for part in ("weight", "bias")
        )
    except FileNotFoundError as error:
        raise ValueError(f"policy {str(path)!r}: no such file") from error
    except (
        Exception
    ) as error:  # zipfile, zlib and NumPy raise errors of many kinds for a damaged file
        reason = shortened(f"{type(error).__name__}: {error}")
        raise ValueError(
            f"policy {str(path)!r}: cannot be read: {reason}; allowed: a file of examples/train_uav.py or save_network"
        ) from error
    _check(path, weights, biases, recipe)
    return Mlp(weights, biases), recipe


def _check(
    path: str | Path, weights: tuple[Array, ...], biases: tuple[Array, ...], recipe: object
) -> None:
    shapes = [weight.shape for weight in weights]
    fits = (
        bool(weights)
        and all(len(shape) == 2 for shape in shapes)
        and all(bias.shape == shape[:1] for bias, shape in zip(biases, shapes, strict=True))
        and all(shape[0] == after[1] for shape, after in pairwise(shapes))
        and all(np.isfinite(array).all() for array in (*weights, *biases))
    )
    if not fits:
        raise ValueError(
            f"policy {str(path)!r}: layers of shapes {shapes} do not fit together, or are not finite"
        )
    if not isinstance(recipe, dict):
        raise ValueError(f"policy {str(path)!r}: its recipe is not a table")
