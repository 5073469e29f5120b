"""Wrappers for the environment: what an agent may compute from its own row, put into that row."""

from collections.abc import Mapping
from typing import Any, cast

import msgspec
import numpy as np
from gymnasium import spaces
from pettingzoo.utils import BaseParallelWrapper  # type: ignore[import-untyped]

from agents.control.visibility import SafetyFilter
from agents.estimation.estimator import RelativeEstimator, estimator_of
from bus.messages import UavBriefing, UavObservation
from bus.observations import UAV, Row, names, uav_observation
from bus.ticks import looks_of

_DETECTED = names(UAV).index("detected")
_RELATIVE = [_DETECTED + 1, _DETECTED + 2]


def _briefings(env: Any) -> dict[str, UavBriefing]:  # noqa: ANN401 - PettingZoo has no types
    told = {agent: env.unwrapped.briefing(agent) for agent in env.possible_agents}
    return {agent: one for agent, one in told.items() if isinstance(one, UavBriefing)}


def _row_box(space: object) -> spaces.Box | None:
    row = space.spaces.get("row") if isinstance(space, spaces.Dict) else space
    return row if isinstance(row, spaces.Box) else None


def _check_rows(wrapper: str, env: Any) -> None:  # noqa: ANN401 - whatever is given
    """Refuse what is no parallel environment of ours, or whose UAVs' own rows and actions are others already."""
    world: Any = getattr(env, "unwrapped", None)
    if not hasattr(env, "possible_agents") or not hasattr(world, "own_row"):
        raise ValueError(
            f"{wrapper}: goes around outrider.parallel_env; many worlds have estimate= and safety_filter="
        )
    for agent in _briefings(env):
        own, seen = _row_box(world.observation_space(agent)), _row_box(env.observation_space(agent))
        kept = np.ones(0 if own is None else own.shape, dtype=np.bool_)
        kept[_RELATIVE] = False  # an estimate has no bounds
        if (
            own is None
            or seen is None
            or seen.shape != own.shape
            or not np.array_equal(seen.low[kept], own.low[kept])
            or not np.array_equal(seen.high[kept], own.high[kept])
        ):
            raise ValueError(
                f"{wrapper}: {agent}'s observations are not its own row any more: it goes around the environment "
                "before whatever changes them"
            )


class EstimateWrapper(BaseParallelWrapper):  # type: ignore[misc]
    """Puts the filter's estimate in the place of the UAVs' raw detections; everything else stays.

    The row keeps its layout. `detected` is 1 from the first detection on, `relative_x` and `relative_y` are the UAV's
    own position minus the estimate of p_g, `age` is the time since the newest detection that the filter believed. An
    estimate has no largest distance, so the space of the relative position is unbounded.

    Args:
        env: The environment, or a wrapper of it whose UAVs still have their own rows.

    Raises:
        ValueError: If it is another.
    """

    def __init__(self, env: Any) -> None:  # noqa: ANN401 - PettingZoo has no types
        _check_rows("EstimateWrapper", env)
        super().__init__(env)
        self._filters: dict[str, RelativeEstimator] = {}
        self._briefings = _briefings(env)
        self._spaces = {
            agent: self._without_bounds(env.observation_space(agent)) for agent in self._briefings
        }

    @staticmethod
    def _without_bounds(space: spaces.Space[Any]) -> spaces.Space[Any]:
        if isinstance(space, spaces.Dict):
            return spaces.Dict(
                {**space.spaces, "row": EstimateWrapper._without_bounds(space.spaces["row"])}
            )
        box = cast("spaces.Box", space)
        low, high = box.low.copy(), box.high.copy()
        low[_RELATIVE], high[_RELATIVE] = -np.inf, np.inf
        return spaces.Box(low, high, dtype=low.dtype.type)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The space of an agent's observations."""
        return self._spaces[agent] if agent in self._spaces else self.env.observation_space(agent)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode, with new filters."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._filters = {agent: estimator_of(told) for agent, told in self._briefings.items()}
        return self._estimated(observations), infos

    def step(self, actions: Mapping[str, Any]) -> tuple[dict[str, Any], ...]:
        """Let all vehicles act for one tick."""
        observations, *rest = self.env.step(actions)
        return self._estimated(observations), *rest

    def _estimated(self, observations: dict[str, Any]) -> dict[str, Any]:
        estimated = dict(observations)
        for agent in self._filters.keys() & observations.keys():
            seen = observations[agent]
            if isinstance(seen, dict):
                estimated[agent] = seen | {"row": self._replace(agent, seen["row"])}
            else:
                estimated[agent] = self._replace(agent, seen)
        return estimated

    def _replace(self, agent: str, row: Row) -> Row:
        """The row with the estimate in it, once there is one."""
        world = self.env.unwrapped
        observation = uav_observation(world.own_row(agent), dt=self._briefings[agent].dt)
        p_x, p_y = observation.position
        # The row has room for one.
        found = world.received(agent) if world.degraded else observation.detections
        estimate = self._filters[agent].update(
            tick=observation.tick,
            own_position=(p_x, p_y),
            looks=looks_of(found, self._briefings[agent].dt),
        )
        if estimate is None:
            return row
        (g_x, g_y), age = estimate.position, estimate.age
        estimated = row.copy()
        estimated[_DETECTED:] = 1.0, p_x - g_x, p_y - g_y, age
        return estimated


