"""A UAV's policy that a learning library has saved, with the observation that it was trained on.

The observation is a JSON file beside the policy's own: the settings of the environment, and the transformations around
it, from the inside out. `save_sb3_policy` writes both; `custom.uav_policy=sb3:ppo:model.zip` flies them.
"""

import copy
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, Self

import msgspec
import numpy as np
from gymnasium import spaces

from bus.errors import ScenarioError
from bus.files import read_regular, writing
from bus.messages.vehicle import UavBriefing
from bus.observations import ROUNDING, UAV, by_name, largest, names
from bus.policies import policy_forms
from outrider_learning.learned import check_made_for
from outrider_learning.recipe import (
    NEEDED,
    HeldAction,
    ObservationRecipe,
    make_layer,
    observation_recipe,
)
from outrider_learning.transformation import Transformation
from outrider_learning.ugv_policies import load_sb3_model
from sim.engine.briefing import uav_briefing
from sim.env.observation import AgentObservation, Array
from sim.scenario.types import Scenario

_MOST_BYTES = 1 << 20


class Model(Protocol):
    """A policy as Stable-Baselines3 makes it."""

    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]

    def predict(
        self,
        observation: AgentObservation,
        state: object,
        episode_start: Array,
        deterministic: bool,
    ) -> tuple[Array, object]:
        """Actions of all worlds, and a state."""


def recipe_file(file: str | Path) -> Path:
    """The file beside a policy's that says what it observes: `model.json` beside `model.zip`."""
    return Path(file).with_suffix(".json")


def save_sb3_policy(model: Any, file: str | Path) -> None:  # noqa: ANN401 - the library's
    """Save a model of Stable-Baselines3, `model.zip`, and what it observes, `model.json` beside it.

    Raises:
        ValueError: As `observation_recipe`, of the model's environment; nothing is saved then.
    """
    recipe = observation_recipe(model.get_env())
    model.save(file)
    written = recipe_file(file)
    with writing(written):
        written.write_bytes(msgspec.json.format(msgspec.json.encode(recipe), indent=1))


class SavedPolicy:
    """A model behind the very observation that it was trained on, for one world or for all of a batch.

    Call it once a tick with the observations of all worlds, as `setup` says. With a `repeat` among its layers all
    worlds must begin at the same time.

    Args:
        model: The model.
        recipe: Its observation.

    Raises:
        ValueError: If the model observes something else than the recipe says, or answers no acceleration.
    """

    def __init__(self, model: Model, recipe: ObservationRecipe) -> None:
        self._model, self._recipe = model, recipe
        self._layers = [make_layer(layer) for layer in recipe.layers]
        space = recipe.space()
        self._shapes = _shapes(space)
        for layer in self._layers:
            if isinstance(layer, Transformation):
                space = layer.space(space)
                layer.action_space(spaces.Box(-1.0, 1.0, (2,), np.float64))
        made, done = _shapes(model.observation_space), getattr(model.action_space, "shape", None)
        if made != _shapes(space) or done != (2,):
            raise ValueError(
                f"the model is made for observations of shape {made} and actions of shape {done}, and what it would "
                f"be given is of shape {_shapes(space)} and (2,)"
            )
        self.setup: dict[str, Any] = {
            "estimate": recipe.estimate,
            "gradient": recipe.gradient,
            "coverage_patch": recipe.coverage_patch,
            "dtype": np.dtype(recipe.dtype).type,
            "duration": recipe.length,
        }
        """Settings of the environment whose observations it needs, and the length of its episodes [s]."""
        self._state: Any = None
        self._worlds = 0
        self._flown: float | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Another one for another UAV: the model is the same, what is remembered is its own."""
        return type(self)(self._model, copy.copy(self._recipe))

    def fits(self, briefing: UavBriefing) -> tuple[str, ...]:
        """Hold it against a UAV.

        Returns:
            A warning where the ground is larger than what it was trained on.

        Raises:
            ValueError: If ticks are of another length, or the UAV has another largest speed.
        """
        made, area = self._recipe.extent, briefing.area
        if self._recipe.dt is not None:
            check_made_for("dt", briefing.dt, self._recipe.dt)
        most = largest(area, briefing.dt)["v_max"]
        check_made_for("max_speed", min(briefing.limits.numbers[0], most), made["v_max"])
        width, height = made["W"], made["H"]
        if area.width > width or area.height > height:
            return (
                f"made for ground of {width:g} m x {height:g} m, and this is {area.width:g} m x {area.height:g} m: "
                "it may observe positions that its training never had",
            )
        return ()

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario that it was not made for; a batch of whose worlds it will fly.

        Raises:
            ValueError: As `fits`.
        """
        for uav in scenario.uav:
            try:
                self.fits(uav_briefing(scenario, uav.name, 0))
            except ValueError as error:
                raise ValueError(f"{scenario.name}: {uav.name}: {error}") from error
        self._flown = scenario.ticks * scenario.dt

    def __call__(self, observation: AgentObservation) -> Array:
        """The accelerations [m/s²] of all worlds for this tick's observations. Shape (worlds, 2).

        Raises:
            ValueError: If these are of an environment that was not made with its `setup`, or worlds begin at
                different times that must not.
        """
        shapes = (
            {key: array.shape[1:] for key, array in observation.items()}
            if isinstance(observation, dict)
            else observation.shape[1:]
        )
        if shapes != self._shapes:
            raise ValueError(
                f"observations of shape {shapes}: the policy is made for {self._shapes}; make the environment with "
                "its setup"
            )
        row = observation["row"] if isinstance(observation, dict) else observation
        begun = row[:, _TIME] == 0.0
        if len(row) != self._worlds:
            self._worlds, begun = len(row), np.ones(len(row), dtype=np.bool_)
        if self._flown is not None and self._flown != self._recipe.length:
            row = row.copy()
            row[row[:, _AGE] == self._flown, _AGE] = self._recipe.length
            observation = observation | {"row": row} if isinstance(observation, dict) else row
        return self._act(0, observation, begun, float(row[:, _TIME].max()))

    def _act(self, depth: int, seen: AgentObservation, begun: Array, time: float) -> Array:
        """The actions of the layers from this depth on, from the inside out."""
        if depth == len(self._layers):
            actions, self._state = self._model.predict(
                seen, state=self._state, episode_start=begun, deterministic=True
            )
            return np.asarray(actions, dtype=np.float64)
        layer = self._layers[depth]
        if isinstance(layer, HeldAction):
            return self._hold(layer, depth, seen, begun, time)
        shown = seen if begun.all() else layer.apply(seen)
        if begun.any():
            shown = layer.begin(seen, begun)
        action: Array = layer.action(self._act(depth + 1, shown, begun, time))
        return action

    def _hold(
        self, layer: HeldAction, depth: int, seen: AgentObservation, begun: Array, time: float
    ) -> Array:
        if begun.any() and not begun.all():
            raise ValueError(
                "worlds begin at different times: a policy with a repeated action flies worlds that do not"
            )
        tick = round(time / (self._recipe.dt or 1.0))
        if begun.all() or tick >= layer.due:
            layer.due = tick - tick % layer.ticks + layer.ticks
            layer.held = self._act(depth + 1, seen, begun, time)
        return layer.held.copy()


