"""Common part of all environments: the closed loop, its seeds, spaces, and resets.

`docs/reference/environment.md` describes observations and rewards.
"""

import operator
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import logger
from gymnasium.error import ResetNeeded

from agents.safety.decision import CERTIFIED, NOMINAL
from bus.messages.links import LinkStatus
from bus.messages.telemetry import MissionResult
from bus.observations import as_rows
from outrider.closed_loop.closed_loop import ClosedLoop
from outrider.envs.policies import check_others, named_policies, observed_by
from outrider.envs.true_state import TrueState
from outrider.running.metrics import MISSION, numbers
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray
from sim.env.actions import ACTION_COLUMNS, check_by_agent, take_batch
from sim.env.observation import AgentObservation, Array, ObservationFormat
from sim.env.reward_function import rewards_by
from sim.env.seeds import Seeds, check_options
from sim.env.settings import settings_of
from sim.env.spaces import action_columns, action_space
from sim.env.standings import true_metrics
from sim.env.view import BatchRendering
from sim.scenario.loading import given_scenario
from sim.scenario.types import Scenario
from sim.world import World

BoolArray = npt.NDArray[np.bool_]

PICTURES: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}
"""Metadata of an environment that can render."""


def _checked_count(num_envs: int) -> int:
    try:
        count = operator.index(num_envs)
    except TypeError:
        count = 0
    if count < 1:
        raise ValueError(
            f"num_envs = {num_envs!r}: not a count; allowed: a whole number, 1 or more"
        )
    return count


