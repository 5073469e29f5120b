"""Wrappers that prepare observations for learning.

Each takes a PettingZoo parallel environment or a Gymnasium vector one.

    env = history(normalized(egocentric(outrider.parallel_env("escort"))), 4)

`outrider.envs.observations` says what each does. They are ordinary wrappers of their ecosystem: they go around each
other, and around or inside those of others. What needs rows in SI units goes first: `agents.env_wrappers`, then
`egocentric`, then `coverage_image` and `normalized`, then `history`.
"""

from collections.abc import Callable, Collection, Mapping
from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from pettingzoo import ParallelEnv  # type: ignore[import-untyped]
from pettingzoo.utils import BaseParallelWrapper  # type: ignore[import-untyped]

from outrider.envs.observations.body import Egocentric
from outrider.envs.observations.image import CoverageImage
from outrider.envs.observations.normalized import Normalized
from outrider.envs.observations.stacking import History
from outrider.envs.observations.transformation import (
    COVERAGE,
    Channels,
    Mask,
    Transformation,
)
from sim.env.observation import AgentObservation, one_of_world

_ONE_WORLD: Mask = np.array(True)


class ParallelObservations(BaseParallelWrapper):  # type: ignore[misc]
    """Agents' observations transformed, each by an object of its own; the state stays as it is.

    Args:
        env: The environment, or a wrapper of it.
        make: Gives a new transformation.
        agents: Whose observations; None: everybody's.

    Raises:
        ValueError: If there is no such agent, or an agent's observations do not fit.
    """

    def __init__(
        self,
        env: Any,  # noqa: ANN401 - PettingZoo has no types
        make: Callable[[], Transformation],
        *,
        agents: Collection[str] | None = None,
    ) -> None:
        super().__init__(env)
        unknown = set(agents or ()) - set(env.possible_agents)
        if unknown or isinstance(agents, str):
            raise ValueError(
                f"agents = {agents!r}; allowed: a list of any of {', '.join(env.possible_agents)}"
            )
        self.observation_spaces: dict[str, spaces.Space[Any]] = {
            agent: env.observation_space(agent) for agent in env.possible_agents
        }
        self.action_spaces: dict[str, spaces.Space[Any]] = {
            agent: env.action_space(agent) for agent in env.possible_agents
        }
        self._transformations: dict[str, Transformation] = {}
        for agent in env.possible_agents if agents is None else agents:
            self._transformations[agent] = one = make()
            try:
                self.observation_spaces[agent] = one.space(self.observation_spaces[agent])
                self.action_spaces[agent] = one.action_space(self.action_spaces[agent])
            except ValueError as error:
                raise ValueError(f"{agent}: {error}") from error

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode."""
        observations, infos = self.env.reset(seed=seed, options=options)
        begun = {
            agent: one.begin(observations[agent], _ONE_WORLD)
            for agent, one in self._transformations.items()
            if agent in observations
        }
        return observations | begun, infos

    def step(self, actions: Mapping[str, Any]) -> tuple[dict[str, Any], ...]:
        """Let all vehicles act for one tick."""
        own = self._transformations
        acted = {
            agent: own[agent].action(action) if agent in own else action
            for agent, action in actions.items()
        }
        observations, *rest = self.env.step(acted)
        seen = {
            agent: one.apply(observations[agent])
            for agent, one in own.items()
            if agent in observations
        }
        return observations | seen, *rest


class VectorObservations(VectorWrapper):  # not subscripted: Gymnasium 1.1 takes no arguments here
    """The observations of all worlds transformed, `infos["final_obs"]` too, each with the memory of its own episode.

    `final_obs` keeps its form: an array or a dictionary of arrays, where worlds outside the mask have their
    observation of now, or an array of objects.

    Args:
        env: The environment, or a wrapper of it; any autoreset mode.
        make: Gives a new transformation.

    Raises:
        ValueError: If the observations do not fit, or the environment does not say its autoreset mode.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], make: Callable[[], Transformation]) -> None:
        super().__init__(env)
        try:
            self.autoreset_mode = AutoresetMode(env.metadata["autoreset_mode"])
        except (KeyError, ValueError) as error:
            raise ValueError(
                f"{env}: env.metadata['autoreset_mode'] must be a gymnasium.vector.AutoresetMode"
            ) from error
        self.transformation = make()
        """Of the observations of all worlds."""
        self.single_observation_space = self.transformation.space(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self.single_action_space = self.transformation.action_space(env.single_action_space)
        self.action_space = batch_space(self.single_action_space, env.num_envs)
        self._begin_next = self._none

    @property
    def _none(self) -> Mask:
        return np.zeros(self.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[AgentObservation, dict[str, Any]]:
        """Begin an episode in every world, or in those of `options["reset_mask"]`."""
        worlds = (options or {}).get("reset_mask")  # read before the environment takes it out
        worlds = ~self._none if worlds is None else np.array(worlds, dtype=np.bool_)
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]  # they take lists
        self._begin_next = self._begin_next & ~worlds
        return self.transformation.begin(observations, worlds), infos

    def step(self, actions: Any) -> tuple[AgentObservation, Any, Any, Any, dict[str, Any]]:  # noqa: ANN401 - as the environment's
        """Let all worlds go on by one tick."""
        own = self.transformation
        observations, rewards, terminations, truncations, infos = self.env.step(own.action(actions))
        begun = self._begin_next
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            begun = np.asarray(infos.get("_final_obs", begun), dtype=np.bool_)
            final = infos.get("final_obs")
            seen = own.apply(observations if final is None else _with(observations, final, begun))
            if final is not None:
                infos = infos | {"final_obs": _in_form(seen, final, begun)}
        else:
            seen = own.apply(observations)
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._begin_next = np.logical_or(terminations, truncations)
        if begun.any():
            seen = own.begin(observations, begun)
        return seen, rewards, terminations, truncations, infos


def _with(observations: AgentObservation, final: Any, worlds: Mask) -> AgentObservation:  # noqa: ANN401 - any of its forms
    """The observations with the last ones of these worlds in their places."""
    if isinstance(observations, dict):
        if isinstance(final, dict):
            return {key: _placed(array, final[key], worlds) for key, array in observations.items()}
        return {
            key: _placed(array, [one if one is None else one[key] for one in final], worlds)
            for key, array in observations.items()
        }
    return _placed(observations, final, worlds)


def _placed(array: npt.NDArray[Any], final: Any, worlds: Mask) -> npt.NDArray[Any]:  # noqa: ANN401
    whole = array.copy()
    for k in np.flatnonzero(worlds):
        whole[k] = final[k]
    return whole


def _in_form(seen: AgentObservation, final: Any, worlds: Mask) -> Any:  # noqa: ANN401
    """The transformed last observations as the environment gave its own."""
    if isinstance(final, dict) or final.dtype != object:
        return seen
    form = np.full(len(worlds), None, dtype=object)
    for k in np.flatnonzero(worlds).tolist():
        form[k] = deepcopy(one_of_world(seen, k))
    return form


def transformed(
    env: Any,  # noqa: ANN401 - of two ecosystems
    make: Callable[[], Transformation],
    *,
    agents: Collection[str] | None = None,
) -> Any:  # noqa: ANN401
    """The environment with its observations transformed.

    Args:
        env: A PettingZoo parallel environment or a Gymnasium vector environment.
        make: Gives a new transformation.
        agents: Of a parallel environment: whose observations; None: everybody's.

    Raises:
        TypeError: If the environment is neither.
        ValueError: If the observations do not fit, or there is no such agent.
    """
    if isinstance(env, VectorEnv):
        if agents is not None:
            raise ValueError(
                f"agents = {agents!r}; the worlds of a vector environment have one observation each: leave it out"
            )
        return VectorObservations(env, make)
    if isinstance(env, ParallelEnv):
        return ParallelObservations(env, make, agents=agents)
    raise TypeError(
        f"env must be a PettingZoo ParallelEnv or a gymnasium.vector.VectorEnv, not {type(env).__name__}"
    )


def normalized(
    env: Any,  # noqa: ANN401
    *,
    scale: float = 5.0,
    dtype: type[np.floating[Any]] = np.float32,
    agents: Collection[str] | None = None,
) -> Any:  # noqa: ANN401
    """Every entry scaled to [-1, 1]; arguments as `outrider.envs.observations.Normalized`, errors as `transformed`."""
    return transformed(env, lambda: Normalized(scale=scale, dtype=dtype), agents=agents)


def egocentric(env: Any, *, rest: float = 0.01, agents: Collection[str] | None = None) -> Any:  # noqa: ANN401
    """The vehicles' own frames, for observations and actions; arguments as `outrider.envs.observations.Egocentric`."""
    return transformed(env, lambda: Egocentric(rest=rest), agents=agents)


def history(
    env: Any,  # noqa: ANN401
    length: int,
    *,
    stride: int = 1,
    new_axis: bool = False,
    channels: Channels = "last",
    agents: Collection[str] | None = None,
) -> Any:  # noqa: ANN401
    """The last observations together; arguments as `outrider.envs.observations.History`, errors as `transformed`."""
    return transformed(
        env,
        lambda: History(length, stride=stride, new_axis=new_axis, channels=channels),
        agents=agents,
    )


def coverage_image(
    env: Any,  # noqa: ANN401
    *,
    channels: Channels = "last",
    only: bool = False,
    agents: Collection[str] | None = None,
) -> Any:  # noqa: ANN401
    """The coverage picture as an image of bytes; arguments as `outrider.envs.observations.CoverageImage`.

    Of a parallel environment, by default for all agents that observe coverage.

    Raises:
        TypeError: As `transformed`.
        ValueError: As `transformed`, or if nobody observes coverage.
    """
    if agents is None and isinstance(env, ParallelEnv):
        agents = [
            agent
            for agent in env.possible_agents
            if COVERAGE in (getattr(env.observation_space(agent), "spaces", None) or ())
        ]
        if not agents:
            raise ValueError(
                "coverage_image: no agent observes 'coverage': make the environment with coverage_patch"
            )
    return transformed(env, lambda: CoverageImage(channels=channels, only=only), agents=agents)
