"""Many worlds at once for whoever trains: a Gymnasium vector environment for one vehicle, and one for all of them.

`docs/reference/environment.md` says what a vehicle observes and is paid: it is the same here, bit for bit, as in
`outrider.parallel_env`. An episode that ends begins anew in the same step (Gymnasium's SAME_STEP): the observation is
the new episode's first one, and the last one of the old episode is in `infos["final_obs"]`.
"""

import operator
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Unpack, cast

import numpy as np
import numpy.typing as npt
from gymnasium import logger, spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from bus.messages import LinkStatus, Mission
from bus.observations import GRADIENT, UAV, as_rows
from outrider.envs.closed_loop import LOOP_DEFAULTS, ClosedLoop, LoopSettings, pilot_names
from outrider.envs.closed_loop_state import GUARD_METRICS
from sim.engine.mission import mission_numbers
from sim.env.actions import take_batch
from sim.env.observation import AgentObservation, ObservationFormat, one_of_world
from sim.env.rows import UGV_METRICS
from sim.env.seeds import Seeds
from sim.env.settings import ENV_DEFAULTS, EnvSettings, completed
from sim.env.spaces import action_space
from sim.env.view import BatchRendering
from sim.kernels.compile import FloatArray, IntArray
from sim.scenario.loading import given_scenario
from sim.scenario.types import Scenario

BatchPolicy = Callable[[AgentObservation], npt.ArrayLike]
"""The observations of one vehicle in all worlds in, its accelerations [m/s²] out, shape (num_envs, 2)."""

BatchStep = tuple[
    dict[str, AgentObservation],
    dict[str, FloatArray],
    dict[str, npt.NDArray[np.bool_]],
    dict[str, npt.NDArray[np.bool_]],
    dict[str, dict[str, Any]],
]
"""Observations, rewards, terminations, truncations and infos of all worlds, by learner."""


def _checked_count(num_envs: int) -> int:
    try:
        count = operator.index(num_envs)
    except TypeError:
        count = 0
    if count < 1:
        raise ValueError(f"num_envs = {num_envs!r}: must be a whole number, 1 or more")
    return count


class BatchSettings(EnvSettings, LoopSettings, total=False):
    """Settings of the environments of many worlds; by default `BATCH_DEFAULTS`."""

    others: Mapping[str, str | BatchPolicy] | None
    """Pilots of the vehicles that do not learn: a law or driver by name, or a policy for all worlds at once;
    None: the scenario's law and drivers."""


PICTURES: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}
"""Metadata of an environment that draws."""
BATCH_DEFAULTS = BatchSettings(**{**ENV_DEFAULTS, **LOOP_DEFAULTS, "others": None})