_TIME, _AGE = names(UAV).index("time"), names(UAV).index("age")


def _shapes(space: spaces.Space[Any]) -> Any:  # noqa: ANN401
    """The shapes of a space: of one array, or by key."""
    parts = getattr(space, "spaces", None)
    if isinstance(parts, Mapping):
        return {key: part.shape for key, part in parts.items()}
    return space.shape


def _plain_row(space: spaces.Space[Any]) -> ObservationRecipe | None:
    """The recipe of a policy that observes the environment's own row, to be seen from its bounds; None: of another."""
    low, high = getattr(space, "low", None), getattr(space, "high", None)
    if space.shape != (len(UAV),) or low is None or high is None:
        return None
    at = by_name(UAV, high.astype(np.float64))
    extent = {"T": at["time"], "W": at["x"], "H": at["y"], "v_max": at["vx"]}
    diagonal = math.hypot(at["x"], at["y"]) * ROUNDING
    extent |= {"d_max": at["relative_x"], "D": diagonal}
    dtype = np.dtype(space.dtype).name
    detected, estimated = (
        ObservationRecipe(extent=extent, dtype=dtype, estimate=estimate).space()
        for estimate in (False, True)
    )
    # An estimate is bounded by the diagonal, and so is a detection whose noise has no bound: both are possible.
    if space != detected or space == estimated:
        return None
    return ObservationRecipe(extent=extent, dtype=dtype)


def load_sb3_policy(rest: str, where: str) -> SavedPolicy:
    """`ALGORITHM:FILE.zip`, for `custom.uav_policy`.

    Without the file beside it the model must observe the environment's own row, in SI units.

    Args:
        rest: The algorithm and the file.
        where: Field and value, for errors.

    Raises:
        ScenarioError: If it cannot be loaded, or it is not known what it observes, or it observes something else.
    """
    model: Model = load_sb3_model(rest, where, policy_forms("uav"))
    beside = recipe_file(rest.partition(":")[2])
    try:
        recipe = msgspec.json.decode(read_regular(beside, _MOST_BYTES), type=ObservationRecipe)
        if missing := NEEDED - recipe.extent.keys():
            raise ValueError(f"extent: lacks {', '.join(sorted(missing))}")
    except FileNotFoundError:
        found = _plain_row(model.observation_space)
        if found is None:
            raise ScenarioError(
                f"{where}: made for observations of shape {_shapes(model.observation_space)} that are not the UAV's "
                f"row in SI units, and no {beside} says which; allowed: a policy of "
                "outrider_learning.saved.save_sb3_policy"
            ) from None
        recipe = found
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{where}: {beside}: {error}") from error
    try:
        return SavedPolicy(model, recipe)
    except (ValueError, TypeError) as error:
        raise ScenarioError(f"{where}: {error}") from error
