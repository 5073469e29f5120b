"""UAV policy saved by a learning library, with its training observation.

A JSON file beside the policy's own describes the observation: settings of the environment, and the transformations from
the inside out. `save_sb3_policy` writes both; `--uav-policy sb3:ppo:model.zip` flies them.
"""

import copy
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Protocol, Self

import msgspec
import numpy as np
from gymnasium import spaces

from bus.errors import ScenarioError, shortened
from bus.files import read_regular, writing
from bus.messages.vehicle import UavBriefing
from bus.numbers import exact
from bus.observations import ROUNDING, UAV, by_name, largest, names, without
from bus.policies import policy_forms
from outrider_learning.learned import check_altitude, check_made_for, check_team
from outrider_learning.recipe import (
    ObservationRecipe,
    RepeatedAction,
    checked_recipe,
    make_layer,
    observation_recipe,
)
from outrider_learning.transformation import Transformation
from outrider_learning.ugv_policies import load_sb3_model
from sim.engine.briefing import uav_briefing
from sim.env.observation import AgentObservation, Array, uav_table
from sim.scenario.types import Scenario

_MOST_BYTES = 1 << 20


class Model(Protocol):
    """Policy interface of Stable-Baselines3."""

    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]

    def predict(
        self,
        observation: AgentObservation,
        state: object,
        episode_start: Array,
        deterministic: bool,
    ) -> tuple[Array, object]:
        """Return the actions of all worlds, and a state."""


def recipe_file(file: str | Path) -> Path:
    """Return the path of a policy's recipe: `model.json` beside `model.zip`."""
    return Path(file).with_suffix(".json")


def save_sb3_policy(model: Any, file: str | Path) -> None:  # noqa: ANN401 - the library's
    """Save a Stable-Baselines3 model, `model.zip`, and its recipe, `model.json`.

    Raises:
        ValueError: If `observation_recipe` rejects the model's environment; then nothing is saved.
    """
    recipe = observation_recipe(model.get_env())
    model.save(file)
    written = recipe_file(file)
    with writing(written):
        written.write_bytes(msgspec.json.format(msgspec.json.encode(recipe), indent=1))


