"""Batched TorchRL environment: all vehicles learn, in many worlds at once."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

import outrider
from outrider_learning.bounds import MOST_TICKS, whole
from sim.env.observation import Array
from sim.scenario.types import Scenario

_ENDS = ("done", "terminated", "truncated")


def _groups(env: Any) -> dict[str, list[str]]:  # noqa: ANN401
    """Return the agents by the letters of their names; agents of a group have the same spaces."""
    groups: dict[str, list[str]] = {}
    for name in env.possible_agents:
        groups.setdefault(name.rstrip("0123456789").rstrip("_"), []).append(name)
    return groups


def _checked_groups(env: Any, given: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:  # noqa: ANN401
    groups = {group: list(names) for group, names in given.items()}
    if sorted(name for names in groups.values() for name in names) != sorted(env.possible_agents):
        raise ValueError(
            f"group_map = {groups}; allowed: each of {', '.join(env.possible_agents)} in one group"
        )
    for group, names in groups.items():
        spaces = [(env.observation_space(name), env.action_space(name)) for name in names]
        if any(
            [one[k].shape for k in (0, 1)] != [spaces[0][k].shape for k in (0, 1)] for one in spaces
        ):
            raise ValueError(
                f"group_map: {group!r}: spaces of different shapes; allowed: equal ones in a group"
            )
    return groups


class OutriderTorchEnv(EnvBase):  # type: ignore[misc]  # it has no types where it is not installed
    """`EnvBase` over `outrider.parallel_vector_env`, with the batch size `[num_envs]`.

    Every group of vehicles has `observation`, `action`, `reward` and ends, with an axis for its agents after the one
    for worlds; all agents of a world end together. `state` is the complete true state, for critics only. Worlds do not
    reset by themselves: TorchRL resets those that have ended, so that `next` holds the last observation and the last
    state of an episode.

    Args:
        scenario: Shipped name, file, or scenario.
        num_envs: Number of worlds.
        agents: Learning vehicles; all by default.
        repeat: Ticks per step under the same action, with the sum of their rewards; a world that has ended waits.
        group_map: Agents by group; by default those with the same letters, such as `uav` and `ugv`.
        seed: Seed of the first episodes, with seed + k for world k; None: one from the operating system.
        settings: Keywords, see `sim.env.settings.Settings`; `dtype` is float32 by default.

    Raises:
        ScenarioError: If the scenario cannot be flown.
        ValueError: If another argument is not allowed.
        TypeError: If a setting is unknown.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario = "escort",
        *,
        num_envs: int,
        agents: Sequence[str] | None = None,
        repeat: int = 1,
        group_map: Mapping[str, Sequence[str]] | None = None,
        seed: int | None = None,
        **settings: Any,  # noqa: ANN401 - fields of `Settings`
    ) -> None:
        settings = {"dtype": np.float32, **settings}
        inner = outrider.parallel_vector_env(scenario, num_envs=num_envs, agents=agents, **settings)
        super().__init__(device="cpu", batch_size=torch.Size([inner.num_envs]))
        self.inner = inner
        """Environment of many worlds."""
        self.repeat = whole("repeat", repeat, MOST_TICKS)
        """Ticks per step."""
        self.group_map = _groups(inner) if group_map is None else dict(group_map)
        """Agents by group."""
        self.group_map = _checked_groups(inner, self.group_map)
        self._seed: int | None = seed
        self._make_specs()

    def _make_specs(self) -> None:
        worlds = self.inner.num_envs
        observations: dict[str, Any] = {"state": _box(self.inner.state_space, (worlds,))}
        actions, rewards = dict[str, Any](), dict[str, Any]()
        for group, names in self.group_map.items():
            shape = (worlds, len(names))
            seen = [self.inner.observation_space(name) for name in names]
            acted = [self.inner.action_space(name) for name in names]
            observations[group] = Composite(observation=_observed(seen, shape), shape=shape)
            actions[group] = Composite(action=_stacked(acted, shape, torch.float32), shape=shape)
            reward = Unbounded(shape=(*shape, 1), dtype=torch.float32)
            rewards[group] = Composite(reward=reward, shape=shape)
        self.observation_spec = Composite(observations, shape=(worlds,))
        self.action_spec = Composite(actions, shape=(worlds,))
        self.reward_spec = Composite(rewards, shape=(worlds,))
        flag = Categorical(n=2, shape=(worlds, 1), dtype=torch.bool)
        ends: dict[str, Any] = {key: flag.clone() for key in _ENDS}
        for group, names in self.group_map.items():
            shape = (worlds, len(names))
            own = Categorical(n=2, shape=(*shape, 1), dtype=torch.bool)
            ends[group] = Composite({key: own.clone() for key in _ENDS}, shape=shape)
        self.done_spec = Composite(ends, shape=(worlds,))

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:  # noqa: ANN401 - TorchRL's
        mask = None if tensordict is None else tensordict.get("_reset", None)
        seed, self._seed = self._seed, None
        if mask is None or seed is not None or not self.inner.worlds.has_episode:
            self.inner.worlds.reset(seed, None)
        elif mask.any():
            worlds = mask.reshape(self.inner.num_envs, -1).any(dim=1).numpy()
            self.inner.worlds.reset(None, {"reset_mask": worlds})
        zeros = np.zeros(self.inner.num_envs, dtype=np.bool_)
        found = self._with_ends(self._seen(), zeros, zeros)
        return TensorDict(found, batch_size=self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        worlds = self.inner.worlds
        actions = {
            name: tensordict[group, "action"][:, k].detach().double().numpy()
            for group, names in self.group_map.items()
            for k, name in enumerate(names)
        }
        paid = {name: np.zeros(self.inner.num_envs) for name in actions}
        going = np.ones(self.inner.num_envs, dtype=np.bool_)
        for _ in range(self.repeat):
            ended = worlds.step(actions, np.flatnonzero(going))
            for name, sum_ in paid.items():
                sum_[going] += worlds.rewards(name)[going]
            going &= ~ended
            if not going.any():
                break
        found = self._with_ends(self._seen(), *worlds.ends())
        for group, names in self.group_map.items():
            reward = np.stack([paid[name] for name in names], axis=1)[..., None]
            found[group]["reward"] = torch.from_numpy(reward.astype(np.float32))
        return TensorDict(found, batch_size=self.batch_size)

    def _seen(self) -> dict[str, Any]:
        """Return state and observations of all worlds."""
        worlds, found = self.inner.worlds, dict[str, Any]()
        for group, names in self.group_map.items():
            shape = torch.Size([self.inner.num_envs, len(names)])
            rows = [worlds.observe(name) for name in names]
            found[group] = TensorDict({"observation": _tensors(rows)}, batch_size=shape)
        return found | {"state": torch.from_numpy(worlds.state())}

    def _with_ends(
        self, found: dict[str, Any], terminated: Array, truncated: Array
    ) -> dict[str, Any]:
        """Add the ends of all worlds, for the worlds and for every group."""
        flags = (np.logical_or(terminated, truncated), terminated, truncated)
        for key, flag in zip(_ENDS, flags, strict=True):
            ended = torch.from_numpy(np.array(flag)[:, None])
            found[key] = ended
            for group, names in self.group_map.items():
                found[group][key] = ended[:, None].expand(-1, len(names), -1).clone()
        return found

    def _set_seed(self, seed: int | None) -> None:
        """Store the seed: the next reset starts all worlds with it."""
        self._seed = seed

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Stop the threads."""
        if not self.is_closed:
            self.inner.close()
        super().close(raise_if_closed=raise_if_closed)


def _bounded(low: Array, high: Array, dtype: torch.dtype) -> Bounded:
    if dtype.is_floating_point:
        low, high = (bound.astype(np.float64) for bound in (low, high))
    return Bounded(
        low=torch.as_tensor(low, dtype=dtype), high=torch.as_tensor(high, dtype=dtype), dtype=dtype
    )


def _box(space: Any, worlds: tuple[int]) -> Bounded:  # noqa: ANN401 - a Box
    """Return the spec of an array in all worlds."""
    low, high = (np.broadcast_to(b, (*worlds, *space.shape)) for b in (space.low, space.high))
    return _bounded(np.array(low), np.array(high), torch.from_numpy(np.empty(0, space.dtype)).dtype)


def _stacked(
    boxes: Sequence[Any], shape: tuple[int, int], dtype: torch.dtype | None = None
) -> Bounded:
    """Return the spec of the arrays of a group's agents in all worlds."""
    low, high = (np.stack([getattr(one, end) for one in boxes]) for end in ("low", "high"))
    low, high = (np.array(np.broadcast_to(b, (shape[0], *b.shape))) for b in (low, high))
    return _bounded(low, high, dtype or torch.from_numpy(np.empty(0, boxes[0].dtype)).dtype)


def _observed(seen: Sequence[Any], shape: tuple[int, int]) -> Bounded | Composite:
    """Return the spec of the observations of a group's agents: an array, or one for each key."""
    parts = getattr(seen[0], "spaces", None)
    if not isinstance(parts, Mapping):
        return _stacked(seen, shape)
    return Composite(
        {key: _stacked([one[key] for one in seen], shape) for key in parts}, shape=shape
    )


def _tensors(seen: Sequence[Any]) -> Any:  # noqa: ANN401 - a tensor, or one for each key
    """Return the observations of a group's agents. Shape (worlds, agents, ...)."""
    first = seen[0]
    if not isinstance(first, dict):
        return torch.from_numpy(np.stack(seen, axis=1))
    stacked = {key: np.stack([one[key] for one in seen], axis=1) for key in first}
    shape = torch.Size(next(iter(stacked.values())).shape[:2])
    return TensorDict(
        {key: torch.from_numpy(array) for key, array in stacked.items()}, batch_size=shape
    )