class Worlds:
    """The common part of both vector environments.

    The closed loop, its seeds, spaces, and the change from one episode to the next.

    Args:
        scenario: A shipped name, a file, or a scenario.
        num_envs: How many worlds.
        learners: Vehicles whose actions come from outside.
        others: Who flies or drives the other vehicles: a law or driver by name, or a policy for all worlds at
            once. By default the scenario's law and drivers.
        render_mode: None, or "rgb_array": `render` draws.
        settings: Options by keyword: `BatchSettings` says what each is.

    Raises:
        ScenarioError: If the scenario cannot be flown.
        ValueError: If another argument is not allowed.
        TypeError: If there is no setting of that name.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int,
        learners: Sequence[str] | None,
        *,
        render_mode: str | None = None,
        **settings: Unpack[BatchSettings],
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(
                f"render_mode = {render_mode!r}; allowed: None, 'rgb_array'; outrider.parallel_env has a window"
            )
        options = completed(BatchSettings, settings, BATCH_DEFAULTS)
        self.settings = options
        """All of them, as they are in force."""
        self.num_envs = _checked_count(num_envs)
        self.scenario = given_scenario(scenario, options["duration"])
        names = [vehicle.name for vehicle in self.scenario.vehicles]
        self.learners = list(names if learners is None else learners)
        for name in self.learners:
            if name not in names:
                raise ValueError(f"agent = {name!r}; allowed: {', '.join(names)}")
        self._format = ObservationFormat(
            self.scenario, options, estimate=options["estimate"], gradient=options["gradient"]
        )
        given = dict(options["others"] or {})
        self._policies = {
            name: pilot for name, pilot in given.items() if not isinstance(pilot, str)
        }
        named = {name: pilot for name, pilot in given.items() if isinstance(pilot, str)}
        self._check_others(given, named, names)
        self._hands = [*self.learners, *self._policies]
        of_loop = {key: value for key, value in options.items() if key in LOOP_DEFAULTS}
        self.loop = ClosedLoop(
            self.scenario,
            self.num_envs,
            external=self._hands,
            pilots=named,
            **cast(LoopSettings, of_loop),
        )
        """The worlds themselves."""
        self._gradient = options["gradient"]
        self._shielded = options["safety_filter"]
        self._rows = {vehicle.name: k for k, vehicle in enumerate(self.scenario.vehicles)}
        self.action_spaces = {v.name: action_space(v) for v in self.scenario.vehicles}
        self.observation_spaces = self._format.spaces
        self._seeds = [Seeds(self.scenario.seed + k) for k in range(self.num_envs)]
        self._actions: FloatArray = np.zeros((self.num_envs, len(self._hands), 2))
        self._returns: FloatArray = np.zeros((self.num_envs, len(names)))
        self._last: dict[str, dict[str, FloatArray]] = {}
        self.begun = False
        """True if there is an episode to step."""
        self.render_mode = render_mode
        self._view = None if render_mode is None else BatchRendering(self.loop.batch)

    def _check_others(
        self, given: Mapping[str, object], named: Mapping[str, str], names: list[str]
    ) -> None:
        for name, pilot in given.items():
            if name not in names:
                raise ValueError(f"others: {name!r}: no such vehicle; allowed: {', '.join(names)}")
            if name in self.learners:
                raise ValueError(f"others: {name!r}: its actions come from outside already")
            if name in named and named[name] not in pilot_names(self.scenario, name):
                allowed = ", ".join(pilot_names(self.scenario, name))
                raise ValueError(
                    f"others: {name!r}: {pilot!r} is unknown; allowed: {allowed}, or a policy for all worlds at once"
                )
            if name not in named and not callable(pilot):
                raise ValueError(f"others: {name!r}: {pilot!r} is neither a name nor a policy")
            if hasattr(pilot, "check"):  # as outrider.learning's: it knows what it was made for
                pilot.check(self.scenario)

    def observe(self, name: str) -> AgentObservation:
        """The observations of a vehicle in all worlds: new arrays, which nobody changes later."""
        state, form = self.loop.state, self._format
        if name in self.loop.ugvs:
            g = self.loop.ugvs.index(name)
            known = state.grounds.tiles[:, g] if form.tile_patch else None
            return form.shown(name, as_rows(state.rows.ugv_rows)[:, g], known=known)
        u = self.loop.uavs.index(name)
        width = len(UAV) + (len(GRADIENT) if self._gradient else 0)
        coverage = None if form.patch is None else state.patches[:, u]
        row = as_rows(state.rows.uav_rows)[:, u, :width]
        return form.shown(name, row, coverage=coverage)

    def mission(self, world: int) -> Mission | None:
        """The mission of one world so far; None where there are no hazards."""
        return self.loop.mission(world) if self.scenario.has_ground else None

    def infos(self, name: str) -> dict[str, Any]:
        """Facts of a vehicle's own that are in no row, in all worlds, with Gymnasium's masks."""
        found: dict[str, Any] = {}
        if name in self.loop.ugvs:
            found["goals_reached"] = self.loop.state.rows.ugvs[
                :, self.loop.ugvs.index(name), UGV_METRICS.reached
            ].astype(np.int64)
        elif self._shielded and name in self._hands:
            rows = self.loop.state.rows.uavs[:, self.loop.uavs.index(name)]
            found["intervened"] = rows[:, GUARD_METRICS.acted] != 0.0
            found["certified"] = rows[:, GUARD_METRICS.sure] != 0.0
            found["certified_distance"] = rows[:, GUARD_METRICS.bound].copy()
        return found | {f"_{key}": np.ones(self.num_envs, dtype=np.bool_) for key in found}

    def reset(
        self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None
    ) -> None:
        """Begin episodes: in all worlds, or in those of the boolean array `options["reset_mask"]`.

        Raises:
            ValueError: If there are not as many seeds as worlds, or a seed or the mask is not allowed.
        """
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if options is not None and options.get("reset_mask") is not None:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
                raise ValueError(
                    f"options['reset_mask']: must be {self.num_envs} booleans, at least one of them true"
                )
            if not self.begun and not mask.all():
                raise ResetNeeded("reset() all worlds before a part of them")
        seeds = self._given(seed)
        which = np.flatnonzero(mask)
        for k in which.tolist():
            Seeds.check(seeds[k])
        self._keep_metrics(which)
        for k in which.tolist():
            self._seeds[k].begin(seeds[k])
        self.loop.begin([self._seeds[k].current for k in which.tolist()], which)
        self._returns[which] = 0.0
        self.begun = True
        if self._view is not None:
            self._view.begin(which)

    def _given(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, Sequence | np.ndarray):
            if len(seed) != self.num_envs:
                raise ValueError(f"{len(seed)} seeds for num_envs = {self.num_envs}")
            return list(seed)
        try:
            first = operator.index(seed)
        except TypeError:
            raise ValueError(
                f"seed = {seed!r}: must be a whole number, or one for each world"
            ) from None
        return [first + k for k in range(self.num_envs)]

    @property
    def episode_seeds(self) -> list[int]:
        """The seed of each world's episode: `outrider run --seed` with it flies the same one."""
        return [seeds.current for seeds in self._seeds]

    def step(
        self, actions: Mapping[str, npt.ArrayLike], which: IntArray | None = None
    ) -> npt.NDArray[np.bool_]:
        """Worlds advance by one tick; nothing has begun anew yet.

        Args:
            actions: Those of each learner, shape (num_envs, 2) [m/s²].
            which: The worlds that do; all by default. The others stay as they are.

        Returns:
            Which episodes have ended.

        Raises:
            ResetNeeded: Before the first reset.
            ValueError: If an action is missing, of nobody, or not two finite numbers for each world; nothing has
                happened then.
        """
        if not self.begun:
            raise ResetNeeded("step() before reset()")
        if set(actions) != set(self.learners):
            given = ", ".join(map(str, actions)) or "nobody"
            raise ValueError(
                f"actions for: {given}; needed is one for each of: {', '.join(self.learners)}"
            )
        taken = [take_batch(name, actions[name], self.num_envs) for name in self.learners]
        taken += [
            take_batch(name, policy(self.observe(name)), self.num_envs)
            for name, policy in self._policies.items()
        ]
        for place, action in enumerate(taken):
            self._actions[:, place] = action
        self.loop.step(self._actions, which)
        if self._view is not None:
            self._view.follow()
        state, stepped = self.loop.state, slice(None) if which is None else which
        self._returns[stepped] += state.rows.rewards[stepped]
        ended: npt.NDArray[np.bool_] = (state.rows.terminated | state.rows.truncated) != 0
        return ended

    def step_with_autoreset(self, actions: Mapping[str, npt.ArrayLike]) -> BatchStep:
        """All worlds advance by one tick; an episode that ends begins anew, with the seed that follows from its last.

        Args:
            actions: As for `step`, whose errors it raises.
        """
        ended = self.step(actions)
        rewards = {name: self.rewards(name) for name in self.learners}
        terminated, truncated = self.ends()
        final: dict[str, dict[str, Any]] = {name: {} for name in self.learners}
        if ended.any():
            final = {name: self.final(name, ended) for name in self.learners}
            self.reset(None, {"reset_mask": ended})
        return (
            {name: self.observe(name) for name in self.learners},
            rewards,
            {name: terminated.copy() for name in self.learners},
            {name: truncated.copy() for name in self.learners},
            {name: self.infos(name) | final[name] for name in self.learners},
        )

    def rewards(self, name: str) -> FloatArray:
        """Of the last tick. Shape (num_envs,)."""
        return self.loop.state.rows.rewards[:, self._rows[name]].copy()

    def ends(self) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """The episodes that have terminated, and those that were truncated."""
        state = self.loop.state
        return state.rows.terminated != 0, state.rows.truncated != 0

    def final(self, name: str, ended: npt.NDArray[np.bool_]) -> dict[str, Any]:
        """The last observations and infos of the ended episodes, as Gymnasium's own vector environments give them."""
        last, told = self.observe(name), self.infos(name)
        observations = np.full(self.num_envs, None, dtype=object)
        for k in np.flatnonzero(ended).tolist():
            observations[k] = one_of_world(last, k)
        info = {key: value for key, value in told.items() if not key.startswith("_")}
        if name in self.loop.ugvs and self.scenario.has_ground:
            for k in np.flatnonzero(ended).tolist():
                for key, number in mission_numbers(self.loop.mission(k)).items():
                    none = np.zeros(self.num_envs, np.asarray(number).dtype)
                    info.setdefault(key, none)[k] = number
        info["episode"] = {
            "r": np.where(ended, self._returns[:, self._rows[name]], 0.0),
            "l": np.where(ended, self.loop.state.batch.ticks, 0),
            "_r": ended.copy(),
            "_l": ended.copy(),
        }
        final_info = info | {f"_{key}": ended.copy() for key in info}
        return {
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": final_info,
            "_final_info": ended.copy(),
        }

    def _keep_metrics(self, which: npt.NDArray[np.int64]) -> None:
        """Keep how the UAVs stood in the end where an episode of these worlds has ended."""
        state = self.loop.state.rows
        over = which[(state.terminated[which] | state.truncated[which]) != 0]
        for uav in self.loop.uavs if self.begun and len(over) else ():
            for key, values in self.loop.metrics(uav).items():
                kept = self._last.setdefault(uav, {}).setdefault(
                    key, np.full(self.num_envs, np.nan)
                )
                kept[over] = values[over]

    def metrics(self, *, last: bool = False) -> dict[str, dict[str, FloatArray]]:
        """Each UAV's true standing in its episode, in all worlds: for people and logs, not for policies.

        Args:
            last: In the end of each world's last episode that is over, instead; NaN where none is.

        Raises:
            ResetNeeded: Before the first reset.
        """
        if not self.begun:
            raise ResetNeeded("metrics() before reset()")
        now = {uav: self.loop.metrics(uav) for uav in self.loop.uavs}
        if not last:
            return now
        none = np.full(self.num_envs, np.nan)
        return {
            uav: {key: self._last.get(uav, {}).get(key, none).copy() for key in told}
            for uav, told in now.items()
        }

    def links(self, world: int) -> dict[str, LinkStatus]:
        """The counters of each link of one world so far, by `vehicle/kind`."""
        return self.loop.links(world)

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """The picture of each world at this moment, shape (rows, columns, 3); None without a mode.

        Raises:
            ResetNeeded: Before the first reset.
        """
        if self._view is None:
            logger.warn("render() draws nothing: made without render_mode='rgb_array'")
            return None
        if not self.begun:
            raise ResetNeeded("render() before reset()")
        return self._view.render()


