"""PettingZoo environment with one world: a thin view of the closed loop, with a batch of one.

`bus.observations` defines the entries of an observation, `sim.env.rewards` the rewards, `sim.env.rows` the row of each
vehicle.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import logger, spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv  # type: ignore[import-untyped]

from bus.messages.links import LinkStatus
from bus.messages.vehicle import Briefing, UavCommand, UgvCommand
from bus.observations import ALTITUDE, HEADING, UAV, UGV, with_tables
from outrider.envs.worlds import Worlds
from sim.engine.briefing import briefing
from sim.engine.run_keys import check_secret
from sim.env.actions import ACTION_COLUMNS, check_by_agent, take_actions
from sim.env.observation import AgentObservation, Array, one_of_world
from sim.env.seeds import Seeds, check_options
from sim.env.view import Rendering
from sim.models.ground import TileArray
from sim.scenario.types import Scenario
from sim.world import World

Action = npt.ArrayLike | UavCommand | UgvCommand
"""Acceleration [m/s²], or the command of a pilot, which may also carry backup trajectories and a route."""

_CONFORMANCE = {"options": 1}
"""Options with which PettingZoo's conformance tests reset."""


def _acceleration(action: Action, length: int) -> npt.ArrayLike:
    """Return the acceleration in an action, with this number of entries; an array stays as it is."""
    if isinstance(action, UavCommand):
        return (*action.acceleration, action.vertical_acceleration)[:length]
    return action.acceleration if isinstance(action, UgvCommand) else action


