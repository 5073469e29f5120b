"""Many worlds at once for training: a Gymnasium vector environment for one vehicle, and one for all vehicles.

`docs/reference/environment.md` describes observations and rewards; they equal `outrider.parallel_env` bit for bit. An
ended episode resets in the same step (Gymnasium's SAME_STEP): the observation is the first one of the new episode, and
the last one of the old episode is in `infos["final_obs"]`. With `autoreset_mode=AutoresetMode.NEXT_STEP`, which
Gymnasium's own wrappers require, it resets in the next step.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from outrider.envs.autoreset import AutoresetWorlds, BatchStep
from outrider.envs.worlds import PICTURES
from sim.compiling.compile import FloatArray
from sim.env.observation import AgentObservation, Array
from sim.scenario.types import Scenario


class OutriderVectorEnv(VectorEnv):
    """One vehicle learns in many worlds at once; the compiled loop controls the others.

    World k, once reset with a seed, equals `outrider.parallel_env` bit for bit with that seed, the same actions, and
    the pilots of the other vehicles.

    Args:
        scenario: Shipped name, file, or scenario.
        num_envs: Number of worlds.
        agent: Learning vehicle.
        render_mode: None, or "rgb_array".
        autoreset_mode: Time of the reset after an episode has ended: SAME_STEP or NEXT_STEP.
        settings: Keywords, see `sim.env.settings.Settings`.

    Raises:
        ScenarioError: If the scenario cannot be flown.
        ValueError: If another argument is not allowed.
        TypeError: If a setting is unknown.
    """

    metadata: dict[str, Any] = PICTURES

    def __init__(
        self,
        scenario: str | Path | Scenario = "escort",
        *,
        num_envs: int,
        agent: str = "uav_0",
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **settings: Any,  # noqa: ANN401 - fields of `Settings`
    ) -> None:
        self.worlds = AutoresetWorlds(
            scenario,
            num_envs,
            [agent],
            render_mode=render_mode,
            autoreset_mode=autoreset_mode,
            **settings,
        )
        """Worlds of the environment, with their true state."""
        self.autoreset_mode = self.worlds.autoreset_mode
        """Autoreset mode: TorchRL reads it here, Gymnasium in the metadata."""
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}
        self.agent = agent
        self.render_mode = render_mode
        self.num_envs = self.worlds.num_envs
        self.single_observation_space = self.worlds.observation_spaces[agent]
        self.single_action_space = self.worlds.action_spaces[agent]
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[AgentObservation, dict[str, Any]]:
        """Begin an episode in every world.

        Args:
            seed: World k gets seed + k; or a sequence with one seed per world. Without any, each world's first episode
                has a seed from the operating system, and each later one a seed derived from its world's last one given
                or drawn.
            options: `reset_mask`, booleans that select the worlds to reset. Shape (num_envs,).

        Returns:
            Observations and infos.
        """
        self.worlds.reset(seed, options)
        if seed is not None:
            self.np_random, _ = seeding.np_random(self.worlds.episode_seeds[0])
        return self.worlds.observe(self.agent), self.worlds.infos(self.agent)

    def step(
        self, actions: npt.ArrayLike
    ) -> tuple[
        AgentObservation, FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]
    ]:
        """Advance the vehicle by one tick in every world.

        Args:
            actions: Accelerations [m/s²], finite. Shape (num_envs, 2); (num_envs, 3) for a UAV that has an altitude.

        Raises:
            ResetNeeded: Before the first reset.
            ValueError: If the actions are not finite numbers of this shape; the state is unchanged then.
        """
        stepped, one = self.worlds.step_with_autoreset({self.agent: actions}), self.agent
        observations, rewards, terminations, truncations, infos = stepped
        return observations[one], rewards[one], terminations[one], truncations[one], infos[one]

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """Return a picture of each world, as in `Worlds.render`; after a reset, of the new episode's start."""
        return self.worlds.render()

    def metrics(self) -> dict[str, dict[str, FloatArray]]:
        """Return each vehicle's true metrics, as in `Worlds.metrics`: for people and logs, not for policies."""
        return self.worlds.metrics()

    def close_extras(self, **_: Any) -> None:  # noqa: ANN401 - Gymnasium's
        """Stop the threads."""
        self.worlds.loop.close()


class OutriderParallelVectorEnv:
    """All vehicles learn, in many worlds at once.

    The interface is PettingZoo's parallel one; the arrays have an axis for worlds.

    Args:
        scenario: Shipped name, file, or scenario.
        num_envs: Number of worlds.
        agents: Learning vehicles; all by default.
        render_mode: None, or "rgb_array".
        autoreset_mode: Time of the reset after an episode has ended: SAME_STEP or NEXT_STEP.
        settings: Keywords, see `sim.env.settings.Settings`.

    Raises:
        ScenarioError: If the scenario cannot be flown.
        ValueError: If another argument is not allowed.
        TypeError: If a setting is unknown.
    """

    metadata: dict[str, Any] = PICTURES | {"name": "outrider_v0"}

    def __init__(
        self,
        scenario: str | Path | Scenario = "escort",
        *,
        num_envs: int,
        agents: Sequence[str] | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **settings: Any,  # noqa: ANN401 - fields of `Settings`
    ) -> None:
        self.worlds = AutoresetWorlds(
            scenario,
            num_envs,
            agents,
            render_mode=render_mode,
            autoreset_mode=autoreset_mode,
            **settings,
        )
        """Worlds of the environment, with their true state."""
        self.autoreset_mode = self.worlds.autoreset_mode
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}
        self.num_envs = self.worlds.num_envs
        self.render_mode = render_mode
        self.state_space = self.worlds.true_state.space
        """Space of the state of one world."""
        self.state_names = self.worlds.true_state.names
        """Names of the entries of `state()`."""
        self.possible_agents = self.worlds.learners
        self.agents = list(self.possible_agents)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of an agent's observation in one world."""
        return self.worlds.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of an agent's action in one world."""
        return self.worlds.action_spaces[agent]

    def reset(
        self,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[dict[str, AgentObservation], dict[str, dict[str, Any]]]:
        """Begin an episode in every world; arguments as in `OutriderVectorEnv.reset`."""
        self.worlds.reset(seed, options)
        observations = {name: self.worlds.observe(name) for name in self.agents}
        return observations, {name: self.worlds.infos(name) for name in self.agents}

    def step(self, actions: Mapping[str, npt.ArrayLike]) -> BatchStep:
        """Advance all vehicles by one tick in every world.

        Args:
            actions: Accelerations [m/s²] of each agent. Shape (num_envs, 2) each; (num_envs, 3) for a UAV that has an
                altitude.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent; all agents of a world end together.

        Raises:
            ResetNeeded: Before the first reset.
            ValueError: If an agent's actions are missing or not finite numbers of this shape; the state is
                unchanged then.
        """
        return self.worlds.step_with_autoreset(actions)

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """Return a picture of each world, as in `Worlds.render`; after a reset, of the new episode's start."""
        return self.worlds.render()

    def metrics(self) -> dict[str, dict[str, FloatArray]]:
        """Return each vehicle's true metrics, as in `Worlds.metrics`: for people and logs, not for policies."""
        return self.worlds.metrics()

    def state(self) -> Array:
        """Return the complete true states, as in `Worlds.state`; after a reset, of the new episode's start."""
        return self.worlds.state()

    def close(self) -> None:
        """Stop the threads."""
        self.worlds.loop.close()


vector_env = OutriderVectorEnv
"""Environment of one learner under its usual name."""
parallel_vector_env = OutriderParallelVectorEnv
"""Environment of many learners under its usual name."""
