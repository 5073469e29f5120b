"""Driver that runs a policy: a user's function, or a model saved by a learning library."""

import inspect
import logging
import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from agents.asking import LARGEST, AskedPolicy, pair
from agents.drivers.compiled import briefed_grid, update_grid
from agents.drivers.steering import Steering
from agents.drivers.tile_map import OccupancyGrid
from bus.errors import ScenarioError
from bus.messages.vehicle import UgvBriefing, UgvObservation
from bus.observations import Row, clipped, ugv_table
from bus.registry import DEFAULT_KINEMATICS
from sim.models.ground import TileArray, tile_patches
from sim.models.vehicles import next_goal

_LOG = logging.getLogger("outrider.policy")
_ROUNDING = 1e-6
"""Relative excess over the bound that rounding to single precision alone may cause."""


@runtime_checkable
class RowPolicy(Protocol):
    """Policy as learning libraries define it, for the row that the environment gives this agent.

    `predict` may return the action alone or, like Stable-Baselines3, the action and a state. Parameters with these
    names receive: `deterministic` True, `state` the last returned state, `episode_start` a flag, `dt` the tick [s], and
    `perceived` the complete `bus.messages.vehicle.UgvObservation`.
    A policy whose `observation_space` is a dictionary of `row` and `tiles` receives both, as in the environment on
    ground with hazards.
    """

    @property
    def predict(self) -> Callable[..., object]:
        """Map a row of `bus.observations.UGV`, or the row and the tiles, to the acceleration x and y [m/s²]."""


Policy = Callable[[UgvObservation, UgvBriefing], object] | RowPolicy
"""Function that maps a UGV's observation and briefing to its acceleration x and y [m/s²], as a pair, a list or an array
of two numbers; or an object that predicts it from a row.
"""


class UgvRows:
    """Rows that the environment would give this UGV, bit for bit, from its observations.

    Args:
        briefing: Briefing of the UGV.
    """

    def __init__(self, briefing: UgvBriefing) -> None:
        self._goals = np.array(briefing.goals, dtype=np.float64).reshape(-1, 2)
        self._tolerance = float(briefing.goal_tolerance)
        self._reached = 0
        self._area, self._dt = briefing.area, float(briefing.dt)
        self._table = ugv_table(steers=briefing.kinematics != DEFAULT_KINEMATICS)

    def row(self, observation: UgvObservation) -> Row:
        """Return the row of this tick. Shape (entries,), float64."""
        (x, y), (v_x, v_y), goals = observation.position, observation.velocity, self._goals
        self._reached, _ = next_goal(goals, self._reached, self._tolerance, x, y)
        underway, goal_x, goal_y = self._reached < len(goals), 0.0, 0.0
        if len(goals):
            goal_x, goal_y = goals[min(self._reached, len(goals) - 1)].tolist()
        state = observation.time, x, y, v_x, v_y
        heading = observation.heading
        ahead = () if heading is None else (math.cos(heading), math.sin(heading))
        row = np.array((*state, float(underway), goal_x, goal_y, *ahead), dtype=np.float64)
        return clipped(self._table, row, self._area, self._dt)


class UgvTiles:
    """Tile picture that the environment would give this UGV, bit for bit.

    Args:
        briefing: Briefing of the UGV.
        side: Tiles on each side of the picture.
        grid: Occupancy grid of the vehicle, which its pilot updates; None: its own, updated here.
    """

    def __init__(
        self, briefing: UgvBriefing, side: int, *, grid: OccupancyGrid | None = None
    ) -> None:
        self._owns_grid = grid is None
        self._known = briefed_grid(briefing) if grid is None else grid
        self._tile = 0.0 if briefing.ground is None else float(briefing.ground.tile)
        self._picture: TileArray = np.empty((1, side, side), np.uint8)

    def tiles(self, observation: UgvObservation) -> TileArray:
        """Return the picture of this tick. Shape (side, side)."""
        if self._owns_grid:
            update_grid(self._known, observation)
        position = np.array([observation.position], dtype=np.float64)
        tile_patches(self._known.tiles[None], self._tile, position, self._picture)
        around: TileArray = self._picture[0].copy()
        return around


