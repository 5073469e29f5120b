"""An action that is held for several ticks: fewer, longer steps for whoever learns."""

import operator
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

FINAL = ("final_obs", "_final_obs", "final_info", "_final_info")
"""Entries of the infos that tell of episodes that have ended."""


class ActionRepeat(VectorWrapper):  # not subscripted: Gymnasium 1.1 takes no arguments here
    """A step is several ticks under the same action, and its reward is the sum of theirs.

    Where an episode ends inside a step, the reward is that of the old episode, and the new one, which begins in that
    very tick, passes the rest of the step with the action zero. Episodes whose length is a whole number of steps end at
    a step's last tick.

    Args:
        env: A vector environment in the mode SAME_STEP, or a wrapper of it.
        ticks: Ticks of a step.

    Raises:
        ValueError: If the mode is another, or `ticks` is no whole number from 1 on.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], ticks: int) -> None:
        super().__init__(env)
        if env.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
            raise ValueError(f"{env}: ActionRepeat needs the autoreset mode SAME_STEP")
        try:
            self.ticks = operator.index(ticks)
            """Of a step."""
        except TypeError:
            self.ticks = 0
        if self.ticks < 1:
            raise ValueError(f"ticks = {ticks!r}; must be a whole number from 1 on")

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """SAME_STEP; TorchRL reads it here."""
        return AutoresetMode.SAME_STEP

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:  # noqa: ANN401 - as the environment's
        """Let all worlds go on by a step."""
        held = np.array(actions)
        observations, rewards, terminated, truncated, infos = self.env.step(held)
        total, ended = np.array(rewards, dtype=np.float64), np.logical_or(terminated, truncated)
        final = _final(infos)
        for _ in range(self.ticks - 1):
            if ended.any():
                held[ended] = 0.0
            observations, rewards, now_terminated, now_truncated, infos = self.env.step(held)
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
    """`one`, and where the worlds are these, `other`."""
    if not isinstance(other, dict):
        whole = np.array(one) if one is not None else np.zeros_like(other)
        for k in np.flatnonzero(worlds):
            whole[k] = other[k]
        return whole
    earlier = one or {}
    return earlier | {key: _merged(earlier.get(key), value, worlds) for key, value in other.items()}