class SavedPolicy:
    """Model behind its training observation, for one world or for all worlds of a batch.

    Call it once per tick with the observations of all worlds that `setup` describes. With a `repeat` layer, all worlds
    must start at the same time.

    Args:
        model: Trained model.
        recipe: Recipe of its observation.

    Raises:
        ValueError: If the model does not fit the recipe, or its action is not an acceleration.
    """

    def __init__(self, model: Model, recipe: ObservationRecipe) -> None:
        self._model, self._recipe = model, recipe
        self._layers = [make_layer(layer) for layer in recipe.layers]
        space, axes = recipe.space(), recipe.actions
        whole = uav_table(altitude=recipe.altitude, gradient=recipe.gradient, mates=recipe.mates)
        kept = names(without(whole, recipe.omit))
        self._columns = [k for k, name in enumerate(names(whole)) if name in kept]
        self._ages = [k for k, name in enumerate(names(whole)) if "age" in name.split("_")]
        # The policy drops the entries itself: it needs the time to recognize the start of an episode.
        self._shapes = _shapes(msgspec.structs.replace(recipe, omit=()).space())
        for layer in self._layers:
            if isinstance(layer, Transformation):
                space = layer.space(space)
                layer.action_space(spaces.Box(-1.0, 1.0, (axes,), np.float64))
        made, done = _shapes(model.observation_space), getattr(model.action_space, "shape", None)
        if made != _shapes(space) or done != (axes,):
            raise ValueError(
                f"model: observations of shape {made} and actions of shape {done}; "
                f"the recipe gives {_shapes(space)} and ({axes},)"
            )
        self.setup: dict[str, Any] = {
            "estimate": recipe.estimate,
            "gradient": recipe.gradient,
            "omit": (),
            "coverage_patch": recipe.coverage_patch,
            "dtype": np.dtype(recipe.dtype).type,
            "duration": recipe.length,
            "roles": recipe.roles,
        }
        """Settings of the environment with the required observations, and the length of its episodes [s]."""
        self._state: Any = None
        self._worlds = 0
        self._flown: float | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return a policy for another UAV with the same model and a memory of its own."""
        return type(self)(self._model, copy.copy(self._recipe))

    def fits(self, briefing: UavBriefing) -> tuple[str, ...]:
        """Check that the policy supports a UAV.

        Returns:
            Warnings if the area is larger or the UAV may fly higher than in training.

        Raises:
            ValueError: If the tick length, the UAV's maximum speed or its maximum climb rate differs, or if it was
                trained without an altitude, or with one that this UAV lacks, or in a team of another size.
        """
        made, area, high = self._recipe.extent, briefing.area, briefing.altitude
        check_altitude(briefing, trained=self._recipe.altitude)
        check_team(briefing, trained=self._recipe.mates)
        if self._recipe.dt is not None:
            check_made_for("dt", briefing.dt, self._recipe.dt)
        most = largest(area, briefing.dt)["v_max"]
        check_made_for("max_speed", min(briefing.limits.numbers[0], most), made["v_max"])
        warnings, (width, height) = [], (made["W"], made["H"])
        if area.width > width or area.height > height:
            warnings.append(
                f"area = {exact(area.width)} m x {exact(area.height)} m: larger than the {exact(width)} m x "
                f"{exact(height)} m of the policy's training; it may observe positions outside its training range"
            )
        if high is not None:
            check_made_for("max_climb_rate", high.max_climb_rate, made["w_max"])
            if high.max_altitude > made["z_max"]:
                warnings.append(
                    f"max_altitude = {exact(high.max_altitude)} m: higher than the {exact(made['z_max'])} m of "
                    "the policy's training; it may observe altitudes outside its training range"
                )
        return tuple(warnings)

    def check(self, scenario: Scenario) -> None:
        """Check that the policy supports a scenario, whose worlds it will control.

        Raises:
            ValueError: If `fits` rejects a UAV.
        """
        for uav in scenario.uav:
            try:
                self.fits(uav_briefing(scenario, uav.name, 0))
            except ValueError as error:
                raise ValueError(f"{scenario.name}: {uav.name}: {error}") from error
        self._flown = scenario.ticks * scenario.dt

    def __call__(self, observation: AgentObservation) -> Array:
        """Return the accelerations [m/s²] of all worlds. Shape (worlds, 2), or (worlds, 3) with an altitude.

        Raises:
            ValueError: If the environment was not created with the policy's `setup`, or a `repeat` layer meets worlds
                that start at different times.
        """
        shapes = (
            {key: array.shape[1:] for key, array in observation.items()}
            if isinstance(observation, dict)
            else observation.shape[1:]
        )
        if shapes != self._shapes:
            raise ValueError(
                f"observations of shape {shapes}: the policy needs {self._shapes}; create the environment with "
                "its setup"
            )
        row = observation["row"] if isinstance(observation, dict) else observation
        starting = row[:, _TIME] == 0.0
        if len(row) != self._worlds:
            self._worlds, starting = len(row), np.ones(len(row), dtype=np.bool_)
        if self._flown is not None and self._flown != self._recipe.length:
            row = row.copy()
            ages = row[:, self._ages]
            row[:, self._ages] = np.where(ages == self._flown, self._recipe.length, ages)
        time, row = float(row[:, _TIME].max()), row[:, self._columns]
        shown = observation | {"row": row} if isinstance(observation, dict) else row
        return self._act(0, shown, starting, time)

    def _act(
        self, depth: int, observation: AgentObservation, starting: Array, time: float
    ) -> Array:
        """Return the actions of the layers from this depth on, from the inside out."""
        if depth == len(self._layers):
            actions, self._state = self._model.predict(
                observation, state=self._state, episode_start=starting, deterministic=True
            )
            return np.asarray(actions, dtype=np.float64)
        layer = self._layers[depth]
        if isinstance(layer, RepeatedAction):
            return self._repeat(layer, depth, observation, starting, time)
        shown = observation if starting.all() else layer.apply(observation)
        if starting.any():
            shown = layer.begin(observation, starting)
        action: Array = layer.action(self._act(depth + 1, shown, starting, time))
        return action

    def _repeat(
        self,
        layer: RepeatedAction,
        depth: int,
        observation: AgentObservation,
        starting: Array,
        time: float,
    ) -> Array:
        if starting.any() and not starting.all():
            raise ValueError(
                "worlds start at different times: a policy with a repeated action needs a common start"
            )
        tick = round(time / (self._recipe.dt or 1.0))
        if starting.all() or tick >= layer.due:
            layer.due = tick - tick % layer.ticks + layer.ticks
            layer.last = self._act(depth + 1, observation, starting, time)
        return layer.last.copy()


_TIME = names(UAV).index("time")


def _shapes(space: spaces.Space[Any]) -> Any:  # noqa: ANN401
    """Return the shape of a space, or the shapes by key."""
    parts = getattr(space, "spaces", None)
    if isinstance(parts, Mapping):
        return {key: part.shape for key, part in parts.items()}
    return space.shape


def _plain_row(space: spaces.Space[Any]) -> ObservationRecipe | None:
    """Return the recipe of a policy on the environment's own row, recognized by its bounds; None otherwise."""
    low, high = getattr(space, "low", None), getattr(space, "high", None)
    if space.shape != (len(UAV),) or low is None or high is None:
        return None
    at = by_name(UAV, high.astype(np.float64))
    extent = {"T": at["time"], "W": at["x"], "H": at["y"], "v_max": at["vx"]}
    diagonal = math.hypot(at["x"], at["y"]) * ROUNDING
    extent |= {"d_max": at["relative_x"], "D": diagonal}
    dtype: Literal["float32", "float64"] = "float32" if space.dtype == np.float32 else "float64"
    detected, estimated = (
        ObservationRecipe(extent=extent, dtype=dtype, estimate=estimate).space()
        for estimate in (False, True)
    )
    # The diagonal bounds an estimate as well as a detection with unbounded noise: ambiguous.
    if space != detected or space == estimated:
        return None
    return ObservationRecipe(extent=extent, dtype=dtype)