class SafetyFilterWrapper(BaseParallelWrapper):  # type: ignore[misc]
    """Keeps sight of the UGVs, whatever the UAVs' policies want: their actions go through the safety filter.

    Each UAV's info says what became of its action: `intervened`, `certified`, `uncertified` (why not; empty if it
    is) and `certified_distance` [m]. `filters` has the filters of the episode, with their counts.

    Args:
        env: The environment, or a wrapper of it whose UAVs still have their own rows.

    Raises:
        ValueError: If it is another.
    """

    def __init__(self, env: Any) -> None:  # noqa: ANN401 - PettingZoo has no types
        _check_rows("SafetyFilterWrapper", env)
        super().__init__(env)
        self.filters: dict[str, SafetyFilter] = {}
        """By agent."""
        self._seen: dict[str, UavObservation] = {}

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode, with new filters."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self.filters = {agent: SafetyFilter(told) for agent, told in _briefings(self.env).items()}
        self._see(observations)
        return observations, infos

    def _see(self, observations: Mapping[str, Any]) -> None:
        env = self.env.unwrapped
        for agent in self.filters.keys() & observations.keys():
            observation = uav_observation(env.own_row(agent), dt=env.scenario.dt)
            self._seen[agent] = msgspec.structs.replace(
                observation, detections=env.received(agent), flown=env.flown(agent)
            )
            self.filters[agent].see(self._seen[agent])

    def step(self, actions: Mapping[str, Any]) -> tuple[dict[str, Any], ...]:
        """Let all vehicles act for one tick, the UAVs within what is safe.

        Raises:
            ValueError: If an action is missing, of no agent, or not two finite numbers; nothing has happened then.
        """
        env, safe, verdicts = self.env.unwrapped, dict(actions), {}
        wanted = env.taken(actions)
        for agent, keeper in self.filters.items():
            verdicts[agent] = verdict = keeper.filter(self._seen[agent], wanted[agent])
            safe[agent] = np.array(verdict.acceleration)
            env.carry(agent, verdict.motions)
        observations, rewards, terminations, truncations, infos = self.env.step(safe)
        self._see(observations)
        for agent, verdict in verdicts.items():
            infos[agent] = infos[agent] | {
                "intervened": verdict.intervened,
                "certified": verdict.certified,
                "uncertified": verdict.reason,
                "certified_distance": verdict.distance,
            }
        return observations, rewards, terminations, truncations, infos
