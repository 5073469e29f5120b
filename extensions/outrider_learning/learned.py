"""Learned UAV policy: its network behind the transformation of its training, called once per tick."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from bus.messages.vehicle import UavBriefing
from bus.numbers import exact
from bus.observations import UAV
from outrider_learning.bounds import MOST_TICKS, SMALLEST, positive, row, whole
from outrider_learning.mlp import Mlp, load_policy
from outrider_learning.policy_inputs import EscortView
from sim.engine.briefing import uav_briefing
from sim.env.observation import AgentObservation, Array
from sim.env.patch import MOST_PIXELS
from sim.scenario.types import Scenario


def check_made_for(name: str, value: float, made: float) -> None:
    """Check a number against the one of the policy's training.

    Raises:
        ValueError: If the numbers differ.
    """
    if not math.isclose(value, made, rel_tol=1e-9, abs_tol=1e-9):
        raise ValueError(f"{name} = {exact(value)}: the policy was trained with {exact(made)}")


def check_altitude(briefing: UavBriefing, *, trained: bool) -> None:
    """Check that a UAV has an altitude if, and only if, the policy was trained with one.

    Raises:
        ValueError: If only one of them has.
    """
    if briefing.altitude is not None and not trained:
        altitude = briefing.altitude.initial_altitude
        raise ValueError(
            f"initial_altitude = {altitude:g} m: the policy was trained in the plane; allowed: none"
        )
    if briefing.altitude is None and trained:
        raise ValueError("initial_altitude: missing; the policy was trained with an altitude")


def check_team(briefing: UavBriefing, *, trained: int) -> None:
    """Check that a UAV's team has as many UAVs as the policy was trained with; 0: none.

    Raises:
        ValueError: If it has another number.
    """
    count = len(briefing.mates)
    if count != trained:
        now, then = (f"a team of {n} UAVs" if n else "no team" for n in (count, trained))
        raise ValueError(f"team: {now}: the policy was trained with {then}")


def make_view(recipe: Mapping[str, Any]) -> EscortView:
    """Return the transformation that a recipe describes, for one environment.

    Raises:
        ValueError: If the recipe is incomplete, or one of its numbers is out of bounds.
    """
    try:
        ticks = whole("repeat", recipe["repeat"], MOST_TICKS)
        step = ticks * positive("dt", recipe["dt"])
        pixels, pixel = row("coverage_patch", recipe["coverage_patch"], SMALLEST, least=2, most=2)
        whole("coverage_patch", int(pixels) if pixels % 1.0 == 0.0 else pixels, MOST_PIXELS)
        return EscortView(step=step, pixel=float(pixel), **recipe["view"])
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"recipe: {type(error).__name__}: {error}; allowed: a recipe of examples/train_uav.py"
        ) from error
    except ValueError as error:
        raise ValueError(f"recipe: {error}") from error


class LearnedPolicy:
    """Policy for one world or for all worlds of a batch, with a memory of each world's episode.

    Call it once per tick with the observation of the environment that `setup` describes: `outrider.vector_env(...,
    **setup)` for a batch, or `outrider.parallel_env(..., **setup)` for a single world. It computes an acceleration
    every `repeat` ticks and holds it in between. An episode starts at time 0. One object serves one environment.

    Args:
        network: Network from the view's observation to the action.
        recipe: Recipe of `examples/train_uav.py`: `coverage_patch`, `dt`, `repeat`, `view`.

    Raises:
        ValueError: If the recipe is incomplete or does not fit the network.
    """

    def __init__(self, network: Mlp, recipe: Mapping[str, Any]) -> None:
        self.recipe = dict(recipe)
        """Recipe of the policy."""
        self._network = network
        self._view = make_view(recipe)
        inputs, outputs = network.weights[0].shape[1], network.weights[-1].shape[0]
        if (inputs, outputs) != (self._view.size, 2):
            raise ValueError(
                f"network: {inputs} inputs, {outputs} outputs; the recipe needs {self._view.size} inputs, 2 outputs"
            )
        pixels, meters = recipe["coverage_patch"]
        self.setup: dict[str, Any] = {
            "estimate": True,
            "omit": (),
            "coverage_patch": (int(pixels), float(meters)),
        }
        """Arguments of the vector environment with the required observations."""
        self._shapes = {"row": (len(UAV),), "coverage": (int(pixels), int(pixels))}
        self._ticks, self._dt = int(recipe["repeat"]), float(recipe["dt"])
        self._last_action: Array = np.zeros((0, 2))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Load a policy from a file.

        Raises:
            ValueError: If the file is missing or is not such a policy; one line.
        """
        network, recipe = load_policy(path)
        try:
            return cls(network, recipe)
        except ValueError as error:
            raise ValueError(f"policy {str(path)!r}: {error}") from error

    def check(self, scenario: Scenario) -> None:
        """Check that the policy supports a scenario.

        Raises:
            ValueError: If `fits` rejects a UAV.
        """
        for uav in scenario.uav:
            try:
                self.fits(uav_briefing(scenario, uav.name, 0))
            except ValueError as error:
                raise ValueError(f"{scenario.name}: {uav.name}: {error}") from error

    def fits(self, briefing: UavBriefing) -> tuple[str, ...]:
        """Check that the policy supports a UAV; there are no warnings.

        Raises:
            ValueError: If the tick length or the UAV's maximum speed differs, or the UAV has an altitude or a team.
        """
        check_altitude(briefing, trained=False)
        check_team(briefing, trained=0)
        v_max = float(self.recipe["view"]["v_max"])
        check_made_for("dt", briefing.dt, self._dt)
        check_made_for("max_speed", briefing.limits.numbers[0], v_max)
        return ()

    def __call__(self, observation: AgentObservation) -> Array:
        """Return the acceleration [m/s²] for one world, shape (2,), or for all, shape (worlds, 2).

        Raises:
            ValueError: If the environment was not created with the policy's `setup`.
        """
        if not isinstance(observation, dict):
            raise ValueError(
                "a learned policy needs the row and the coverage patch: create the environment with its setup"
            )
        if observation["row"].ndim == 1:
            alone: Array = self._act({key: array[None] for key, array in observation.items()})[0]
            return alone
        return self._act(observation)

    def _act(self, observation: dict[str, Array]) -> Array:
        shapes = {key: array.shape[1:] for key, array in observation.items()}
        if shapes != self._shapes:
            raise ValueError(
                f"observations of shapes {shapes}: the policy needs {self._shapes}; create the environment with "
                "its setup"
            )
        tick = np.rint(observation["row"][:, 0] / self._dt).astype(np.int64)
        starting, due = tick == 0, tick % self._ticks == 0
        if self._last_action.shape != (len(tick), 2):
            self._last_action, starting = (
                np.zeros((len(tick), 2)),
                np.ones(len(tick), dtype=np.bool_),
            )
        if starting.any():
            shown = self._view.begin(observation, starting)
        if (due & ~starting).any():
            shown = self._view.update(observation, due & ~starting)
        due |= starting
        if due.any():
            action = np.clip(self._network(shown), -1.0, 1.0)
            self._last_action[due] = self._view.action(action)[due]
        return self._last_action.copy()