@with_tables(
    {
        "A UAV observes": UAV,
        "then, if it has an altitude": ALTITUDE,
        "A UGV observes": UGV,
        "then, if it steers": HEADING,
    }
)
class OutriderEnv(ParallelEnv):  # type: ignore[misc]
    """A UAV escorts a UGV, covers as much ground around it as possible, and never loses sight of it.

    Agents are the scenario's vehicles. An action is an acceleration [m/s²], applied for one tick; an action whose norm
    exceeds the bound of (1) is shortened. A pilot's command is also a valid action. An observation is the vehicle's own
    row and nothing else; the complete true state is in `state()`. On ground with hazards a UGV's observation is a
    dictionary: `row`, and `tiles`, a picture of its occupancy grid. `docs/reference/environment.md` shows the entries
    of all rows; in code, `bus.observations` has them (`UAV`, `ALTITUDE`, `UGV`, `HEADING`).

    All agents end together. `bus.observations.SYMBOLS` explains the letters of the ranges.

    Args:
        scenario: Shipped name, file, or scenario.
        render_mode: None, "rgb_array" or "human".
        settings: Keywords, see `sim.env.settings.Settings`.

    Raises:
        ScenarioError: If the scenario cannot be flown, or its duration is not a whole number of ticks.
        ValueError: If another argument is not allowed.
        TypeError: If a setting is unknown.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as PettingZoo declares it
        "name": "outrider_v0",
        "render_modes": ["human", "rgb_array"],
        "render_fps": 20,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        scenario: str | Path | Scenario = "escort",
        *,
        render_mode: str | None = None,
        **settings: Any,  # noqa: ANN401 - fields of `Settings`
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode = {render_mode!r}; allowed: None, 'human', 'rgb_array'")
        self.worlds = Worlds(scenario, 1, None, error=True, **settings)
        """World of the environment, as a batch of one, with its true state."""
        self.scenario = self.worlds.scenario
        """Scenario of the environment; randomized fields have the largest value of their range."""
        self.render_mode = render_mode
        loop = self.worlds.loop
        self.possible_agents: list[str] = list(loop.names)
        self.agents: list[str] = []
        self.action_spaces = self.worlds.action_spaces
        self.observation_spaces = self.worlds.observation_spaces
        self.state_space = self.worlds.true_state.space
        self.state_names = self.worlds.true_state.names
        """Names of the entries of `state()`."""
        self.degraded = loop.degraded
        """True if any link is imperfect."""
        self.episode = 0
        """Number of the episode; the first reset makes it 1."""
        self.secret = check_secret(self.worlds.settings.secret)
        """Secret that, with the seed, determines all random numbers. For the creator, not for policies."""
        self._np_random: np.random.Generator | None = None
        self._world: World | None = None
        self._actions = np.zeros((1, len(self.possible_agents), ACTION_COLUMNS))
        self._view = (
            None if render_mode is None else Rendering(render_mode, self.metadata["render_fps"])
        )

    @property
    def np_random(self) -> np.random.Generator:
        """Generator for wrappers, reseeded with each episode's seed; the world never draws from it."""
        if self._np_random is None:
            self._np_random, _ = seeding.np_random(self.episode_seed)
        return self._np_random

    @property
    def episode_seed(self) -> int:
        """Seed of the current episode; before the first reset, the seed of a first reset without one."""
        return self.worlds.episode_seeds[0]

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of an agent's actions; larger actions are shortened to the bound, not rejected."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, AgentObservation], dict[str, dict[str, Any]]]:
        """Begin an episode.

        Args:
            seed: Seed of all random numbers of the episode. Without one, the first episode has a seed from the
                operating system, and each later one a seed derived from the last given or drawn seed and the number of
                episodes since.
            options: None, or empty: there are none. The pair `{"options": 1}` has no effect, because PettingZoo's
                conformance tests reset with it.

        Returns:
            Observations and infos by agent.

        Raises:
            ValueError: If the seed is not a whole number from 0 to 2**53 - 1, or there are options; the current episode
                then continues.
        """
        Seeds.check(seed)
        if options != _CONFORMANCE:
            check_options(options)
        self.worlds.reset([seed], None)
        self._np_random = None
        self.episode += 1
        self._world = self.worlds.world(0)
        self.agents = list(self.possible_agents)
        self._follow()
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Action]
    ) -> tuple[
        dict[str, AgentObservation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Advance all vehicles by one tick.

        Args:
            actions: An acceleration [m/s²] for each agent, two finite numbers (three for a UAV that has an altitude),
                or a pilot's command.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent.

        Raises:
            ResetNeeded: If no episode is running.
            ValueError: If an action is missing, belongs to no agent, or does not hold finite numbers; the state is
                unchanged then.
        """
        world, loop = self.world, self.worlds.loop
        if not self.agents:
            raise ResetNeeded("step() after the end of the episode: call reset() first")
        check_by_agent(actions, self.possible_agents)
        self._actions[0] = self._taken(actions)
        for name, action in actions.items():
            if isinstance(action, (UavCommand, UgvCommand)):
                self._carry(world, name, action)
        self.worlds.advance(self._actions)
        rows, names = loop.state.rows, self.agents
        terminated, truncated = bool(rows.terminated[0]), bool(rows.truncated[0])
        if terminated or truncated:
            self.agents = []
        self._follow()
        return (
            self._observations(),
            dict(zip(names, self.worlds.all_rewards()[0].tolist(), strict=True)),
            dict.fromkeys(names, terminated),
            dict.fromkeys(names, truncated),
            self._infos(),
        )

    def _taken(self, actions: Mapping[str, Action]) -> list[list[float]]:
        columns = {name: self.worlds.action_columns[name] for name in self.possible_agents}
        plain = {
            name: _acceleration(action, len(columns.get(name, ())))
            for name, action in actions.items()
        }
        return take_actions(plain, columns)

    def _carry(self, world: World, name: str, command: UavCommand | UgvCommand) -> None:
        """Apply the other parts of a command: backup trajectories, a claim and a route."""
        vehicle = world.names.index(name)
        vertical = getattr(command, "vertical_acceleration", 0.0)
        plans = command.backup_trajectories
        world.send(vehicle, world.tick, command.acceleration, plans, vertical)
        if isinstance(command, UgvCommand):
            world.record_claim(vehicle, command.report)
            if command.route is not None and self._view is not None:
                self._view.show_route(name, command.route)

    def _infos(self) -> dict[str, dict[str, Any]]:
        """Return each vehicle's own facts that are not in its row: always the same keys, and numbers only."""
        return {name: self.worlds.info(name) for name in self.possible_agents}

    def _observations(self) -> dict[str, AgentObservation]:
        """Return a new array for each vehicle, which is never changed later."""
        return {name: one_of_world(self.worlds.observe(name), 0) for name in self.possible_agents}

    def known_tiles(self, ugv: str) -> TileArray:
        """Return a copy of a UGV's occupancy grid, from its sensor and by radio. Shape (rows, columns)."""
        if not self.scenario.has_ground:
            return self.world.tiles
        known: TileArray = self.worlds.loop.known_tiles(ugv)[0].copy()
        return known

    @property
    def world(self) -> World:
        """True world of this episode.

        Raises:
            ResetNeeded: Before the first reset.
        """
        if self._world is None:
            raise ResetNeeded("there is no world yet: call reset() first")
        return self._world

    def state(self) -> Array:
        """Return the complete true state as a flat array, for centralized critics.

        The entries are time, coverage, then each vehicle in name order; `state_names` names them. In wind, a UAV's
        position and velocity are its reference state; its distance and coverage error refer to its true position.
        """
        _ = self.world  # raises before the first reset
        state: Array = self.worlds.state()[0]
        return state

    def metrics(self) -> dict[str, dict[str, Any]]:
        """Return each vehicle's true metrics and the terms of its last reward: for people and logs, not for policies.

        A UAV inside the safety filter also has `uncertified`, the reason of `NotCertified`; empty: certified.

        Raises:
            ResetNeeded: Before the first reset.
        """
        _ = self.world  # raises before the first reset
        return self.worlds.first_metrics()

    def links(self) -> dict[str, LinkStatus]:
        """Return the counters of each link so far, by `vehicle/kind`: for people and logs, not for policies.

        Raises:
            ResetNeeded: Before the first reset.
        """
        _ = self.world  # raises before the first reset
        return self.worlds.links(0)

    def briefing(self, agent: str) -> Briefing:
        """Return the vehicle's briefing of this episode, as on the bus: its limits, area, law, own goals.

        Raises:
            ValueError: If the agent is unknown.
        """
        if agent not in self.action_spaces:
            raise ValueError(f"agent = {agent!r}; allowed: {', '.join(self.possible_agents)}")
        drivers = self.worlds.loop.drivers
        scenario = self.worlds.loop.scenario_of(0)
        return briefing(scenario, agent, self.episode_seed, self.secret, drivers)

    def _follow(self) -> None:
        if self._view is not None:
            self._view.follow(self.world)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return a picture of the current tick, shape (rows, columns, 3); in mode "human", show it in a window instead.

        Raises:
            ResetNeeded: Before the first reset.
            OutriderError: If there is no display, or pygame is not installed.
        """
        if self._view is None:
            logger.warn(
                "render() draws nothing: make the environment with render_mode='human' or 'rgb_array'"
            )
            return None
        return self._view.render(self.world)

    def close(self) -> None:
        """Close the window, if it is open, and stop the threads."""
        self.worlds.loop.close()
        if self._view is not None:
            self._view.close()


parallel_env = OutriderEnv
"""Environment under PettingZoo's usual name."""
