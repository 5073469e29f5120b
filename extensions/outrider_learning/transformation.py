"""Transformations of the observations and actions of a vector environment, with a memory of each world's episode."""

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
"""One truth value for each world. Shape (worlds,)."""


class Transformation(ABC):
    """The change to one vehicle's observations in all worlds; the first axis of every array is that of the worlds.

    One object serves one environment.
    """

    def settings(self) -> dict[str, Any]:
        """Return the arguments that make another one like this, as JSON can hold them.

        Raises:
            ValueError: If there are none: it cannot be saved with a policy.
        """
        raise ValueError(
            f"{type(self).__name__} cannot be saved with a policy: it has no settings()"
        )

    @abstractmethod
    def space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space of a transformed observation; called once, before anything else.

        Args:
            space: The space of one world's observation before.

        Raises:
            ValueError: If the transformation does not fit it.
        """

    def action_space(self, space: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space of one world's action before `action`, given that of the environment."""
        return space

    def begin(self, observation: AgentObservation, worlds: Mask) -> AgentObservation:
        """Begin an episode in these worlds with this observation of all worlds; the others' memory stays."""
        return self.apply(observation)

    @abstractmethod
    def apply(self, observation: AgentObservation) -> AgentObservation:
        """Return the observation of the next step, transformed: new arrays."""

    def action(self, action: Any) -> Any:  # noqa: ANN401 - the environment refuses what is no action
        """Return the environment's action for one that was chosen by the last observation. Shape (worlds, 2)."""
        return action


class Transformed(VectorWrapper):  # not subscripted: Gymnasium 1.1 takes no arguments here
    """A vector environment with transformed observations, `infos["final_obs"]` too.

    Args:
        env: The environment, or a wrapper of it; any autoreset mode. `final_obs` must be an array of objects.
        transformation: The change.

    Raises:
        ValueError: If the transformation does not fit the observations.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], transformation: Transformation) -> None:
        super().__init__(env)
        self.autoreset_mode = AutoresetMode(env.metadata["autoreset_mode"])
        """The environment's; TorchRL reads it here."""
        self.transformation = transformation
        self.single_observation_space = transformation.space(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self.single_action_space = transformation.action_space(env.single_action_space)
        self.action_space = batch_space(self.single_action_space, env.num_envs)
        self._over: Mask = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[AgentObservation, dict[str, Any]]:
        """Begin an episode in every world, or in those of `options["reset_mask"]`."""
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
        begins = self._over  # in the mode NEXT_STEP; its episodes ended a step ago
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            seen = transform.apply(_replaced(observations, infos["final_obs"], ended))
            infos = infos | {"final_obs": _separate(seen, ended)}
            begins = ended
        else:
            seen = transform.apply(observations)
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._over = ended
        if begins.any():
            seen = transform.begin(observations, begins)
        return seen, rewards, terminations, truncations, infos


def _replaced(observations: AgentObservation, final: Any, worlds: Mask) -> AgentObservation:  # noqa: ANN401
    """Return the observations with the last ones of the ended episodes in their places."""
    whole = deepcopy(observations)
    for k in np.flatnonzero(worlds).tolist():
        if isinstance(whole, dict):
            for key, array in whole.items():
                array[k] = final[k][key]
        else:
            whole[k] = final[k]
    return whole


def _separate(seen: AgentObservation, worlds: Mask) -> npt.NDArray[np.object_]:
    """Return the observations of these worlds as an array of objects."""
    final = np.full(len(worlds), None, dtype=object)
    for k in np.flatnonzero(worlds).tolist():
        final[k] = deepcopy(one_of_world(seen, k))
    return final
