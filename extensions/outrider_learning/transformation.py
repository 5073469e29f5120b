"""Transformations of a vector environment's observations and actions, with a memory of each world's episode."""

from abc import ABC, abstractmethod
from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from sim.env.observation import AgentObservation, one_of_world

Mask = npt.NDArray[np.bool_]
"""Mask of worlds. Shape (worlds,)."""


class Transformation(ABC):
    """Transformation of one vehicle's observations in all worlds; the first axis of every array is the world.

    One object serves one environment.
    """

    def settings(self) -> dict[str, Any]:
        """Return the arguments that recreate this transformation, as JSON data; the default: it cannot be saved.

        A recipe names the class as `module:class`, so the module must be importable where the policy flies.

        Raises:
            ValueError: If the transformation cannot be saved with a policy.
        """
        raise ValueError(
            f"{type(self).__name__}: cannot be saved with a policy without its own settings(); "
            "allowed: one that returns the constructor's arguments"
        )

    @abstractmethod
    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space of a transformed observation; called once, before anything else.

        Args:
            space: Space of one world's original observation.

        Raises:
            ValueError: If the transformation does not fit it.
        """

    def action_space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space of one world's action before `action`, given the environment's."""
        return space

    def begin(self, observation: AgentObservation, worlds: Mask) -> AgentObservation:
        """Start an episode in these worlds; the others keep their memory."""
        return self.apply(observation)

    @abstractmethod
    def apply(self, observation: AgentObservation) -> AgentObservation:
        """Return the transformed observation of the next step as new arrays."""

    def action(self, action: Any) -> Any:  # noqa: ANN401 - the environment rejects invalid actions
        """Return the environment's action for an action chosen by the last observation. Shape (worlds, 2)."""
        return action


class Transformed(VectorWrapper):  # not subscripted: Gymnasium 1.1 takes no arguments here
    """Vector environment with transformed observations, including `infos["final_obs"]`.

    Args:
        env: Environment or wrapper, in any autoreset mode. `final_obs` must be an array of objects.
        transformation: Transformation of observations and actions.

    Raises:
        ValueError: If the transformation does not fit the observations.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], transformation: Transformation) -> None:
        super().__init__(env)
        self.autoreset_mode = AutoresetMode(env.metadata["autoreset_mode"])
        """Mode of the environment; TorchRL reads it here."""
        self.transformation = transformation
        self.single_observation_space = transformation.space(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self.single_action_space = transformation.action_space(env.single_action_space)
        self.action_space = batch_space(self.single_action_space, env.num_envs)
        self._over: Mask = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[AgentObservation, dict[str, Any]]:
        """Start an episode in every world, or in the worlds of `options["reset_mask"]`."""
        mask = (options or {}).get("reset_mask")  # read before the environment removes it
        worlds = np.ones(self.num_envs, np.bool_) if mask is None else np.array(mask, np.bool_)
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]  # they take lists
        self._over &= ~worlds
        return self.transformation.begin(observations, worlds), infos

    def step(self, actions: Any) -> tuple[AgentObservation, Any, Any, Any, dict[str, Any]]:  # noqa: ANN401 - as the environment's
        """Advance all worlds by one step."""
        transform, acted = self.transformation, self.transformation.action(actions)
        observations, rewards, terminations, truncations, infos = self.env.step(acted)
        ended = np.logical_or(terminations, truncations)
        begins = self._over  # in the mode NEXT_STEP: episodes that ended one step ago
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            shown = transform.apply(_replaced(observations, infos["final_obs"], ended))
            infos = infos | {"final_obs": _separate(shown, ended)}
            begins = ended
        else:
            shown = transform.apply(observations)
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._over = ended
        if begins.any():
            shown = transform.begin(observations, begins)
        return shown, rewards, terminations, truncations, infos


def _replaced(observations: AgentObservation, final: Any, worlds: Mask) -> AgentObservation:  # noqa: ANN401
    """Return the observations with the final ones of the ended episodes inserted."""
    whole = deepcopy(observations)
    for k in np.flatnonzero(worlds).tolist():
        if isinstance(whole, dict):
            for key, array in whole.items():
                array[k] = final[k][key]
        else:
            whole[k] = final[k]
    return whole


def _separate(observation: AgentObservation, worlds: Mask) -> npt.NDArray[np.object_]:
    """Return the observations of these worlds as an array of objects."""
    final = np.full(len(worlds), None, dtype=object)
    for k in np.flatnonzero(worlds).tolist():
        final[k] = deepcopy(one_of_world(observation, k))
    return final