class Worlds:
    """Many worlds of one scenario, the base of every environment.

    Args:
        scenario: Shipped name, file, or scenario.
        num_envs: Number of worlds.
        learners: Vehicles with external actions; None: all.
        error: True to compute e(t) at every tick; it is always computed if `uncovered` is rewarded.
        render_mode: None, or "rgb_array" to enable `render`.
        settings: Keywords, see `sim.env.settings.Settings`.

    Raises:
        ScenarioError: If the scenario cannot be flown.
        ValueError: If another argument is not allowed.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int,
        learners: Sequence[str] | None,
        /,  # so that `num_envs` of an environment with one world is an unknown setting
        *,
        error: bool = False,
        render_mode: str | None = None,
        **settings: Any,  # noqa: ANN401 - fields of `Settings`
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(
                f"render_mode = {render_mode!r}; allowed: None, 'rgb_array'; outrider.parallel_env has a window"
            )
        options = settings_of(settings)
        self.state_dtype = np.float64 if isinstance(options.dtype, Mapping) else options.dtype
        """Type of `state()`."""
        self.num_envs = _checked_count(num_envs)
        self.scenario = given_scenario(scenario, options.duration)
        names = [vehicle.name for vehicle in self.scenario.vehicles]
        self.learners = list(names if learners is None else learners)
        for name in self.learners:
            if name not in names:
                raise ValueError(f"agent = {name!r}; allowed: {', '.join(names)}")
        given = named_policies(options.others or {}, self.scenario)
        self._policies = {
            name: pilot for name, pilot in given.items() if not isinstance(pilot, str)
        }
        named = {name: pilot for name, pilot in given.items() if isinstance(pilot, str)}
        check_others(given, self.scenario, self.learners)
        settings |= observed_by(self._policies, options, names)
        self.settings = options = settings_of(settings)
        self._external = [*self.learners, *self._policies]
        self.loop = ClosedLoop(
            self.scenario,
            self.num_envs,
            external=self._external,
            pilots=named,
            error=error,
            **settings,
        )
        """Closed loop of the worlds."""
        self.scenario = self.loop.scenario
        """Scenario of all worlds, as in `ClosedLoop`."""
        self._format = ObservationFormat(self.scenario, options)
        asks = options.roles == "action"
        self.action_spaces = {
            v.name: action_space(self.scenario, v, asks=asks) for v in self.scenario.vehicles
        }
        self.action_columns = {
            v.name: action_columns(self.scenario, v, asks=asks) for v in self.scenario.vehicles
        }
        """Columns of an action's entries in an array of actions, by vehicle."""
        self.observation_spaces = self._format.spaces
        self.true_state = TrueState(self.scenario, self.loop, self.state_dtype)
        """State of all worlds, with its space and the names of its entries."""
        self._seeds = [Seeds() for _ in range(self.num_envs)]
        self._actions: FloatArray = np.zeros((self.num_envs, len(self._external), ACTION_COLUMNS))
        self._paid: FloatArray = np.zeros((self.num_envs, len(names)))
        self.has_episode = False
        """True after the first reset."""
        self._view = None if render_mode is None else BatchRendering(self.loop.batch)

    def state(self) -> Array:
        """Return the complete true states of all worlds, for centralized critics. Shape (num_envs, entries).

        The entries are time, coverage, then each vehicle in name order; `true_state.names` names them. In wind, a
        UAV's position and velocity are its reference state; its distance and coverage error refer to its true position.

        Raises:
            ResetNeeded: Before the first reset.
        """
        if not self.has_episode:
            raise ResetNeeded("state() before reset()")
        return self.true_state()

    def world(self, number: int) -> World:
        """Return the true state of one world, a live view."""
        seed, scenario = self._seeds[number].current, self.loop.scenario_of(number)
        return World.of_batch(self.loop.batch, number, seed, scenario)

    def observe(self, name: str) -> AgentObservation:
        """Return the observations of a vehicle in all worlds: new arrays, never changed later."""
        loop, form = self.loop, self._format
        if name in loop.ugvs:
            known = loop.known_tiles(name) if form.tile_patch else None
            rows, entries = as_rows(loop.state.rows.ugv_rows), form.ugv_entries[name]
            row = rows[:, loop.ugvs.index(name), :entries]
            return form.shown(name, row, known=known)
        coverage = loop.patch(name) if name in form.pictured else None
        row = as_rows(loop.state.rows.uav_rows)[:, loop.uavs.index(name), form.columns[name]]
        if name in form.estimated:
            row = loop.with_estimate(name, row)
        if count := form.team_entries[name]:
            row = np.concatenate((row, loop.team_rows(name)[:, :count]), axis=1)
        return form.shown(name, row, coverage=coverage)

    def standings(self, name: str) -> RecordArray:
        """Return the `sim.env.rows.Standing` of a vehicle in all worlds; a view."""
        return self.loop.state.rows.standings[:, self.loop.names.index(name)]

    def mission(self, world: int) -> MissionResult | None:
        """Return the mission result of one world so far; None without hazards."""
        return self.loop.mission(world) if self.scenario.has_ground else None

    def is_filtered(self, name: str) -> bool:
        """Return whether a vehicle has external actions that pass the safety filter, in a team in some of its roles."""
        filtered = self.settings.safety_filter or self.scenario.team is not None
        return filtered and name in self._external and name in self.loop.uavs

    def _facts(self, name: str) -> dict[str, npt.NDArray[Any]]:
        """Return a vehicle's own facts that are not in its row, in all worlds.

        The keys never change. Mission results are NaN before the end of the episode.
        """
        found: dict[str, npt.NDArray[Any]] = dict(self.loop.drawn(name))
        if name in self.loop.ugvs:
            found["goals_reached"] = self.standings(name)["reached"].copy()
            if self.scenario.has_ground:
                found |= self._mission_facts()
        elif self.is_filtered(name):
            rows = self.loop.decisions(name)
            found["overridden"] = rows["source"] != NOMINAL
            found["certified"] = rows["reason"] == CERTIFIED
            found["uncertified"] = rows["reason"].copy()
            found["certified_distance"] = rows["certified_distance"].copy()
        return found

    def _mission_facts(self) -> dict[str, FloatArray]:
        """Return the mission metrics of the worlds whose episode has ended; NaN in the others."""
        found = {key: np.full(self.num_envs, np.nan) for key in MISSION}
        for k in np.flatnonzero(np.logical_or(*self.ends())).tolist():
            for key, number in numbers(MISSION, self.loop.mission(k)).items():
                found[key][k] = number
        return found

    def infos(self, name: str) -> dict[str, Any]:
        """Return a vehicle's own facts that are not in its row, in all worlds, with Gymnasium's masks."""
        found = self._facts(name)
        return found | {f"_{key}": np.ones(self.num_envs, dtype=np.bool_) for key in found}

    def info(self, name: str) -> dict[str, Any]:
        """Return a vehicle's own facts in the first world as plain numbers."""
        return {key: array.item(0) for key, array in self._facts(name).items()}

    def reasons(self, name: str) -> dict[str, str]:
        """Return the reason for the last uncertified tick of a filtered UAV in the first world, in words for people."""
        if not self.is_filtered(name):
            return {}
        reason = self.loop.decision(name).reason
        return {"uncertified": "" if reason is None else reason.value}

    def reset(
        self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None
    ) -> IntArray:
        """Begin episodes in all worlds, or in the worlds selected by `options["reset_mask"]`.

        Args:
            seed: Seed of world 0, with seed + k for world k; or one seed per world; None: the next ones, as in `Seeds`.
            options: None, or a `reset_mask`. Shape (num_envs,).

        Returns:
            The worlds in which an episode has started.

        Raises:
            ResetNeeded: If the first reset has a mask that does not select all worlds.
            ValueError: If the number of seeds is wrong, or a seed, the mask or another option is not allowed.
        """
        check_options(options, "reset_mask")
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if options is not None and options.get("reset_mask") is not None:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
                raise ValueError(
                    f"options['reset_mask']: not a mask; allowed: {self.num_envs} booleans, at least one of them true"
                )
            if not self.has_episode and not mask.all():
                raise ResetNeeded("reset() all worlds before resetting some of them")
        seeds = self._given(seed)
        which = np.flatnonzero(mask)
        for k in which.tolist():
            Seeds.check(seeds[k])
        for k in which.tolist():
            self._seeds[k].begin(seeds[k])
        self.loop.begin([self._seeds[k].current for k in which.tolist()], which)
        self.has_episode = True
        self._paid[which] = 0.0
        if self._view is not None:
            self._view.begin(which)
        return which

    def _given(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, Sequence | np.ndarray):
            if len(seed) != self.num_envs:
                raise ValueError(
                    f"seed: {len(seed)} seeds; allowed: num_envs = {self.num_envs} seeds"
                )
            return list(seed)
        try:
            first = operator.index(seed)
        except TypeError:
            raise ValueError(
                f"seed = {seed!r}: not a seed; allowed: a whole number, or one for each world"
            ) from None
        return [first + k for k in range(self.num_envs)]

    @property
    def episode_seeds(self) -> list[int]:
        """Seed of each world's episode; `outrider run --seed` with it flies the same one.

        Before the first reset, these are the seeds of a first reset without any.
        """
        return [seeds.current for seeds in self._seeds]

    def step(
        self, actions: Mapping[str, npt.ArrayLike], which: IntArray | None = None
    ) -> BoolArray:
        """Advance worlds by one tick, without automatic resets.

        Args:
            actions: Accelerations of each learner [m/s²]. Shape (num_envs, 2) each; (num_envs, 3) for a UAV that has an
                altitude.
            which: Worlds to advance; all by default. The others do not change.

        Returns:
            True for each world whose episode has ended. Shape (num_envs,).

        Raises:
            ResetNeeded: Before the first reset.
            ValueError: If an action is missing, belongs to no learner, or does not hold finite numbers of this shape;
                the state is unchanged then.
        """
        if not self.has_episode:
            raise ResetNeeded("step() before reset()")
        check_by_agent(actions, self.learners)
        if set(actions) != set(self.learners):
            given = ", ".join(map(str, actions)) or "none"
            raise ValueError(
                f"actions for: {given}; allowed: one for each of {', '.join(self.learners)}"
            )
        taken = [self._taken(name, actions[name]) for name in self.learners]
        taken += [
            self._taken(name, policy(self.observe(name))) for name, policy in self._policies.items()
        ]
        for row, (name, action) in enumerate(zip(self._external, taken, strict=True)):
            self._actions[:, row, self.action_columns[name]] = action
        self.advance(self._actions, which)
        if self._view is not None:
            self._view.follow()
        rows = self.loop.state.rows
        ended: BoolArray = (rows.terminated | rows.truncated) != 0
        return ended

    def _taken(self, name: str, actions: npt.ArrayLike) -> FloatArray:
        return take_batch(name, actions, self.num_envs, self.action_columns[name])

    def advance(self, actions: FloatArray, which: IntArray | None = None) -> None:
        """Advance worlds by one tick with the actions of `ClosedLoop.step`, and pay the rewards."""
        self.loop.step(actions, which)
        weighted, function = self.loop.state.rows.standings["reward"], self.settings.reward_function
        if function is None:
            self._paid[:] = weighted
        else:
            self._paid = rewards_by(function, self.metrics(), self.loop.names, weighted)

    def all_rewards(self) -> FloatArray:
        """Return the rewards of the last tick. Shape (num_envs, vehicles)."""
        return self._paid

    def rewards(self, name: str) -> FloatArray:
        """Return a vehicle's rewards of the last tick. Shape (num_envs,)."""
        return self._paid[:, self.loop.names.index(name)].copy()

    def ends(self) -> tuple[BoolArray, BoolArray]:
        """Return the masks of terminated and of truncated episodes. Shape (num_envs,) each."""
        state = self.loop.state
        return state.rows.terminated != 0, state.rows.truncated != 0

    def metrics(self) -> dict[str, dict[str, FloatArray]]:
        """Return each vehicle's true metrics and the terms of its last reward, and the random fields, in all worlds.

        They are for people, logs and rewards, not for policies.

        Raises:
            ResetNeeded: Before the first reset.
        """
        if not self.has_episode:
            raise ResetNeeded("metrics() before reset()")
        rows, state = self.loop.tables.rows, self.loop.state.rows
        return {
            name: true_metrics(self.scenario, rows, state, name)
            | (self.loop.metrics(name) if name in self.loop.uavs else {})
            | self.loop.drawn()
            for name in self.loop.names
        }

    def first_metrics(self) -> dict[str, dict[str, Any]]:
        """Return `metrics` of the first world as plain numbers, with the words of `reasons`."""
        return {
            name: {key: array.item(0) for key, array in found.items()} | self.reasons(name)
            for name, found in self.metrics().items()
        }

    def links(self, world: int) -> dict[str, LinkStatus]:
        """Return the counters of each link of one world so far, by `vehicle/kind`."""
        return self.loop.links(world)

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """Return a picture of each world at the current tick, shape (rows, columns, 3); None without a render mode.

        Raises:
            ResetNeeded: Before the first reset.
        """
        if self._view is None:
            logger.warn("render() draws nothing: make the environment with render_mode='rgb_array'")
            return None
        if not self.has_episode:
            raise ResetNeeded("render() before reset()")
        return self._view.render()
