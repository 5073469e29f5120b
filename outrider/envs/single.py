"""Gymnasium environment with one learning vehicle in one world; the compiled loop controls the other vehicles.

It equals world 0 of `outrider.vector_env` bit for bit, but an ended episode stays ended until `reset`.
"""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded

from bus.messages.links import LinkStatus
from outrider.envs.worlds import PICTURES, Worlds
from sim.env.actions import take_actions
from sim.env.observation import AgentObservation, one_of_world
from sim.env.seeds import Seeds, check_options
from sim.scenario.types import Scenario


class SingleEnv(gymnasium.Env[Any, Any]):
    """One vehicle learns; the others follow the scenario's law and drivers, or the pilots in `others`.

    Args:
        scenario: Shipped name, file, or scenario.
        agent: Learning vehicle.
        render_mode: None, or "rgb_array"; `outrider.parallel_env` also has a window.
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
        agent: str = "uav_0",
        render_mode: str | None = None,
        **settings: Any,  # noqa: ANN401 - fields of `Settings`
    ) -> None:
        self.worlds = Worlds(scenario, 1, [agent], render_mode=render_mode, **settings)
        """World of the environment, as a batch of one, with its true state."""
        self.agent = agent
        self.render_mode = render_mode
        self.observation_space = self.worlds.observation_spaces[agent]
        self.action_space = self.worlds.action_spaces[agent]
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[AgentObservation, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Seed of all random numbers of the episode. Without one, the first episode has a seed from the
                operating system, and each later one a seed derived from the last given or drawn seed and the number of
                episodes since.
            options: None, or empty: there are none.

        Returns:
            Observation and info.

        Raises:
            ValueError: If the seed is not a whole number from 0 to 2**53 - 1, or there are options; the current episode
                then continues.
        """
        Seeds.check(seed)
        check_options(options)
        super().reset(seed=None if seed is None else int(seed))  # Gymnasium rejects NumPy integers
        self.worlds.reset([seed], None)
        self._over = False
        return self._observation(), self.worlds.info(self.agent)

    def step(
        self, action: npt.ArrayLike
    ) -> tuple[AgentObservation, float, bool, bool, dict[str, Any]]:
        """Advance the vehicle by one tick.

        Args:
            action: Acceleration [m/s²], two finite numbers; three for a UAV that has an altitude.

        Returns:
            Observation, reward, termination, truncation, and info.

        Raises:
            ResetNeeded: If no episode is running.
            ValueError: If the action does not hold finite numbers; the state is unchanged then.
        """
        if self._over:
            when = (
                "after the end of the episode: call reset() first"
                if self.worlds.has_episode
                else "before reset()"
            )
            raise ResetNeeded(f"step() {when}")
        columns = self.worlds.action_columns[self.agent]
        (taken,) = take_actions({self.agent: action}, {self.agent: columns})
        self._over = bool(
            self.worlds.step({self.agent: [[taken[column] for column in columns]]})[0]
        )
        (terminated,), (truncated,) = (flags.tolist() for flags in self.worlds.ends())
        return (
            self._observation(),
            float(self.worlds.rewards(self.agent)[0]),
            terminated,
            truncated,
            self.worlds.info(self.agent),
        )

    def _observation(self) -> AgentObservation:
        return one_of_world(self.worlds.observe(self.agent), 0)

    @property
    def episode_seed(self) -> int:
        """Seed of the current episode; `outrider run --seed` with it flies the same one."""
        return self.worlds.episode_seeds[0]

    def metrics(self) -> dict[str, dict[str, Any]]:
        """Return each vehicle's true metrics and the terms of its last reward: for people and logs, not for policies.

        A UAV inside the safety filter also has `uncertified`, the reason of `NotCertified`; empty: certified.
        """
        return self.worlds.first_metrics()

    def links(self) -> dict[str, LinkStatus]:
        """Return the counters of each link so far, by `vehicle/kind`: for people and logs, not for policies."""
        return self.worlds.links(0)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return a picture of the current tick, shape (rows, columns, 3); None without a render mode.

        Raises:
            ResetNeeded: Before the first reset.
        """
        pictures = self.worlds.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """Stop the threads."""
        self.worlds.loop.close()


single_env = SingleEnv
"""Environment under its usual name."""