class OutriderVectorEnv(VectorEnv):
    """One vehicle learns in many worlds at once; the others fly and drive in the compiled loop.

    World k, once reset with a seed, is bit for bit `outrider.parallel_env` with that seed, the same actions, and
    the others' pilots.

    Args:
        scenario: A shipped name, a file, or a scenario.
        num_envs: How many worlds.
        agent: Who learns.
        render_mode: None, or "rgb_array".
        settings: Options by keyword: `BatchSettings` says what each is.

    Raises:
        ScenarioError: If the scenario cannot be flown.
        ValueError: If another argument is not allowed.
        TypeError: If there is no setting of that name.
    """

    metadata: dict[str, Any] = PICTURES | {"autoreset_mode": AutoresetMode.SAME_STEP}
    autoreset_mode = AutoresetMode.SAME_STEP
    """The same again: TorchRL reads it here."""

    def __init__(
        self,
        scenario: str | Path | Scenario = "escort",
        *,
        num_envs: int,
        agent: str = "uav_0",
        render_mode: str | None = None,
        **settings: Unpack[BatchSettings],
    ) -> None:
        self.worlds = Worlds(scenario, num_envs, [agent], render_mode=render_mode, **settings)
        """The worlds, and what is true of them."""
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
            seed: World k gets seed + k; or one seed for each. Without any, the first episodes have the scenario's
                seed and those after it, and each later one a seed derived from the last that was given to its world.
            options: `reset_mask`, booleans: which worlds.

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
        """Let the vehicle act for one tick in every world.

        Args:
            actions: Accelerations [m/s²], finite. Shape (num_envs, 2).

        Raises:
            ResetNeeded: Before the first reset.
            ValueError: If the actions are not two finite numbers for each world; nothing has happened then.
        """
        stepped, one = self.worlds.step_with_autoreset({self.agent: actions}), self.agent
        observations, rewards, terminations, truncations, infos = stepped
        return observations[one], rewards[one], terminations[one], truncations[one], infos[one]

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """A picture of each world, as `Worlds.render` draws it; after an end that of the new episode's start."""
        return self.worlds.render()

    def metrics(self, *, last: bool = False) -> dict[str, dict[str, FloatArray]]:
        """Each UAV's true standing, as `Worlds.metrics` tells it: for people and logs, not for policies."""
        return self.worlds.metrics(last=last)

    def close_extras(self, **_: Any) -> None:  # noqa: ANN401 - Gymnasium's
        """End the threads."""
        self.worlds.loop.close()