def load_sb3_policy(rest: str, where: str) -> SavedPolicy:
    """Load `ALGORITHM:FILE.zip` for `custom.uav_policy`.

    Without a recipe file the model must observe the environment's own row, in SI units.

    Args:
        rest: Algorithm and file.
        where: Field and value, for errors.

    Raises:
        ScenarioError: If the model cannot be loaded, or its observation is unknown or does not fit.
    """
    model: Model = load_sb3_model(rest, where, policy_forms("uav"))
    beside = recipe_file(rest.partition(":")[2])
    try:
        recipe = checked_recipe(
            msgspec.json.decode(read_regular(beside, _MOST_BYTES), type=ObservationRecipe)
        )
    except FileNotFoundError:
        found = _plain_row(model.observation_space)
        if found is None:
            raise ScenarioError(
                f"{where}: observations of shape {_shapes(model.observation_space)} are not the UAV's row in SI units, "
                f"and {beside} is missing; allowed: policies saved by "
                "outrider_learning.saved.save_sb3_policy"
            ) from None
        recipe = found
    except Exception as error:
        raise ScenarioError(f"{where}: {beside}: {shortened(str(error))}") from error
    try:
        return SavedPolicy(model, recipe)
    except Exception as error:
        raise ScenarioError(f"{where}: {beside}: {shortened(str(error))}") from error
