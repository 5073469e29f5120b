"""The common part of all environments: the closed loop, its seeds, spaces, and the change between two episodes.

`docs/reference/environment.md` says what a vehicle observes and is paid.
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
from bus.messages.base import or_infinite
from bus.messages.links import LinkStatus
from bus.messages.telemetry import MissionResult
from bus.observations import GRADIENT, UAV, as_rows
from outrider.envs.closed_loop import ClosedLoop
from outrider.envs.pilot_numbers import pilot_names
from sim.compiling.compile import FloatArray, IntArray
from sim.compiling.records import RecordArray
from sim.env.actions import take_batch
from sim.env.observation import AgentObservation, ObservationFormat
from sim.env.seeds import Seeds
from sim.env.settings import settings_of
from sim.env.spaces import action_space
from sim.env.view import BatchRendering
from sim.scenario.loading import given_scenario
from sim.scenario.types import Scenario
from sim.world import World

BoolArray = npt.NDArray[np.bool_]

PICTURES: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}
"""Metadata of an environment that draws."""


def _checked_count(num_envs: int) -> int:
    try:
        count = operator.index(num_envs)
    except TypeError:
        count = 0
    if count < 1:
        raise ValueError(f"num_envs = {num_envs!r}: must be a whole number, 1 or more")
    return count


class Worlds:
    """Many worlds of one scenario, as every environment sees them.

    Args:
        scenario: A shipped name, a file, or a scenario.
        num_envs: How many worlds.
        learners: Vehicles whose actions come from outside; None: all.
        error: Whether e(t) is computed at every tick; if `uncovered` is paid, it is in any case.
        render_mode: None, or "rgb_array": `render` draws.
        settings: By keyword: `sim.env.settings.Settings` says what each is.

    Raises:
        ScenarioError: If the scenario cannot be flown.
        ValueError: If another argument is not allowed.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        num_envs: int,
        learners: Sequence[str] | None,
        *,
        error: bool = False,
        render_mode: str | None = None,
        **settings: Any,  # noqa: ANN401 - fields of `Settings`
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(
                f"render_mode = {render_mode!r}; allowed: None, 'rgb_array'; outrider.parallel_env has a window"
            )
        self.settings = options = settings_of(settings)
        self.num_envs = _checked_count(num_envs)
        self.scenario = given_scenario(scenario, options.duration)
        names = [vehicle.name for vehicle in self.scenario.vehicles]
        self.learners = list(names if learners is None else learners)
        for name in self.learners:
            if name not in names:
                raise ValueError(f"agent = {name!r}; allowed: {', '.join(names)}")
        self._format = ObservationFormat(self.scenario, options)
        given = dict(options.others or {})
        self._policies = {
            name: pilot for name, pilot in given.items() if not isinstance(pilot, str)
        }
        named = {name: pilot for name, pilot in given.items() if isinstance(pilot, str)}
        self._check_others(given, named, names)
        self._hands = [*self.learners, *self._policies]
        self.loop = ClosedLoop(
            self.scenario,
            self.num_envs,
            external=self._hands,
            pilots=named,
            error=error,
            **settings,
        )
        """The worlds themselves."""
        self.action_spaces = {v.name: action_space(v) for v in self.scenario.vehicles}
        self.observation_spaces = self._format.spaces
        self._seeds = [Seeds(self.scenario.seed + k) for k in range(self.num_envs)]
        self._actions: FloatArray = np.zeros((self.num_envs, len(self._hands), 2))
        self.begun = False
        """True if there is an episode to step."""
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
            if hasattr(pilot, "check"):  # as outrider_learning's: it knows what it was made for
                pilot.check(self.scenario)

    def world(self, number: int) -> World:
        """The true state of one world, as it is at any time."""
        return World.of_batch(self.loop.batch, number, self._seeds[number].current)

    def observe(self, name: str) -> AgentObservation:
        """The observations of a vehicle in all worlds: new arrays, which nobody changes later."""
        loop, form = self.loop, self._format
        if name in loop.ugvs:
            known = loop.known_tiles(name) if form.tile_patch else None
            row = as_rows(loop.state.rows.ugv_rows)[:, loop.ugvs.index(name)]
            return form.shown(name, row, known=known)
        width = len(UAV) + (len(GRADIENT) if self.settings.gradient else 0)
        coverage = None if form.patch is None else loop.patch(name)
        row = as_rows(loop.state.rows.uav_rows)[:, loop.uavs.index(name), :width]
        return form.shown(name, row, coverage=coverage)

    def standings(self, name: str) -> RecordArray:
        """Return the `sim.env.rows.Standing` of a vehicle in all worlds; a view."""
        return self.loop.state.rows.standings[:, self.loop.names.index(name)]

    def mission(self, world: int) -> MissionResult | None:
        """The mission of one world so far; None where there are no hazards."""
        return self.loop.mission(world) if self.scenario.has_ground else None

    def is_filtered(self, name: str) -> bool:
        """True if the actions of a vehicle come from outside and go through the safety filter."""
        return self.settings.safety_filter and name in self._hands and name in self.loop.uavs

    def infos(self, name: str) -> dict[str, Any]:
        """Facts of a vehicle's own that are in no row, in all worlds, with Gymnasium's masks."""
        found: dict[str, Any] = {}
        if name in self.loop.ugvs:
            found["goals_reached"] = self.standings(name)["reached"].copy()
        elif self.is_filtered(name):
            rows = self.loop.decisions(name)
            found["overridden"] = rows["source"] != NOMINAL
            found["certified"] = rows["reason"] == CERTIFIED
            found["certified_distance"] = rows["certified_distance"].copy()
        return found | {f"_{key}": np.ones(self.num_envs, dtype=np.bool_) for key in found}

    def info(self, name: str) -> dict[str, Any]:
        """The same in the first world as plain numbers, and why the safety filter has not certified its answer."""
        if name in self.loop.ugvs:
            return {"goals_reached": self.standings(name)["reached"].item(0)}
        if not self.is_filtered(name):
            return {}
        decision = self.loop.decision(name)
        return {
            "overridden": decision.overridden,
            "certified": decision.certified,
            "uncertified": decision.reason.value if decision.reason else "",
            "certified_distance": or_infinite(decision.certified_distance),
        }

    def reset(
        self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None
    ) -> IntArray:
        """Begin episodes: in all worlds, or in those of the boolean array `options["reset_mask"]`.

        Returns:
            The worlds in which an episode has begun.

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
        for k in which.tolist():
            self._seeds[k].begin(seeds[k])
        self.loop.begin([self._seeds[k].current for k in which.tolist()], which)
        self.begun = True
        if self._view is not None:
            self._view.begin(which)
        return which

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
    ) -> BoolArray:
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
        rows = self.loop.state.rows
        ended: BoolArray = (rows.terminated | rows.truncated) != 0
        return ended

    def rewards(self, name: str) -> FloatArray:
        """Return the rewards of the last tick. Shape (num_envs,)."""
        return self.standings(name)["reward"].copy()

    def ends(self) -> tuple[BoolArray, BoolArray]:
        """The episodes that have terminated, and those that were truncated."""
        state = self.loop.state
        return state.rows.terminated != 0, state.rows.truncated != 0

    def metrics(self) -> dict[str, dict[str, FloatArray]]:
        """Each UAV's true standing in its episode, in all worlds: for people and logs, not for policies.

        Raises:
            ResetNeeded: Before the first reset.
        """
        if not self.begun:
            raise ResetNeeded("metrics() before reset()")
        return {uav: self.loop.metrics(uav) for uav in self.loop.uavs}

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
