"""Worlds with automatic resets, as in Gymnasium's vector environments."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from outrider.envs.worlds import BoolArray, Worlds
from sim.compiling.compile import FloatArray, IntArray
from sim.env.observation import AgentObservation, one_of_world

BatchStep = tuple[
    dict[str, AgentObservation],
    dict[str, FloatArray],
    dict[str, BoolArray],
    dict[str, BoolArray],
    dict[str, dict[str, Any]],
]
"""Observations, rewards, terminations, truncations and infos of all worlds, by agent."""


def _checked_mode(mode: AutoresetMode | str) -> AutoresetMode:
    modes = (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP)
    for one in modes:
        if mode in (one, one.value):
            return one
    allowed = ", ".join(repr(one.value) for one in modes)
    raise ValueError(f"autoreset_mode = {mode!r}; allowed: {allowed}")


class AutoresetWorlds(Worlds):
    """Many worlds in which a new episode follows each one that has ended.

    Args:
        autoreset_mode: Time of the reset: SAME_STEP or NEXT_STEP.
        arguments: Arguments of `Worlds`.

    Raises:
        ScenarioError: If the scenario cannot be flown.
        ValueError: If another argument is not allowed.
    """

    def __init__(
        self,
        *arguments: Any,  # noqa: ANN401 - as for `Worlds`
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        **settings: Any,  # noqa: ANN401 - fields of `Settings`
    ) -> None:
        self.autoreset_mode = _checked_mode(autoreset_mode)
        """Time of the reset after an episode has ended."""
        super().__init__(*arguments, **settings)
        self._returns: FloatArray = np.zeros((self.num_envs, len(self.loop.names)))
        """Return of each episode so far, in the mode SAME_STEP. Shape (num_envs, vehicles)."""
        self._over: BoolArray = np.zeros(self.num_envs, dtype=np.bool_)
        """Episodes that have ended and reset in the next step, in the mode NEXT_STEP. Shape (num_envs,)."""

    def reset(
        self, seed: int | Sequence[int | None] | None, options: Mapping[str, Any] | None
    ) -> IntArray:
        """Begin episodes, as in `Worlds.reset`."""
        which = super().reset(seed, options)
        self._returns[which], self._over[which] = 0.0, False
        return which

    def step_with_autoreset(self, actions: Mapping[str, npt.ArrayLike]) -> BatchStep:
        """Advance all worlds by one tick; an ended episode resets, with the seed that follows its last one.

        In the mode SAME_STEP it resets at once, and its last observation is in the infos. In the mode NEXT_STEP it
        resets in the next call, which ignores the actions in this world.

        Args:
            actions: As for `step`, whose errors this method raises.
        """
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            return self._step_or_begin(actions)
        ended = self.step(actions)
        self._returns += self.all_rewards()
        rewards = {name: self.rewards(name) for name in self.learners}
        terminated, truncated = self.ends()
        final: dict[str, dict[str, Any]] = {name: {} for name in self.learners}
        if ended.any():
            final = {name: self._final(name, ended) for name in self.learners}
            self.reset(None, {"reset_mask": ended})
        return self._stepped(rewards, terminated, truncated, final)

    def _step_or_begin(self, actions: Mapping[str, npt.ArrayLike]) -> BatchStep:
        over = self._over
        ended = self.step(actions, np.flatnonzero(~over)) & ~over
        if over.any():
            self.reset(None, {"reset_mask": over})
        self._over = ended
        rewards = {name: self.rewards(name) for name in self.learners}
        return self._stepped(rewards, *self.ends(), {name: {} for name in self.learners})

    def _stepped(
        self,
        rewards: dict[str, FloatArray],
        terminated: BoolArray,
        truncated: BoolArray,
        final: Mapping[str, dict[str, Any]],
    ) -> BatchStep:
        return (
            {name: self.observe(name) for name in self.learners},
            rewards,
            {name: terminated.copy() for name in self.learners},
            {name: truncated.copy() for name in self.learners},
            {name: self.infos(name) | final[name] for name in self.learners},
        )

    def _final(self, name: str, ended: BoolArray) -> dict[str, Any]:
        """Return the last observations and infos of ended episodes, as in Gymnasium's vector environments."""
        last, infos = self.observe(name), self.infos(name)
        observations = np.full(self.num_envs, None, dtype=object)
        for k in np.flatnonzero(ended).tolist():
            observations[k] = one_of_world(last, k)
        info = {key: value for key, value in infos.items() if not key.startswith("_")}
        info["episode"] = {
            "r": np.where(ended, self._returns[:, self.loop.names.index(name)], 0.0),
            "l": np.where(ended, self.loop.state.batch.ticks, 0),
            "_r": ended.copy(),
            "_l": ended.copy(),
        }
        return _masked({"final_obs": observations, "final_info": _masked(info, ended)}, ended)


def _masked(info: Mapping[str, Any], ended: BoolArray) -> dict[str, Any]:
    """Return the entries, each with Gymnasium's mask of the worlds that have one."""
    return {**info, **{f"_{key}": ended.copy() for key in info}}
