"""Action repeat: fewer, longer steps for the learner."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from outrider_learning.bounds import MOST_TICKS, whole

FINAL = ("final_obs", "_final_obs", "final_info", "_final_info")
"""Entries of the infos about finished episodes."""


class ActionRepeat(VectorWrapper):  # not subscripted: Gymnasium 1.1 takes no arguments here
    """Environment whose step is several ticks under the same action, with the sum of their rewards.

    If an episode ends inside a step, the reward is the old episode's. The new episode starts at that tick and runs the
    rest of the step with zero action. Episodes of a whole number of steps end at a step's last tick.

    Args:
        env: Vector environment in the mode SAME_STEP, or a wrapper of it.
        ticks: Ticks per step.

    Raises:
        ValueError: If the mode differs, or `ticks` is not a whole number from 1 to `MOST_TICKS`.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], ticks: int) -> None:
        super().__init__(env)
        if env.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
            raise ValueError(f"{env}: ActionRepeat needs the autoreset mode SAME_STEP")
        self.ticks = whole("ticks", ticks, MOST_TICKS)
        """Ticks per step."""

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """Return SAME_STEP; TorchRL reads the mode here."""
        return AutoresetMode.SAME_STEP

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:  # noqa: ANN401 - as the environment's
        """Advance all worlds by one step."""
        repeated = np.array(actions)
        observations, rewards, terminated, truncated, infos = self.env.step(repeated)
        total, ended = np.array(rewards, dtype=np.float64), np.logical_or(terminated, truncated)
        final = _final(infos)
        for _ in range(self.ticks - 1):
            if ended.any():
                repeated[ended] = 0.0
            observations, rewards, now_terminated, now_truncated, infos = self.env.step(repeated)
            total += np.where(ended, 0.0, rewards)
            new = np.logical_or(now_terminated, now_truncated) & ~ended
            if new.any():
                terminated = np.where(new, now_terminated, terminated)
                truncated = np.where(new, now_truncated, truncated)
                final, ended = _merged(final, _final(infos), new), ended | new
        kept = {key: value for key, value in infos.items() if key not in FINAL}
        return observations, total, terminated, truncated, kept | final


def _final(infos: dict[str, Any]) -> dict[str, Any]:
    return {key: infos[key] for key in FINAL if key in infos}


def _merged(one: Any, other: Any, worlds: Any) -> Any:  # noqa: ANN401 - arrays, and dictionaries of them
    """Return `one`, with the values of `other` in these worlds."""
    if not isinstance(other, dict):
        whole = np.array(one) if one is not None else np.zeros_like(other)
        for k in np.flatnonzero(worlds):
            whole[k] = other[k]
        return whole
    earlier = one or {}
    return earlier | {key: _merged(earlier.get(key), value, worlds) for key, value in other.items()}
