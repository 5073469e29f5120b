"""Stable-Baselines3 adapter for Gymnasium vector environments."""

import time
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from outrider_learning.repeat import FINAL
from sim.env.observation import one_of_world


class VecEnvAdapter(VecEnv):  # type: ignore[misc]  # it has no types where it is not installed
    """`VecEnv` around any Gymnasium vector environment in the mode SAME_STEP, wrapped or not.

    At the end of an episode its info has `terminal_observation`, `TimeLimit.truncated` (truncated and not terminated),
    and the `episode` of `VecMonitor`: return `r`, steps `l`, and time `t` since the adapter was created [s]. The mean
    return is therefore logged without `VecMonitor`. The other infos are the environment's, world by world.

    Args:
        env: Vector environment. The adapter's `seed` and `set_options` take effect at the next `reset`.

    Raises:
        ValueError: If the autoreset mode differs.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            name = mode.name if isinstance(mode, AutoresetMode) else mode
            raise ValueError(
                f"autoreset_mode = {name}: Stable-Baselines3 needs the last observation of an episode and the first "
                "of the next in one step; allowed: AutoresetMode.SAME_STEP"
            )
        self.env = env
        self._actions: Any = None
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)
        self._created = time.perf_counter()
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> Any:  # noqa: ANN401 - an array, or a dictionary of arrays
        """Start an episode in every world, with the seeds and options set since the last reset.

        Raises:
            ValueError: If the options differ between worlds.
        """
        options, seeds = self._options[0], list(self._seeds)
        if any(given != options for given in self._options):
            raise ValueError(
                "set_options: the worlds share their options; allowed: the same for all"
            )
        unseeded = all(seed is None for seed in seeds)
        observations, infos = self.env.reset(
            seed=None if unseeded else seeds,  # type: ignore[arg-type]
            options=options or None,
        )
        self.reset_infos = _by_world(infos, self.num_envs)
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        return observations

    def step_async(self, actions: Any) -> None:  # noqa: ANN401
        """Store the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Any:  # noqa: ANN401
        """Step all worlds with the stored actions.

        Returns:
            Observations, rewards (float32), end of episode flags, and an info for each world.
        """
        observations, rewards, terminated, truncated, step_infos = self.env.step(self._actions)
        dones = np.logical_or(terminated, truncated)
        self._returns += rewards
        self._lengths += 1
        infos = _by_world(
            {key: value for key, value in step_infos.items() if key not in FINAL}, self.num_envs
        )
        ended = np.flatnonzero(dones).tolist()
        if ended:
            last = _by_world(step_infos.get("final_info", {}), self.num_envs)
            for k in ended:
                self.reset_infos[k] = infos[k]
                infos[k] = last[k] | {
                    "terminal_observation": one_of_world(step_infos["final_obs"], k),
                    "episode": self._episode(k),
                }
            self._returns[ended], self._lengths[ended] = 0.0, 0
        for k, info in enumerate(infos):
            info["TimeLimit.truncated"] = bool(truncated[k] and not terminated[k])
        return observations, np.array(rewards, dtype=np.float32), dones, infos

    def _episode(self, k: int) -> dict[str, float | int]:
        elapsed = round(time.perf_counter() - self._created, 6)
        return {"r": float(self._returns[k]), "l": int(self._lengths[k]), "t": elapsed}

    def get_images(self) -> list[Any]:
        """Return the picture of each world, for `render` and `VecVideoRecorder`."""
        return list(self.env.render() or ())

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:  # noqa: ANN401 - None, a number or several
        """Return a shared attribute of the environment, once for each of the worlds."""
        return [self._found(attr_name)] * len(self._worlds(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ANN401
        """Set an attribute of the environment, in the layer that has it, else in the outermost.

        Raises:
            ValueError: If `indices` selects only some of the worlds: they share the attribute.
        """
        if set(self._worlds(indices)) != set(range(self.num_envs)):
            raise ValueError(
                f"set_attr({attr_name!r}, indices={indices!r}): the worlds share their attributes; allowed: all worlds"
            )
        layers = self._layers()
        setattr(
            next((layer for layer in layers if attr_name in vars(layer)), layers[0]),
            attr_name,
            value,
        )

    def env_method(
        self,
        method_name: str,
        *method_args: Any,  # noqa: ANN401
        indices: Any = None,  # noqa: ANN401
        **method_kwargs: Any,  # noqa: ANN401
    ) -> list[Any]:
        """Call a method of the environment once, for all worlds.

        Return its result once for each of the selected worlds.
        """
        return [self._found(method_name)(*method_args, **method_kwargs)] * len(
            self._worlds(indices)
        )

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:  # noqa: ANN401
        """Return true if a layer is of this class; also for `Monitor`, which the adapter replaces."""
        found = wrapper_class is Monitor or any(
            isinstance(layer, wrapper_class) for layer in self._layers()
        )
        return [found] * len(self._worlds(indices))

    def _found(self, name: str) -> Any:  # noqa: ANN401
        """Return the attribute of the outermost layer that has it."""
        return getattr(
            next((layer for layer in self._layers() if hasattr(layer, name)), self.env), name
        )

    def _worlds(self, indices: Any) -> list[int]:  # noqa: ANN401
        which: list[int] = np.arange(self.num_envs)[
            slice(None) if indices is None else np.atleast_1d(indices)
        ].tolist()
        return which

    def _layers(self) -> list[Any]:
        """Return the environment's layers, from the outermost wrapper inwards."""
        layers = [self.env]
        while isinstance(layers[-1], VectorWrapper):
            layers.append(layers[-1].env)
        return layers


def _by_world(infos: dict[str, Any], worlds: int) -> list[dict[str, Any]]:
    """Split Gymnasium's infos by world; `_key` marks the worlds that have `key`."""
    found: list[dict[str, Any]] = [{} for _ in range(worlds)]
    for key, value in infos.items():
        if key.startswith("_"):
            continue
        if isinstance(value, dict):
            values: Any = _by_world(value, worlds)
        else:
            each = isinstance(value, np.ndarray | list | tuple) and len(value) == worlds
            values = value if each else [value] * worlds  # else it holds for all worlds
        has = infos.get(f"_{key}")
        for k in range(worlds) if has is None else np.flatnonzero(has).tolist():
            found[k][key] = values[k]
    return found