class OutriderParallelVectorEnv:
    """All vehicles learn, in many worlds at once.

    PettingZoo's parallel interface with arrays that have an axis for worlds.

    Args:
        scenario: A shipped name, a file, or a scenario.
        num_envs: How many worlds.
        agents: Who learns; by default everybody.
        render_mode: None, or "rgb_array".
        settings: Options by keyword: `BatchSettings` says what each is.

    Raises:
        ScenarioError: If the scenario cannot be flown.
        ValueError: If another argument is not allowed.
        TypeError: If there is no setting of that name.
    """

    metadata: ClassVar[dict[str, Any]] = PICTURES | {
        "name": "outrider_v0",
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }
    autoreset_mode = AutoresetMode.SAME_STEP

    def __init__(
        self,
        scenario: str | Path | Scenario = "escort",
        *,
        num_envs: int,
        agents: Sequence[str] | None = None,
        render_mode: str | None = None,
        **settings: Unpack[BatchSettings],
    ) -> None:
        self.worlds = Worlds(scenario, num_envs, agents, render_mode=render_mode, **settings)
        """The worlds, and what is true of them."""
        self.num_envs = self.worlds.num_envs
        self.render_mode = render_mode
        self.possible_agents = self.worlds.learners
        self.agents = list(self.possible_agents)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's observation in one world."""
        return self.worlds.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's action in one world."""
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
        """Let all vehicles act for one tick in every world.

        Args:
            actions: An array of accelerations [m/s²] for each agent, shape (num_envs, 2).

        Returns:
            Observations, rewards, terminations, truncations and infos by agent; all agents of a world end together.

        Raises:
            ResetNeeded: Before the first reset.
            ValueError: If an agent's actions are missing or not two finite numbers for each world; nothing has
                happened then.
        """
        return self.worlds.step_with_autoreset(actions)

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """A picture of each world, as `Worlds.render` draws it; after an end that of the new episode's start."""
        return self.worlds.render()

    def metrics(self, *, last: bool = False) -> dict[str, dict[str, FloatArray]]:
        """Each UAV's true standing, as `Worlds.metrics` tells it: for people and logs, not for policies."""
        return self.worlds.metrics(last=last)

    def close(self) -> None:
        """End the threads."""
        self.worlds.loop.close()


vector_env = OutriderVectorEnv
"""The environment of one learner under its usual name."""
parallel_vector_env = OutriderParallelVectorEnv
"""The environment of many learners under its usual name."""
