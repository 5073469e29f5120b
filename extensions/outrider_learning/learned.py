"""A learned UAV that flies: its network behind the very transformation that it was trained with, called once a tick."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from bus.errors import ScenarioError
from bus.messages.vehicle import UavBriefing
from bus.observations import UAV
from outrider_learning.mlp import Mlp, load_policy
from outrider_learning.policy_inputs import EscortView
from sim.engine.briefing import uav_briefing
from sim.env.observation import AgentObservation, Array
from sim.scenario.types import Scenario


def check_made_for(name: str, value: float, made: float) -> None:
    """Refuse a number that a policy was not made for.

    Raises:
        ValueError: If it is another.
    """
    if not math.isclose(value, made, rel_tol=1e-9, abs_tol=1e-9):
        raise ValueError(f"{name} = {value:g}: the policy is made for {made:g}")


def make_view(recipe: Mapping[str, Any]) -> EscortView:
    """The transformation that a recipe describes, for one environment.

    Raises:
        ValueError: If the recipe lacks something.
    """
    try:
        pixel = float(recipe["coverage_patch"][1])
        return EscortView(step=recipe["repeat"] * recipe["dt"], pixel=pixel, **recipe["view"])
    except (KeyError, IndexError, TypeError) as error:
        raise ValueError(
            f"recipe: {type(error).__name__}: {error}; allowed: one of examples/train_uav.py"
        ) from error


class LearnedPolicy:
    """A policy for one world or for all worlds of a batch at once; it remembers each world's episode.

    Call it once a tick with the observation of the environment that `setup` describes: of `outrider.vector_env(...,
    **setup)` where it is one of the others, of `outrider.parallel_env(..., **setup)` where it flies a single world. It
    answers every `repeat` ticks and holds that acceleration in between. An episode begins where the time is 0. One
    object serves one environment.

    Args:
        network: From what the view shows to the action.
        recipe: As `examples/train_uav.py` writes it: `coverage_patch`, `dt`, `repeat`, `view`.

    Raises:
        ValueError: If the recipe lacks something or does not fit the network.
    """

    def __init__(self, network: Mlp, recipe: Mapping[str, Any]) -> None:
        self.recipe = dict(recipe)
        """The way it was made."""
        self._network = network
        self._view = make_view(recipe)
        inputs, outputs = network.weights[0].shape[1], network.weights[-1].shape[0]
        if (inputs, outputs) != (self._view.size, 2):
            raise ValueError(
                f"network from {inputs} to {outputs} numbers: the recipe's view needs {self._view.size} to 2"
            )
        pixels, meters = recipe["coverage_patch"]
        for name, value, whole in (
            ("repeat", recipe["repeat"], True),
            ("coverage_patch", pixels, True),
            ("coverage_patch", meters, False),
            ("dt", recipe["dt"], False),
            ("view.lag", recipe["view"]["lag"], True),
        ):
            allowed, kind = (int, "whole number") if whole else (int | float, "number")
            if not (isinstance(value, allowed) and 0 < value < math.inf):
                raise ValueError(f"recipe: {name} = {value!r}; allowed: a positive {kind}")
        self.setup: dict[str, Any] = {
            "estimate": True,
            "coverage_patch": (int(pixels), float(meters)),
        }
        """Arguments for the vector environment whose observations it needs."""
        self._shapes = {"row": (len(UAV),), "coverage": (int(pixels), int(pixels))}
        self._ticks, self._dt = int(recipe["repeat"]), float(recipe["dt"])
        self._held: Array = np.zeros((0, 2))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The policy of a file.

        Raises:
            ValueError: If the file is not there, or no such policy; one line.
        """
        network, recipe = load_policy(path)
        try:
            return cls(network, recipe)
        except ValueError as error:
            raise ValueError(f"policy {str(path)!r}: {error}") from error

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario that it was not made for.

        Raises:
            ValueError: If ticks are of another length, or a UAV has another largest speed.
        """
        for uav in scenario.uav:
            try:
                self.fits(uav_briefing(scenario, uav.name, 0))
            except ValueError as error:
                raise ValueError(f"{scenario.name}: {uav.name}: {error}") from error

    def fits(self, briefing: UavBriefing) -> tuple[str, ...]:
        """Refuse a UAV that it was not made for; there are no warnings.

        Raises:
            ValueError: If ticks are of another length, or the UAV has another largest speed.
        """
        v_max = float(self.recipe["view"]["v_max"])
        check_made_for("dt", briefing.dt, self._dt)
        check_made_for("max_speed", briefing.limits.numbers[0], v_max)
        return ()

    def __call__(self, observation: AgentObservation) -> Array:
        """The acceleration [m/s²] for this tick's observation, of one world (2,) or of all (worlds, 2).

        Raises:
            ValueError: If the observation is of an environment that was not made with its `setup`.
        """
        if not isinstance(observation, dict):
            raise ValueError(
                "a learned policy needs the row and the coverage patch: make the environment with its setup"
            )
        if observation["row"].ndim == 1:
            alone: Array = self._act({key: array[None] for key, array in observation.items()})[0]
            return alone
        return self._act(observation)

    def _act(self, observation: dict[str, Array]) -> Array:
        shapes = {key: array.shape[1:] for key, array in observation.items()}
        if shapes != self._shapes:
            raise ValueError(
                f"observations of shapes {shapes}: the policy is made for {self._shapes}; make the environment with "
                "its setup"
            )
        tick = np.rint(observation["row"][:, 0] / self._dt).astype(np.int64)
        begun, due = tick == 0, tick % self._ticks == 0
        if self._held.shape != (len(tick), 2):
            self._held, begun = np.zeros((len(tick), 2)), np.ones(len(tick), dtype=np.bool_)
        if begun.any():
            shown = self._view.begin(observation, begun)
        if (due & ~begun).any():
            shown = self._view.see(observation, due & ~begun)
        due |= begun
        if due.any():
            action = np.clip(self._network(shown), -1.0, 1.0)
            self._held[due] = self._view.action(action)[due]
        return self._held.copy()


def load_learned_policy(rest: str, where: str) -> LearnedPolicy:
    """`FILE.npz`, for `custom.uav_policy`; `where` is the field and its value, for errors.

    Raises:
        ScenarioError: If the file is not there, or no such policy.
    """
    try:
        return LearnedPolicy.load(rest)
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from error
