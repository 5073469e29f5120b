"""Trained networks as `npz` policies: no code in the file, and no learning library to fly them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from gymnasium import spaces

from bus.errors import ScenarioError
from outrider_learning.learned import LearnedPolicy
from outrider_learning.mlp import Mlp, load_policy, save_policy
from outrider_learning.recipe import ObservationRecipe, checked_recipe, observation_recipe
from outrider_learning.saved import SavedPolicy
from sim.env.observation import AgentObservation, Array

OBSERVATION = "observation"
"""Entry of the recipe with the observation, an `ObservationRecipe`; `examples/train_uav.py` has others."""


class NetworkModel:
    """Network of means with the interface of a model; actions are clipped to their space.

    Args:
        network: The network.
        observation_space: Space of its observations in one world.
        low, high: Bounds of its actions.
    """

    def __init__(
        self,
        network: Mlp,
        observation_space: spaces.Space[Any],
        low: list[float],
        high: list[float],
    ) -> None:
        self._network = network
        self.observation_space = observation_space
        self.action_space: spaces.Space[Any] = spaces.Box(
            np.array(low), np.array(high), dtype=np.float64
        )

    def predict(
        self,
        observation: AgentObservation,
        state: object = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, object]:
        """Return the actions of all worlds, and the state unchanged."""
        if isinstance(observation, dict):
            raise ValueError("network: needs one array, got a dictionary")
        space: Any = self.action_space
        rows = observation.reshape(len(observation), -1)
        return np.clip(self._network(rows), space.low, space.high), state


def save_network(model: Any, file: str | Path, **about: Any) -> None:  # noqa: ANN401 - the library's
    """Save the network of a Stable-Baselines3 `MlpPolicy` and its recipe, `model.npz`.

    Args:
        model: Trained model of an on-policy algorithm with tanh layers, on one array.
        file: File to write.
        about: Further entries of the recipe, such as the training; JSON data.

    Raises:
        ValueError: If `observation_recipe` rejects the model's environment, or the network is of another form.
    """
    recipe = observation_recipe(model.get_env())
    layers = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    action = model.action_space
    save_layers(layers, recipe, (action.low.tolist(), action.high.tolist()), file, **about)


def save_layers(
    layers: Sequence[Any],
    recipe: ObservationRecipe,
    bounds: tuple[list[float], list[float]],
    file: str | Path,
    **about: Any,  # noqa: ANN401 - JSON data
) -> None:
    """Save the layers of a PyTorch network and the recipe of its observation, `model.npz`.

    Args:
        layers: Linear layers with Tanh between them, from the observation to the mean action.
        recipe: Recipe of the observation, see `observation_recipe`.
        bounds: Lower and upper bounds of the action, to which the mean is clipped.
        file: File to write.
        about: Further entries of the recipe, such as the training.

    Raises:
        ValueError: If the layers are of another form.
    """
    kinds = [type(layer).__name__ for layer in layers]
    if kinds != ["Linear", "Tanh"] * (len(kinds) // 2) + ["Linear"]:
        raise ValueError(
            f"model: layers {', '.join(kinds)}; allowed: linear ones with Tanh between them"
        )
    dense = [layer for layer in layers if hasattr(layer, "weight")]
    weights = tuple(layer.weight.detach().numpy().astype(np.float64) for layer in dense)
    biases = tuple(layer.bias.detach().numpy().astype(np.float64) for layer in dense)
    low, high = bounds
    save_policy(
        file,
        Mlp(weights, biases),
        {OBSERVATION: msgspec.to_builtins(recipe), "action": {"low": low, "high": high}, **about},
    )


def network_policy(network: Mlp, recipe: dict[str, Any]) -> SavedPolicy:
    """Return the policy of a network and the recipe that `save_network` or `save_layers` wrote.

    Raises:
        ValueError: If the recipe is not valid, or does not fit the network.
    """
    observation = checked_recipe(msgspec.convert(recipe[OBSERVATION], ObservationRecipe))
    try:
        low, high = (list(map(float, recipe["action"][key])) for key in ("low", "high"))
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"recipe: action: {type(error).__name__}: {error}; allowed: low, high"
        ) from error
    inputs, outputs = network.weights[0].shape[1], network.weights[-1].shape[0]
    space = observation.shown_space()
    entries = int(np.prod(space.shape or (0,)))
    if (inputs, outputs) != (entries, len(low)) or len(low) != len(high):
        raise ValueError(
            f"network: {inputs} inputs, {outputs} outputs; the recipe needs {entries} inputs, {len(low)} outputs"
        )
    return SavedPolicy(NetworkModel(network, space, low, high), observation)


def load_npz_policy(rest: str, where: str) -> SavedPolicy | LearnedPolicy:
    """Load `FILE.npz` of `save_layers` or `examples/train_uav.py`; `where` names field and value in errors.

    Raises:
        ScenarioError: If the file is missing or is not such a policy.
    """
    try:
        network, recipe = load_policy(rest)
        try:
            if OBSERVATION in recipe:
                return network_policy(network, recipe)
            return LearnedPolicy(network, recipe)
        except (ValueError, msgspec.ValidationError) as error:
            raise ValueError(f"policy {rest!r}: {error}") from error
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from error