class _Predictor:
    """Row policy of one UGV, with its own progress and state.

    Args:
        model: Policy; several UGVs may share it.
        briefing: Briefing of the UGV.
        grid: As in `UgvTiles`.
    """

    def __init__(self, model: RowPolicy, briefing: UgvBriefing, grid: OccupancyGrid | None) -> None:
        self._predict = model.predict
        self._rows = UgvRows(briefing)
        space = getattr(model, "observation_space", None)
        parts = getattr(space, "spaces", None)
        self._tiles: UgvTiles | None = None
        if isinstance(parts, Mapping) and "tiles" in parts:
            if briefing.ground is None:
                raise ScenarioError("observes tiles, but the scenario has no hazards")
            side = parts["tiles"].shape[0]
            space, self._tiles = parts.get("row"), UgvTiles(briefing, side, grid=grid)
        self._dtype = getattr(space, "dtype", None) or np.float64
        self._known = _parameters(model.predict)
        self._state: object = None
        self._start, self._dt = True, float(briefing.dt)

    def __call__(self, observation: UgvObservation, _briefing: UgvBriefing) -> object:
        row = self._rows.row(observation).astype(self._dtype, copy=False)
        seen = row if self._tiles is None else {"row": row, "tiles": self._tiles.tiles(observation)}
        arguments: dict[str, Any] = {
            "deterministic": True,
            "state": self._state,
            "episode_start": np.array([self._start]),
            "dt": self._dt,
            "perceived": observation,
        }
        self._start = False
        answer = self._predict(
            seen, **{name: arguments[name] for name in arguments.keys() & self._known}
        )
        if isinstance(answer, tuple) and len(answer) == 2 and pair(answer) is None:
            answer, self._state = answer
        return answer


def _parameters(function: Callable[..., object]) -> set[str]:
    try:
        return set(inspect.signature(function).parameters)
    except (TypeError, ValueError):  # not written in Python
        return set()


class PolicyDriver:
    """Driver that calls the policy at each observation.

    The answer of a function is limited to the UGV's bounds: shortened to u_max, and turned so that the speed stays
    within v_max. The answer of a row policy passes unchanged; the simulator applies the bounds of (1), so it moves the
    UGV to the bit as in the environment. The policy keeps its own state: a process that rejoins calls it with all
    observations from the first.

    Args:
        briefing: Briefing of the UGV.
        policy: Function, or object that predicts.
        name: Name of the policy in errors, for example `module:function`.
        grid: As in `UgvTiles`.
    """

    def __init__(
        self,
        briefing: UgvBriefing,
        *,
        policy: Policy,
        name: str,
        grid: OccupancyGrid | None = None,
    ) -> None:
        self._briefing = briefing
        self._steering = Steering(briefing)
        self._sees_rows = isinstance(policy, RowPolicy)
        field = f"policy = {name!r}"
        try:
            asked = _Predictor(policy, briefing, grid) if isinstance(policy, RowPolicy) else policy
        except ScenarioError as error:
            raise ScenarioError(f"{field}: {error}") from error
        self._asked = AskedPolicy(asked, field, self._steering.dt)
        self._long = False

    def drive(self, observation: UgvObservation) -> tuple[float, float]:
        """Return the acceleration [m/s²] for this observation.

        Raises:
            ScenarioError: If the policy raises, or does not return two finite numbers; one line with its name, the tick
                and the answer.
        """
        tick = observation.tick
        answer = self._asked.answer(tick, observation, self._briefing)
        found = pair(answer)
        if found is None or (self._sees_rows and max(map(abs, found)) > LARGEST):
            allowed = "two finite numbers, the acceleration x and y [m/s²]"
            raise self._asked.invalid_answer(tick, answer, allowed)
        if self._sees_rows:
            return found
        self._check_bound(tick, max(map(abs, found)))
        return self._steering.within(observation, found)

    def _check_bound(self, tick: int, size: float) -> None:
        """Warn once if a component exceeds the UGV's acceleration bound: its units may be wrong.

        Every action of the environment's space, a square around the bound of (1), is below.
        """
        bound = self._steering.u_max
        if not self._long and size > bound * (1.0 + _ROUNDING):
            self._long = True
            _LOG.warning(
                "%s: returned %.4g m/s², above the UGV's bound of %.4g m/s², and is shortened; "
                "further cases are not reported",
                self._asked.where(tick),
                size,
                bound,
            )
