"""Any policy at the wheel: a function of the user's own, or what a learning library has saved."""

import inspect
import logging
import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from agents.asking import LARGEST, AskedPolicy, pair
from agents.drivers.compiled import take_ground, told_ground
from agents.drivers.steering import Steering
from bus.errors import ScenarioError
from bus.messages.vehicle import UgvBriefing, UgvObservation
from bus.observations import UGV, Row, clipped
from sim.models.ground import TileArray, tile_patches
from sim.models.vehicles import next_goal

_LOG = logging.getLogger("outrider.policy")
_ROUNDING = 1e-9
"""So much longer, as a share, an answer may be by rounding alone."""


@runtime_checkable
class RowPolicy(Protocol):
    """A policy as learning libraries make them, for the row that the environment gives this agent.

    `predict` may return the action alone or, as Stable-Baselines3 does, the action and a state. Where it has
    parameters of these names it is given `deterministic=True`, the `state` that it returned last, `episode_start`,
    `dt` [s], and all that the UGV perceives as `perceived`, a `bus.messages.vehicle.UgvObservation`.
    Where it has an `observation_space` that is a dictionary of `row` and `tiles`, it is given both, as the environment
    gives them on ground with hazards.
    """

    @property
    def predict(self) -> Callable[..., object]:
        """A row of `bus.observations.UGV` in, or the row and the tiles; the acceleration x and y [m/s²] out."""


Policy = Callable[[UgvObservation, UgvBriefing], object] | RowPolicy
"""A function: what a UGV perceives and was told in, its acceleration x and y [m/s²] out, as a pair, a list or an array
of two numbers. Or an object that predicts it from a row.
"""


class UgvRows:
    """The rows that the environment would give this UGV, to the bit, from what it perceives at each tick.

    Args:
        briefing: What the UGV is told when it joins.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        self._goals = np.array(briefing.goals, dtype=np.float64).reshape(-1, 2)
        self._tolerance = float(briefing.goal_tolerance)
        self._reached = 0
        self._area, self._dt = briefing.area, float(briefing.dt)

    def row(self, observation: UgvObservation) -> Row:
        """The row of this tick; shape (8,), float64."""
        (x, y), (v_x, v_y), goals = observation.position, observation.velocity, self._goals
        self._reached, _ = next_goal(goals, self._reached, self._tolerance, x, y)
        underway, goal_x, goal_y = self._reached < len(goals), 0.0, 0.0
        if len(goals):
            goal_x, goal_y = goals[min(self._reached, len(goals) - 1)].tolist()
        motion = observation.time, x, y, v_x, v_y
        row = np.array((*motion, float(underway), goal_x, goal_y), dtype=np.float64)
        return clipped(UGV, row, self._area, self._dt)


class UgvTiles:
    """The picture of the ground that the environment would give this UGV, to the bit.

    Args:
        briefing: What the UGV is told when it joins.
        side: Tiles on each side of the picture.
    """

    def __init__(self, briefing: UgvBriefing, side: int) -> None:
        self._known = told_ground(briefing)
        self._tile = 0.0 if briefing.ground is None else float(briefing.ground.tile)
        self._picture: TileArray = np.empty((1, side, side), np.uint8)

    def tiles(self, observation: UgvObservation) -> TileArray:
        """The picture of this tick. Shape (side, side)."""
        take_ground(self._known, observation)
        position = np.array([observation.position], dtype=np.float64)
        tile_patches(self._known.tiles[None], self._tile, position, self._picture)
        around: TileArray = self._picture[0].copy()
        return around


class _Predictor:
    """One UGV's use of a policy that sees rows: what was reached and what is remembered is its own.

    Args:
        model: The policy; several UGVs may share it.
        briefing: What the UGV is told when it joins.
    """

    def __init__(self, model: RowPolicy, briefing: UgvBriefing) -> None:
        self._predict = model.predict
        self._rows = UgvRows(briefing)
        space = getattr(model, "observation_space", None)
        parts = getattr(space, "spaces", None)
        self._tiles: UgvTiles | None = None
        if isinstance(parts, Mapping) and "tiles" in parts:
            if briefing.ground is None:
                raise ScenarioError("it observes tiles, and the scenario has no hazards")
            space, self._tiles = parts.get("row"), UgvTiles(briefing, parts["tiles"].shape[0])
        self._dtype = getattr(space, "dtype", None) or np.float64
        self._known = _parameters(model.predict)
        self._state: object = None
        self._start, self._dt = True, float(briefing.dt)

    def __call__(self, observation: UgvObservation, _briefing: UgvBriefing) -> object:
        row = self._rows.row(observation).astype(self._dtype, copy=False)
        seen = row if self._tiles is None else {"row": row, "tiles": self._tiles.tiles(observation)}
        told: dict[str, Any] = {
            "deterministic": True,
            "state": self._state,
            "episode_start": np.array([self._start]),
            "dt": self._dt,
            "perceived": observation,
        }
        self._start = False
        answer = self._predict(seen, **{name: told[name] for name in told.keys() & self._known})
        if isinstance(answer, tuple) and len(answer) == 2 and pair(answer) is None:
            answer, self._state = answer
        return answer


def _parameters(function: Callable[..., object]) -> set[str]:
    try:
        return set(inspect.signature(function).parameters)
    except (TypeError, ValueError):  # one that is not written in Python
        return set()


class PolicyDriver:
    """Asks the policy at each observation.

    What a function answers is kept within the UGV's bounds: longer than u_max it is shortened, and where it would go
    beyond v_max it is turned off there. What was predicted from a row is passed on as it is, and the bounds of (1) act
    on it in the world, so it moves the UGV here to the bit as it does in the environment. What the policy remembers is
    its own affair: a process that joins again calls it with all observations from the first.

    Args:
        briefing: What the UGV is told when it joins.
        policy: The function, or the object that predicts.
        name: What it is called in errors, as `module:function`.
    """

    def __init__(self, briefing: UgvBriefing, *, policy: Policy, name: str) -> None:
        self._briefing = briefing
        self._steering = Steering(briefing)
        self._sees_rows = isinstance(policy, RowPolicy)
        field = f"policy = {name!r}"
        try:
            asked = _Predictor(policy, briefing) if isinstance(policy, RowPolicy) else policy
        except ScenarioError as error:
            raise ScenarioError(f"{field}: {error}") from error
        self._asked = AskedPolicy(asked, field, self._steering.dt)
        self._long = False

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """The acceleration [m/s²] for this observation.

        Raises:
            ScenarioError: If the policy raises, or answers anything but two finite numbers; one line with its
                name, the tick and the answer.
        """
        tick = observation.tick
        answer = self._asked.answer(tick, observation, self._briefing)
        found = pair(answer)
        if found is None or (self._sees_rows and max(map(abs, found)) > LARGEST):
            allowed = "two finite numbers, the acceleration x and y [m/s²]"
            raise self._asked.nonsense(tick, answer, allowed)
        if self._sees_rows:
            return found
        self._check_bound(tick, math.hypot(*found))
        return self._steering.within(observation, found)

    def _check_bound(self, tick: int, size: float) -> None:
        """Say once that an answer is longer than the UGV can accelerate: its units may be wrong."""
        bound = self._steering.u_max
        if not self._long and size > bound * (1.0 + _ROUNDING):
            self._long = True
            _LOG.warning(
                "%s: returned %.4g m/s², longer than the UGV's bound %.4g m/s², to which it is shortened; "
                "more of these are not told",
                self._asked.where(tick),
                size,
                bound,
            )
