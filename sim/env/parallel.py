"""The world as a PettingZoo environment: a thin shell over `sim.world.World`.

`bus.observations` says what each entry of an observation means, `sim.env.rewards` what is paid, `sim.env.rows` who
gets what.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt
from gymnasium import logger, spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv  # type: ignore[import-untyped]

from bus.messages import Briefing, Detection, LinkStatus, MotionPlan, SeenTile, UgvReport, Vector
from bus.observations import STATE, bounds, state_names, with_tables
from sim.engine.briefing import briefing
from sim.engine.mission import mission_numbers
from sim.engine.run_keys import check_secret
from sim.env.actions import take_actions
from sim.env.episode import Episode
from sim.env.observation import AgentObservation, Array, ObservationFormat
from sim.env.patch import OwnMaps
from sim.env.rewards import RewardWeights
from sim.env.seeds import Seeds
from sim.env.settings import ENV_DEFAULTS, EnvSettings, completed
from sim.env.spaces import action_space, box, extent_of
from sim.env.view import Rendering
from sim.models.field import coverage_shares, empty_coverage
from sim.models.ground import TileArray
from sim.scenario.loading import given_scenario
from sim.scenario.types import Scenario
from sim.world import World


@with_tables
class OutriderEnv(ParallelEnv):  # type: ignore[misc]
    """A UAV escorts a UGV, sees as much ground around it as it can, and never loses sight of it.

    Agents are the scenario's vehicles. An action is an acceleration [m/s²], held for one tick; the bound of (1) is on
    its norm, and a longer one is shortened. An observation is the vehicle's own row and nothing else; the whole truth
    is in `state()`. A UAV observes

    <!-- generated: uav_observation -->

    and a UGV

    <!-- generated: ugv_observation -->

    On ground with hazards a UGV's observation is a dictionary: `row`, and `tiles`, a picture of the ground as it knows
    it.

    The letters of the ranges are explained in `bus.observations.SYMBOLS`; all agents end together.
    `docs/reference/environment.md` is the environment's page.

    Args:
        scenario: A shipped name, a file, or a scenario.
        coverage_in_state: Whether min(C / C*, 1) of every cell, row by row from y = 0, ends the state.
        render_mode: None, "rgb_array" or "human".
        settings: Options by keyword: `sim.env.settings.EnvSettings` says what each is.

    Raises:
        ScenarioError: If the scenario cannot be flown, or its duration is no whole number of ticks.
        ValueError: If another argument is not allowed.
        TypeError: If there is no setting of that name.
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
        coverage_in_state: bool = False,
        render_mode: str | None = None,
        **settings: Unpack[EnvSettings],
    ) -> None:
        options = completed(EnvSettings, settings, ENV_DEFAULTS)
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode = {render_mode!r}; allowed: None, 'human', 'rgb_array'")
        self.scenario = given_scenario(scenario, options["duration"])
        """The scenario that is flown."""
        self.render_mode = render_mode
        self.end_on_sight_lost = options["end_on_sight_lost"]
        self.end_on_goals_reached = options["end_on_goals_reached"]
        self.coverage_in_state = coverage_in_state
        form = ObservationFormat(self.scenario, options, estimate=False, gradient=False)
        self._format = form
        rewards = options["rewards"] or RewardWeights()
        vehicles = self.scenario.vehicles
        self.possible_agents: list[str] = [vehicle.name for vehicle in vehicles]
        self.agents: list[str] = []
        self._gains = rewards.seen > 0.0
        self._episode = Episode(self.scenario, rewards)
        self.action_spaces = {vehicle.name: action_space(vehicle) for vehicle in vehicles}
        self.observation_spaces = form.spaces
        self.state_space = self._state_space()
        self.state_names = state_names(self._episode.state_rows.items())
        """Names of the state's entries, but for the cells."""
        self.degraded = False
        """True if any link does anything to a message."""
        self.episode = 0
        """Number of the episode, from 1 with the first reset."""
        self.secret = check_secret(options["secret"])
        """Of all random numbers, with the seed. For whoever made the environment, not for policies."""
        self._seeds = Seeds(self.scenario.seed)
        self._np_random: np.random.Generator | None = None
        self._carried: dict[str, Sequence[MotionPlan]] = {}
        self._world: World | None = None
        self._view = (
            None if render_mode is None else Rendering(render_mode, self.metadata["render_fps"])
        )

    @property
    def np_random(self) -> np.random.Generator:
        """A generator for wrappers, seeded anew with each episode's seed; nothing in the world is drawn from it."""
        if self._np_random is None:
            self._np_random, _ = seeding.np_random(self.episode_seed)
        return self._np_random

    @property
    def episode_seed(self) -> int:
        """Of this episode's random numbers; before the first reset, the one that it takes by default."""
        return self._seeds.current

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's actions; larger ones are shortened to its bound, not refused."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, AgentObservation], dict[str, dict[str, Any]]]:
        """Begin an episode.

        Args:
            seed: Of all its random numbers. Without one, the first episode has the scenario's seed, and each later one
                a seed derived from the last that was given and the number of episodes since.
            options: Not used.

        Returns:
            Observations and infos by agent.
        """
        self._seeds.begin(seed)
        self._np_random = None
        self.episode += 1
        self._world = World(self.scenario, self.episode_seed, secret=self.secret, gains=self._gains)
        self.degraded = self._world.links.degraded
        self._maps = OwnMaps(self._world, needed=self._format.patch is not None)
        self.agents = list(self.possible_agents)
        self._carried.clear()
        self._perceive()
        self._episode.begin(self._world)
        self._follow()
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, npt.ArrayLike]
    ) -> tuple[
        dict[str, AgentObservation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Let all vehicles act for one tick.

        Args:
            actions: An acceleration [m/s²] for each agent, two finite numbers.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent.

        Raises:
            ResetNeeded: If no episode is going on.
            ValueError: If an action is missing, of no agent, or not two finite numbers; nothing has happened then.
        """
        world, taken = self.world, self.taken(actions)
        for k, name in enumerate(world.names):
            world.send(k, world.tick, taken[name], self._carried.get(name, ()))
        self._carried.clear()
        world.advance()
        self._perceive()
        self._episode.advance(
            world,
            end_on_sight_lost=self.end_on_sight_lost,
            end_on_goals=self.end_on_goals_reached,
        )
        self._maps.look(world)
        terminated, truncated = self._episode.terminated, self._episode.truncated
        names = self.agents
        if terminated or truncated:
            self.agents = []
        self._follow()
        return (
            self._observations(),
            self._episode.rewards(),
            dict.fromkeys(names, terminated),
            dict.fromkeys(names, truncated),
            self._infos(),
        )

    def _perceive(self) -> None:
        """Take in what reaches the vehicles at this tick beside what is in their rows: here nothing."""

    def _infos(self) -> dict[str, dict[str, Any]]:
        """Facts of a vehicle's own that are in no row.

        At the end of an episode, when nothing is decided any more, also what became of the messages on its links, where
        the network is not perfect, and how a UGV's mission went, on ground with hazards.
        """
        infos: dict[str, dict[str, Any]] = {
            name: {**self._episode.info(name)} for name in self.possible_agents
        }
        if self.agents:
            return infos
        links, mission = self.links() if self.degraded else {}, self.world.mission
        for name, info in infos.items():
            if self.degraded:
                info["links"] = {
                    key: one for key, one in links.items() if key.rpartition("/")[0] == name
                }
            if mission is not None and self._episode.uav(name) is None:
                info.update(mission_numbers(mission))
        return infos

    def _observations(self) -> dict[str, AgentObservation]:
        """A new array for each vehicle, which nobody changes later."""
        return {name: self._observe(name) for name in self.possible_agents}

    def _observe(self, name: str) -> AgentObservation:
        uav, form, coverage, known = self._episode.uav(name), self._format, None, None
        if uav is None and form.tile_patch:
            known = self.known_tiles(name)
        if uav is not None and form.patch is not None:
            coverage = self._maps.patch(uav, self.world, form.patch)
        return form.shown(name, self._episode.row(name), coverage=coverage, known=known)

    def known_tiles(self, ugv: str) -> TileArray:
        """The ground as a UGV knows it; a copy. Shape (rows, columns).

        In here from its bumper alone: `outrider.parallel_env` has the radio of the UAVs' computers, too.
        """
        ground = self.world.ground
        if ground is None:
            return self.world.tiles
        known: TileArray = ground.known[0, self.world.names.index(ugv)]
        return known.copy()

    @property
    def world(self) -> World:
        """The true world of this episode.

        Raises:
            ResetNeeded: Before the first reset.
        """
        if self._world is None:
            raise ResetNeeded("there is no world yet: call reset() first")
        return self._world

    def state(self) -> Array:
        """The whole truth as a flat array, for centralized critics: time, coverage, then each vehicle in name order.

        `state_names` names the entries; with `coverage_in_state` the cells of the grid follow. In wind a UAV's position
        and velocity are those that it is told, its distance and coverage error of where it truly is.
        """
        world, episode, dtype = self.world, self._episode, self._format.dtype
        desired = world.parameters.desired
        covered, seen = coverage_shares(world.coverage, desired)
        values = [world.time, covered, seen]
        for name in episode.names:
            values += episode.state(name)
        if self.coverage_in_state:
            shares = np.minimum(world.coverage / desired, 1.0)
            values += shares.ravel().tolist()
        space = self.state_space
        return np.clip(np.array(values, dtype=dtype), space.low, space.high)

    def _state_space(self) -> spaces.Box:
        """The space of `state`."""
        area, vehicles = self.scenario.area, self.scenario.vehicles
        low, high = bounds(STATE, extent_of(self.scenario, vehicles[0]))
        for vehicle in vehicles:
            row = self._episode.state_rows[vehicle.name]
            least, largest = bounds(row, extent_of(self.scenario, vehicle))
            low, high = low + least, high + largest
        if self.coverage_in_state:
            cells = empty_coverage(area.width, area.height, area.cell).size
            low, high = low + [0.0] * cells, high + [1.0] * cells
        return box(low, high, self._format.dtype)

    def metrics(self) -> dict[str, dict[str, float]]:
        """Each vehicle's true standing, and the terms of its last reward: for people and logs, not for policies."""
        _ = self.world  # there must be one
        return {name: self._episode.metrics(name) for name in self.possible_agents}

    def links(self) -> dict[str, LinkStatus]:
        """The counters of each link so far, by `vehicle/kind`: for people and logs, not for policies."""
        return self.world.links.status()

    def own_row(self, agent: str) -> Array:
        """A vehicle's own row in double precision, whatever its observations are made of."""
        return self._episode.row(agent).astype(np.float64)

    def received(self, agent: str) -> tuple[Detection, ...]:
        """All the detections that have reached a UAV at this tick, as it would be told on the bus.

        Its row has the newest.

        Raises:
            ValueError: If there is no such UAV.
        """
        uav = self._episode.uav(agent)
        if uav is None:
            raise ValueError(
                f"agent = {agent!r}; allowed: {', '.join(uav.name for uav in self.scenario.uav)}"
            )
        return self.world.received(uav)

    def ground(self, agent: str) -> tuple[SeenTile, ...]:
        """The tiles of which a vehicle's own sensor has told since the tick before, as it would be told on the bus.

        Raises:
            ValueError: If there is no such vehicle.
        """
        if agent not in self.world.names:
            raise ValueError(f"agent = {agent!r}; allowed: {', '.join(self.world.names)}")
        return self.world.seen_ground(self.world.names.index(agent))

    def flown(self, agent: str) -> int | None:
        """Return the motion that a vehicle's receiver flew in the tick before, as on the bus; None: none.

        Raises:
            ValueError: If there is no such vehicle.
        """
        self.ground(agent)
        return self.world.flown(self.world.names.index(agent))

    def taken(self, actions: Mapping[str, npt.ArrayLike]) -> dict[str, Vector]:
        """Returns each agent's action as `step` would take it [m/s²]; nothing happens.

        Args:
            actions: As for `step`, whose errors it raises.
        """
        _ = self.world  # there must be one
        if not self.agents:
            raise ResetNeeded("step() after the end of the episode: call reset() first")
        return take_actions(actions, self.possible_agents)

    def carry(self, agent: str, motions: Sequence[MotionPlan]) -> None:
        """Let a vehicle's next action carry motions, as its pilot plans them.

        Its receiver flies them where the vehicle has one for them; else the action acts.

        Raises:
            ValueError: If there is no such vehicle.
        """
        self.ground(agent)
        self._carried[agent] = motions

    def claim(self, agent: str, report: UgvReport | None) -> None:
        """Count what a UGV's pilot claims of its next action: that it stays on tiles that it knows; None: nothing."""
        self.world.note_claim(self.world.names.index(agent), report)

    def show_route(self, agent: str, route: tuple[Vector, ...]) -> None:
        """Show in pictures the way that a UGV plans, by its corners [m], until it plans another."""
        if self._view is not None:
            self._view.show_route(agent, route)

    def briefing(self, agent: str) -> Briefing:
        """Returns the vehicle's briefing of this episode, as on the bus: its limits, area, law, own goals.

        Raises:
            ValueError: If there is no such agent.
        """
        if agent not in self.action_spaces:
            raise ValueError(f"agent = {agent!r}; allowed: {', '.join(self.possible_agents)}")
        return briefing(self.scenario, agent, self.episode_seed, self.secret)

    def _follow(self) -> None:
        if self._view is not None:
            self._view.follow(self.world)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """A picture of this moment, shape (rows, columns, 3); with the mode "human" it is shown in a window instead.

        Raises:
            ResetNeeded: Before the first reset.
            OutriderError: If there is no display, or no pygame.
        """
        if self._view is None:
            logger.warn(
                "render() draws nothing: the environment was made without render_mode='human' or 'rgb_array'"
            )
            return None
        return self._view.render(self.world)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._view is not None:
            self._view.close()


parallel_env = OutriderEnv
"""The environment under PettingZoo's usual name."""
