"""Recipe of a policy's observation: settings of the environment and the wrappers around it."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from gymnasium import spaces
from msgspec import Meta

from bus.errors import ScenarioError
from bus.messages.base import NonNegative, Positive
from bus.messages.team import MOST_UAVS
from outrider.running.user_modules import find_object
from outrider_learning.bounds import MOST_TICKS, whole
from outrider_learning.egocentric import Egocentric
from outrider_learning.policy_inputs import EscortView
from outrider_learning.repeat import ActionRepeat
from outrider_learning.stacking import Stack
from outrider_learning.standardized import Standardized
from outrider_learning.transformation import Transformation, Transformed
from sim.env.observation import uav_space
from sim.env.patch import given_patch
from sim.env.spaces import extent_of
from sim.scenario.team import mates_of
from sim.scenario.vehicle_types import Uav

_KINDS: Mapping[str, type[Transformation]] = {
    "egocentric": Egocentric,
    "stack": Stack,
    "escort_view": EscortView,
    "standardized": Standardized,
}
"""Our own transformations, by their names in the file; another class is named `module:class`."""
_REPEAT = "repeat"
_OF_GYMNASIUM = (
    *("Monitor", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics", "RecordVideo"),
    *("RenderCollection", "HumanRendering", "TimeLimit", "VecEnvAdapter"),
)
_OF_SB3 = ("VecCheckNan", "VecMonitor", "VecTransposeImage", "VecVideoRecorder")
_PASSED = {"env": _OF_GYMNASIUM, "venv": _OF_SB3}
"""Layers without effect on observations and actions, by the attribute of the inner one.

A model repeats the effect of `VecTransposeImage` by itself.
"""


NEEDED = frozenset({"T", "W", "H", "v_max", "d_max", "D"})
"""Names of `bus.observations.SYMBOLS` that bound a UAV's observation."""
HIGHER = frozenset({"z_max", "w_max"})
"""Further ones for a UAV that has an altitude."""


