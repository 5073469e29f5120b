"""The paper's pilots as policies for the environment: the baseline for whoever trains."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from agents.control.orbit import Path as VirtualPath
from agents.control.weighting import Weighting
from agents.estimation.estimator import RelativeEstimator
from agents.uav import UavPilot, radio_ticks
from bus.layout import uav_observation, ugv_observation
from bus.messages import LinkKind, RelativeInformation, UavBriefing
from bus.registry import DRIVERS
from bus.ticks import looks_of
from outrider.running.flying import Pilot, make_pilots
from sim.kernels.compile import FloatArray

Policy = Callable[
    [npt.NDArray[np.floating[Any]] | Mapping[str, npt.NDArray[np.floating[Any]]]], FloatArray
]
"""A vehicle's observation in, its acceleration [m/s²] out."""


class _Radio:
    """The radio from the UAVs' computers to the UGVs: each radios what its filter knows, whoever flies the UAV."""

    def __init__(self, env: Any) -> None:  # noqa: ANN401
        self._env, self._dt, self._tick = env, env.scenario.dt, -1
        self._rows = {name: k for k, name in enumerate(env.possible_agents)}
        told = [
            one
            for name in env.possible_agents
            if isinstance(one := env.briefing(name), UavBriefing)
        ]
        self._filters = {
            one.vehicle: RelativeEstimator(
                detector=one.detector, target=one.target_limits, dt=one.dt, settings=one.estimator
            )
            for one in told
        }
        self._escorts = {uav.name: uav.escorts for uav in env.scenario.uav}
        self._links = env.world.links.of(LinkKind.RADIO)
        self._said: dict[str, RelativeInformation] = {}
        self._arrived: dict[str, tuple[RelativeInformation, ...]] = {}

    def received(self, ugv: str) -> tuple[RelativeInformation, ...]:
        """The messages that have reached a UGV at this tick."""
        while self._tick < self._env.world.tick:
            self._go_on()
        return self._arrived.get(ugv, ())

    def _go_on(self) -> None:
        self._tick += 1
        self._arrived = {}
        for uav, link in self._links.items():
            if uav in self._said:
                link.send(self._tick, self._said.pop(uav), self._tick - 1)
            ugv = self._escorts[uav]
            self._arrived[ugv] = self._arrived.get(ugv, ()) + tuple(link.arrivals(self._tick))
        if self._tick == self._env.world.tick:
            for uav in self._filters:
                self._speak(uav)

    def _speak(self, uav: str) -> None:
        world = self._env.world
        p_x, p_y = world.told.position[self._rows[uav]].tolist()
        estimate = self._filters[uav].update(
            tick=self._tick,
            own_position=(p_x, p_y),
            looks=looks_of(self._env.received(uav), self._dt),
        )
        if estimate is None or self._tick % radio_ticks(self._dt):
            return
        (g_x, g_y), no_error = estimate.position, 0.0  # drivers make nothing of the error
        self._said[uav] = RelativeInformation(
            time=self._tick * self._dt,
            relative_position=(p_x - g_x, p_y - g_y),
            coverage_error=no_error,
        )


class _EnvPilots:
    """The pilots of one environment, new ones for each episode."""

    def __init__(self, env: Any, weighting: Weighting | None, path: VirtualPath | None) -> None:  # noqa: ANN401
        self._env = env.unwrapped
        self._weighting, self._path = weighting, path
        self._begin()

    def _begin(self) -> None:
        env = self._env
        self._episode: int = env.episode
        receives = any(DRIVERS[ugv.driver].listens for ugv in env.scenario.ugv)
        self._radio = _Radio(env) if receives and env.episode else None
        self._pilots: dict[str, Pilot] = make_pilots(
            env.scenario,
            env.episode_seed,
            secret=env.secret,
            weighting=self._weighting,
            path=self._path,
        )

    def act(
        self,
        name: str,
        observation: npt.NDArray[np.floating[Any]] | Mapping[str, npt.NDArray[np.floating[Any]]],
    ) -> FloatArray:
        if self._episode != self._env.episode:
            self._begin()
        row = observation["row"] if isinstance(observation, Mapping) else observation
        pilot, dt = self._pilots[name], self._env.scenario.dt
        if isinstance(pilot, UavPilot):
            seen = uav_observation(row, dt=dt)
            if self._env.degraded:  # several may have come at once, and the row has room for one
                seen = msgspec.structs.replace(seen, detections=self._env.received(name))
            command = pilot.act(msgspec.structs.replace(seen, flown=self._env.flown(name)))
            self._env.carry(name, command.motions)
            return np.array(command.acceleration)
        perceived = ugv_observation(row, dt=dt)
        if self._radio is not None:
            perceived = msgspec.structs.replace(perceived, radio=self._radio.received(name))
        return np.array(pilot.act(perceived).acceleration)


def pilots(
    env: Any,  # noqa: ANN401
    *,
    weighting: Weighting | None = None,
    path: VirtualPath | None = None,
) -> dict[str, Policy]:
    """A policy for each agent of the environment: the scenario's law for a UAV, its driver for a UGV.

    Each knows what it would know over the bus: its briefing, and then the rows of its own observations. They have a
    memory, so call each once a tick; with a new episode they begin anew by themselves. With float64 rows they fly the
    same bits as `outrider.run` with the same scenario and seed.

    Args:
        env: The environment, or a wrapper of it.
        weighting: For the law `weighted`, instead of the scenario's.
        path: For the law `path`, instead of the scenario's.

    Raises:
        ScenarioError: If the scenario asks for a law or a driver that cannot be had.
    """
    flown = _EnvPilots(env, weighting, path)
    return {name: partial(flown.act, name) for name in env.possible_agents}