class ObservationRecipe(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Recipe of a policy's observation."""

    extent: dict[str, NonNegative]
    """Values of the names in `NEEDED` in the training environment, and of those in `HIGHER` with an altitude."""
    dt: Positive | None = None
    """Length of a tick [s]; None if unknown."""
    mates: Annotated[int, Meta(ge=0, le=MOST_UAVS)] = 0
    """UAVs of the UAV's team, itself included; 0: it has no team."""
    roles: Literal["rules", "action"] = "rules"
    estimate: bool = False
    gradient: bool = False
    omit: tuple[Literal["time", "position"], ...] = ()
    coverage_patch: tuple[int, float] | None = None
    dtype: Literal["float32", "float64"] = "float64"
    """Settings of `outrider.vector_env`."""
    layers: tuple[dict[str, Any], ...] = ()
    """Layers from the inside out: `kind` and settings of a transformation, or `repeat` and `ticks`."""

    @property
    def length(self) -> float:
        """Return the length of an episode [s]."""
        return self.extent["T"]

    @property
    def altitude(self) -> bool:
        """Return True if the UAV has an altitude, hence two more entries and a vertical action."""
        return self.extent.keys() >= HIGHER

    @property
    def actions(self) -> int:
        """Return the number of entries of an action."""
        return 2 + self.altitude + (self.mates > 0 and self.roles == "action")

    def space(self) -> spaces.Space[Any]:
        """Return the environment's own observation space."""
        patch = given_patch(self.coverage_patch)
        return uav_space(
            self.extent,
            estimate=self.estimate,
            gradient=self.gradient,
            omit=self.omit,
            altitude=self.altitude,
            mates=self.mates,
            pixels=0 if patch is None else patch.pixels,
            dtype=np.dtype(self.dtype).type,
        )

    def shown_space(self) -> spaces.Space[Any]:
        """Return the space of the observations behind all layers."""
        space = self.space()
        for layer in map(make_layer, self.layers):
            if isinstance(layer, Transformation):
                space = layer.space(space)
        return space


def checked_recipe(recipe: ObservationRecipe) -> ObservationRecipe:
    """Return a recipe that has been read from a file.

    Raises:
        ValueError: If its extent is incomplete.
    """
    if missing := NEEDED - recipe.extent.keys():
        raise ValueError(f"extent: lacks {', '.join(sorted(missing))}")
    return recipe


def observation_recipe(
    env: Any,  # noqa: ANN401 - of several ecosystems
    agent: str | None = None,
) -> ObservationRecipe:
    """Return the recipe of a UAV's observations in an environment with all its wrappers.

    Args:
        env: `outrider.vector_env` or `outrider.single_env`, or a `VecEnv` of Stable-Baselines3 around them. Supported
            wrappers: `Transformed`, `ActionRepeat`, `VecEnvAdapter`, `VecNormalize` and wrappers without effect. With
            `agent` also `outrider.parallel_vector_env` and `OutriderTorchEnv`.
        agent: UAV whose observation it is; None: the environment's own agent.

    Raises:
        ValueError: If a wrapper cannot be saved with a policy, or the agent is not a UAV.
    """
    layers: list[dict[str, Any]] = []
    while not hasattr(env, "worlds"):
        layer, inside = _taken_off(env)
        layers = [*([] if layer is None else [layer]), *layers]
        env = inside
    agent = env.agent if agent is None else agent
    scenario, options = env.worlds.scenario, env.worlds.settings.of_agent(agent)
    uav = next((one for one in scenario.vehicles if one.name == agent), None)
    if not isinstance(uav, Uav):
        raise ValueError(f"agent = {agent!r}: not a UAV; allowed: a UAV")
    patch = options.coverage_patch
    given = NEEDED if uav.initial_altitude is None else NEEDED | HIGHER
    return ObservationRecipe(
        extent={name: value for name, value in extent_of(scenario, uav).items() if name in given},
        dt=scenario.dt,
        mates=len(mates_of(scenario, uav.name)),
        roles=env.worlds.settings.roles,
        estimate=options.estimate,
        gradient=options.gradient,
        omit=tuple(options.omit),
        coverage_patch=None if patch is None else (int(patch[0]), float(patch[1])),
        dtype=np.dtype(options.dtype).name,
        layers=tuple(layers),
    )


def _kind_of(found: type[Transformation]) -> str:
    """Return the name of a transformation in a recipe: a short one, or `module:class` for a user's class.

    Raises:
        ValueError: If another process cannot import the class.
    """
    for kind, known in _KINDS.items():
        if found is known:
            return kind
    module, name = found.__module__, found.__qualname__
    if module == "__main__" or not name.isidentifier():
        raise ValueError(
            f"{name} of {module}: cannot be loaded elsewhere; allowed: a class at the top of a module, not of the "
            "program that trains"
        )
    return f"{module}:{name}"


def _class_of(kind: str) -> type[Transformation]:
    """Return the class with this name in a recipe.

    Raises:
        ValueError: If there is no such class, or its module cannot be imported.
    """
    if kind in _KINDS:
        return _KINDS[kind]
    if ":" not in kind:
        raise ValueError("unknown")
    found = find_object(kind, "kind")
    if not (isinstance(found, type) and issubclass(found, Transformation)):
        raise ValueError("not a transformation")
    return found


def _taken_off(env: Any) -> tuple[dict[str, Any] | None, Any]:  # noqa: ANN401
    """Return the recipe of the outermost layer, None without effect, and the inner environment."""
    name = type(env).__name__
    if isinstance(env, Transformed):
        one = env.transformation
        settings = one.settings()
        if "kind" in settings:
            raise ValueError(
                f"{type(one).__name__} settings(): 'kind': reserved; allowed: another name"
            )
        return {"kind": _kind_of(type(one)), **settings}, env.env
    if isinstance(env, ActionRepeat):
        return {"kind": _REPEAT, "ticks": env.ticks}, env.env
    if name == "OutriderTorchEnv":
        return {"kind": _REPEAT, "ticks": env.repeat}, env.inner
    if name == "VecNormalize" and not env.norm_obs:
        return None, env.venv
    if name == "VecNormalize" and not isinstance(env.obs_rms, dict):
        mean, variance = env.obs_rms.mean.tolist(), env.obs_rms.var.tolist()
        given = {"mean": mean, "variance": variance, "epsilon": env.epsilon, "clip": env.clip_obs}
        return {"kind": "standardized", **given}, env.venv
    if name == "DummyVecEnv":
        return None, env.envs[0]
    for attribute, names in _PASSED.items():
        if name in names:
            return None, getattr(env, attribute)
    raise ValueError(
        f"{name}: cannot be saved with a policy; allowed: Transformed, ActionRepeat, OutriderTorchEnv, VecEnvAdapter, "
        "DummyVecEnv, VecNormalize of rows, and wrappers without effect on observations and actions"
    )


class RepeatedAction:
    """Action that is repeated for a number of ticks.

    Raises:
        ValueError: If `ticks` is not a whole number from 1 to `MOST_TICKS`.
    """

    def __init__(self, ticks: int) -> None:
        self.ticks, self.due, self.last = whole("ticks", ticks, MOST_TICKS), 0, np.zeros((0, 2))


def make_layer(layer: Mapping[str, Any]) -> Transformation | RepeatedAction:
    """Create the layer that a recipe describes.

    Raises:
        ValueError: If the recipe does not describe a layer.
    """
    given = dict(layer)
    kind = given.pop("kind", None)
    try:
        return RepeatedAction(**given) if kind == _REPEAT else _class_of(str(kind))(**given)
    except ScenarioError as error:  # the line names the module and why it cannot be imported
        raise ValueError(f"layer {error}") from error
    except (TypeError, ValueError) as error:
        allowed = ", ".join((*_KINDS, _REPEAT, "module:class"))
        raise ValueError(
            f"layer {kind!r}: {type(error).__name__}: {error}; allowed: {allowed}"
        ) from error
